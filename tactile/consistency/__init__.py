"""Whether a recording obeys the relations that valid ones obey, and which mistake explains it if not."""
