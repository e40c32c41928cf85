"""Gel frames to displacement and force on the fruit."""

import os

os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", "60000000")
# OpenCV reads its limit for decoded pictures once, while it is imported; a whole photo has at most so many
# pixels (recon.cameras.photos.MOST_WHOLE_PIXELS).
