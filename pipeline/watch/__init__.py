"""`drupe watch`: grades fruit as their files arrive in a batch's folder, and shows them in a browser."""
