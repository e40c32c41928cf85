"""What must hold between the fields of a recording, and with the fruit's mesh, whoever wrote them."""
