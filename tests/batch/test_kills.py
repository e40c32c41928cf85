"""A small part of the campaign of kills: nothing is lost, nothing is left, and the next run repairs it.

The command is killed once, and a fruit's process once; test_resume has the signals that ask the command to
end and one that kills it, tests/pipeline/test_runner.py the other ends of a process.
"""

import subprocess
import sys
from pathlib import Path

import pytest

CAMPAIGN = Path(__file__).parents[2] / "benchmarks" / "campaign_kills.py"


@pytest.mark.proof
@pytest.mark.skipif(sys.platform != "linux", reason="left processes are looked for in /proc")
def test_kills_and_full_disks_cost_nothing_that_a_second_run_does_not_give(tmp_path):
    command = [sys.executable, str(CAMPAIGN), "--quick", "--kills", "2"]
    done = subprocess.run(
        [*command, "--folder", str(tmp_path / "campaign")],
        capture_output=True,
        text=True,
        timeout=900,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "2 trials, 0 faults" in done.stdout
    assert "disk full in-process" in done.stdout
