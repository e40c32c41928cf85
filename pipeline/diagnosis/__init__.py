"""`drupe explain`: from a case to its explanation, as JSON, as a page, and as a setting for grading."""
