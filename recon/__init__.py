"""Photos to a scaled, watertight fruit mesh with its pit."""

import pipeline.files  # noqa: F401  # pipeline lowers OpenCV's limit before OpenCV is imported
