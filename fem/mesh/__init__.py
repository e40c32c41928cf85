"""From closed surfaces of fruit and pit to a T10 mesh of the flesh between them."""
