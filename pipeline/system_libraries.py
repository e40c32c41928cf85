"""The shared system libraries that native wheels load, checked before anything loads them."""

import ctypes
import sys

NEEDED = {
    "libGL.so.1": ("libgl1", "Open3D and PyMeshLab"),
    "libEGL.so.1": ("libegl1", "Open3D"),
    "libOpenGL.so.0": ("libopengl0", "PyMeshLab"),
    "libX11.so.6": ("libx11-6", "Open3D"),
    "libusb-1.0.so.0": ("libusb-1.0-0", "Open3D"),
}
"""Library -> (Debian package, wheels that load it); found by importing each wheel on a bare Debian 12."""


def missing_libraries(needed: dict[str, tuple[str, str]] = NEEDED) -> list[str]:
    """A sentence for each missing library (Linux only), with the Debian package to install."""
    if not sys.platform.startswith("linux"):
        return []
    missing = {name: where for name, where in needed.items() if not _loads(name)}
    packages = " ".join(sorted(package for package, _ in missing.values()))
    return [
        f"the system library {name} is missing ({user} needs it); install it: apt-get install -y "
        f"--no-install-recommends {packages}"
        for name, (_, user) in missing.items()
    ]


def _loads(name: str) -> bool:
    try:
        ctypes.CDLL(name)
    except OSError:
        return False
    return True
