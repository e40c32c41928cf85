"""Whether a recording obeys the relations that sound ones obey, and which mistake explains it if not."""
