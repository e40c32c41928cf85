"""Gel frames to displacement and force on the fruit."""

import pipeline.files  # noqa: F401  # pipeline lowers OpenCV's limit before OpenCV is imported
