"""One fruit through its stages, from photos and recordings to its record."""
