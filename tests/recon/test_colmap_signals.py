"""A process that uses pycolmap ends quietly when it is told to."""

import signal
import subprocess
import sys

ENDS_ITSELF = "import os, signal, recon.cameras.colmap; os.kill(os.getpid(), signal.SIGTERM)"


def test_a_process_told_to_end_prints_no_stack() -> None:
    done = subprocess.run([sys.executable, "-c", ENDS_ITSELF], capture_output=True, text=True, timeout=120)
    assert done.returncode == -signal.SIGTERM
    assert "SIGTERM" not in done.stderr
    assert "stack trace" not in done.stderr


STAND_IN = """
import importlib.abc, importlib.machinery, os, signal, sys

class Loader(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    def find_spec(self, name, path, target=None):
        return importlib.machinery.ModuleSpec(name, self) if name == "pycolmap" else None

    def exec_module(self, module):
        signal.signal(signal.SIGTERM, lambda *_: print("its own handler", flush=True))
        os.kill(os.getpid(), signal.SIGTERM)
        print("loaded", flush=True)

sys.meta_path.insert(0, Loader())
sys.modules.pop("pycolmap", None)
import recon.cameras.colmap
print("goes on")
"""


def test_a_process_told_to_end_while_pycolmap_is_loaded_ends_after_it() -> None:
    done = subprocess.run([sys.executable, "-c", STAND_IN], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (-signal.SIGTERM, "loaded\n", "")
