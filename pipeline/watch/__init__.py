"""`drupe watch`: grades what is put into a batch's folder, and shows it in a browser on this machine."""
