"""Computers without pycolmap or pymetis: the same answers, or a sentence that says what to do."""

import subprocess

from small_batches import python

ABSENT = (
    "import sys; sys.modules.update(dict.fromkeys(['pycolmap', 'pymetis', 'pymeshlab', 'fcntl'][:{count}]))\n"
)


def ran(code: str, *, absent: int = 3) -> subprocess.CompletedProcess[str]:
    """A Python of its own, in which imports of the first `absent` packages fail."""
    return python(ABSENT.format(count=absent) + code)


def test_doctor_grades_the_known_ball_and_names_what_is_absent():
    done = ran("sys.argv = ['drupe', 'doctor']; from pipeline.start import main; main()")
    assert done.returncode == 0, done.stderr
    assert "optional library pycolmap does not load" in done.stdout
    assert "optional library pymetis does not load" in done.stdout
    assert done.stdout.endswith("all well\n")


def test_photos_of_the_mat_are_placed_without_pycolmap():
    done = ran("import recon.cameras.mat_poses; assert 'recon.cameras.motion' not in sys.modules")
    assert done.returncode == 0, done.stderr


def test_windows_is_refused_in_a_sentence():
    code = "sys.platform = 'win32'; import pipeline.start"
    done = ran(code, absent=4)
    assert done.returncode == 2
    assert done.stderr.startswith("drupe: this machine: Windows is not supported")
    assert done.stderr.count("\n") == 1
