"""The application: from batches to ranking and report. Only this package imports all other packages."""

import os

MOST_PIXELS = 60_000_000
"""Most pixels of a whole photo, equal to recon.cameras.photos.MOST_WHOLE_PIXELS."""
_STATED = os.environ.get("OPENCV_IO_MAX_IMAGE_PIXELS", "")
os.environ["OPENCV_IO_MAX_IMAGE_PIXELS"] = str(
    min(int(_STATED), MOST_PIXELS) if _STATED.isdecimal() and len(_STATED) < 20 else MOST_PIXELS
)
"""OpenCV reads its limit for decoded pictures once, at import. MOST_PIXELS replaces a larger limit of the
user, one that is no number, and one of 20 digits or more."""
