"""`drupe robot`."""

import datetime
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from pipeline.commands.endings import exit_when_interrupted, exit_when_refused, say_written
from pipeline.safe_start import elsewhere


def robot(
    poses: Annotated[
        Path,
        Argument(
            metavar="POSES",
            help="A table (.csv, .txt, .xlsx) of flange poses in the robot's base, each with its photo.",
        ),
    ],
    out: Annotated[Path, Argument(metavar="ROBOT.toml", help="The description file to write.")],
    gripper: Annotated[
        Path, Option(metavar="FILE", help="The gripper's description: the pads' poses on the flange.")
    ],
    mat: Annotated[Path, Option(metavar="FILE", help="The mat.json of the printed mat.")] = Path("mat.json"),
    fixed_camera: Annotated[
        bool,
        Option("--fixed-camera", help="The camera stands beside the robot, and the flange carries the mat."),
    ] = False,
) -> None:
    """Find where the marker mat lies in a robot's base, for the poses of the pads.

    Photograph the mat from 15 or more poses with a camera on the flange. Tilt the flange by 20 degrees or
    more about two axes between the poses. With --fixed-camera the flange carries the mat; rows without a pose
    show it at its place.

    Use ROBOT.toml with drupe convert --robot. drupe prints the standard deviation of the pads' places.

    Exit status: 0 written; 1 internal error; 2 usage; 3 unusable poses or photos; 130 interrupted.

    Example: drupe robot poses.csv robot.toml --gripper gripper.toml --mat mat.json
    """
    with elsewhere():
        from pipeline.recordings.robot_calibration import calibrate_robot
        from pipeline.run.progress import StageLines
        from recon.recon_failure import ReconFailure
        from tactile.tactile_failure import TactileFailure

    with (
        exit_when_interrupted("; drupe wrote no file"),
        exit_when_refused(poses, TactileFailure, ReconFailure),
    ):
        words = calibrate_robot(
            poses,
            out,
            mat=mat,
            gripper=gripper,
            fixed_camera=fixed_camera,
            today=datetime.datetime.now(tz=datetime.UTC).date(),
            report=StageLines().stage,
        )
    say_written(words, out)
