"""`drupe explain`: a case to its explanation, as JSON, as a page, as a setting that grading uses."""
