"""pycolmap, or None where it cannot be loaded: pip has no package of it for Linux on ARM.

Without its way with signals: a process that is told to end should end, not print its stack.
"""

import signal
import threading

_before = signal.getsignal(signal.SIGTERM)
_mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})

try:
    import pycolmap  # it takes SIGTERM over as it is imported: one that comes meanwhile waits
except (ImportError, OSError):
    pycolmap = None
finally:
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, _before if _before is not None else signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_SETMASK, _mask)

__all__ = ["pycolmap"]
