"""Native libraries that cannot be loaded."""

import sys

import pytest

from recon.recon_failure import ReconFailure
from recon.surface.ray_mesh import open3d


@pytest.mark.parametrize(
    ("why", "ends"), [("OSError('libGL.so.1')", ReconFailure), ("KeyboardInterrupt()", KeyboardInterrupt)]
)
def test_a_stop_while_a_library_is_loaded_is_no_missing_library(tmp_path, monkeypatch, why, ends):
    (tmp_path / "open3d.py").write_text(f"raise ImportError('initialization failed') from {why}\n")
    monkeypatch.syspath_prepend(tmp_path)
    for name in [module for module in sys.modules if module.partition(".")[0] == "open3d"]:
        monkeypatch.delitem(sys.modules, name)
    with pytest.raises(ends):
        open3d()
