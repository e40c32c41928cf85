"""Imports of native libraries: where a system library is missing, a sentence says what to install."""

from types import ModuleType

from recon.recon_failure import ReconProblem

DEBIAN_PACKAGES = "libegl1 libgl1 libusb-1.0-0"


def open3d() -> ModuleType:
    """Open3D, or ReconFailure (missing-library) that says which packages bring it.

    Raises KeyboardInterrupt where that came while the library was loaded: native libraries make it an
    ImportError of their own ("initialization failed").
    """
    try:
        import open3d as module
    except (ImportError, OSError) as error:
        for reason in (error.__cause__, error.__context__):
            if isinstance(reason, KeyboardInterrupt):
                raise reason from error
        raise ReconProblem.MISSING_LIBRARY.failure(
            f"open3d does not load ({error}); install it with pip, and install its system libraries: "
            f"apt-get install {DEBIAN_PACKAGES}"
        ) from error
    module.utility.set_verbosity_level(module.utility.VerbosityLevel.Error)
    loaded: ModuleType = module
    return loaded
