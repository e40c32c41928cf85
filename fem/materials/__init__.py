"""Material laws of the flesh at any strain, each in a file of its own, all for E = 1 MPa."""
