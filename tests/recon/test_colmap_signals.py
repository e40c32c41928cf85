"""A process that uses pycolmap ends quietly when it is told to."""

import signal
import subprocess
import sys

ENDS_ITSELF = "import os, signal, recon.cameras.motion; os.kill(os.getpid(), signal.SIGTERM)"


def test_a_process_told_to_end_prints_no_stack() -> None:
    done = subprocess.run([sys.executable, "-c", ENDS_ITSELF], capture_output=True, text=True, timeout=120)
    assert done.returncode == -signal.SIGTERM
    assert "SIGTERM" not in done.stderr
    assert "stack trace" not in done.stderr
