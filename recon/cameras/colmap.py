"""pycolmap, without its way with signals: a process that is told to end should end, not print its stack."""

import signal
import threading

_before = signal.getsignal(signal.SIGTERM)

import pycolmap  # noqa: E402  (it takes the signals over as it is imported)

if threading.current_thread() is threading.main_thread():
    signal.signal(signal.SIGTERM, _before if _before is not None else signal.SIG_DFL)

__all__ = ["pycolmap"]
