"""Photos to a scaled, watertight fruit mesh with its pit."""

import os

MOST_PIXELS = 60_000_000
"""Of a whole photo, as recon.cameras.photos.MOST_WHOLE_PIXELS has it."""
_STATED = os.environ.get("OPENCV_IO_MAX_IMAGE_PIXELS", "")
os.environ["OPENCV_IO_MAX_IMAGE_PIXELS"] = str(
    min(int(_STATED), MOST_PIXELS) if _STATED.isdecimal() and len(_STATED) < 20 else MOST_PIXELS
)
"""OpenCV reads its limit for decoded pictures once, while it is imported. A larger limit of the user's is
lowered, and so is one that is no number, or one of 20 digits or more, which no computer has."""
