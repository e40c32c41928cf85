"""Records to CSV and HTML that people read."""
