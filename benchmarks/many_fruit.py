"""What a run itself costs with many fruit: its start, its memory, its time between fruit, its report.

    python benchmarks/many_fruit.py make GRADED BATCH --fruits 1000 [--bare]
    python benchmarks/many_fruit.py run GRADED BATCH [--work 0.2] [--jobs 2]
    python benchmarks/many_fruit.py simulate GRADED BATCH [--work 0.01] [--jobs 2] [--every 1000]

GRADED is a batch of one fruit with a ready mesh and its results beside it, as `drupe grade` leaves them. `make`
copies the fruit: its mesh scaled by up to 10 % with noise of 0.01 mm, displacements of its recordings by as much
with noise of 0.001 mm; with `--bare` every fruit is a link to the same files, which costs no disk. `run` is
`drupe grade` of BATCH, but that a fruit's process waits for `--work` seconds and leaves copies of the graded
fruit's record and pictures, E drawn anew: processes, records, progress, ranking and report are the run's own.
`simulate` has no processes either: threads wait, and nothing is written for a fruit but what the run itself writes.
"""

import argparse
import shutil
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from queue import Empty, SimpleQueue

import h5py
import numpy as np
import psutil

import pipeline.run.engines
import pipeline.run.grading
from pipeline.batch.layout import Results
from pipeline.batch.records import read_record, write_record
from pipeline.run.console import RunConsole
from pipeline.run.progress import BatchProgress
from pipeline.run.reporting import ReportSoFar
from pipeline.run.scheduling import Event, Finished, Progressed
from recon.surface.mesh_file import read_mesh
from recon.surface.mesh_file import write_ply as write_mesh

PICTURES = ("fruit.ply", "pit.ply", "mesh.png", "residual.png", "fruit.glb")
STAGES = ("mesh", "pit", "contact", "flesh", "modulus", "screen", "picture")
