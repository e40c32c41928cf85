"""What the report says of a fruit's recordings one by one, from their records."""

from collections.abc import Iterator, Sequence

import numpy as np

from pipeline.batch.records import GraspRecord
from reports.entries import ForceCurve, GraspEstimate, ModelLine, ModulusByFrame


def estimate_of(grasp: GraspRecord) -> GraspEstimate:
    """One recording's estimates for the report."""
    return GraspEstimate(
        grasp=grasp.grasp,
        E_energy_MPa=grasp.E_energy_MPa,
        E_energy_sd_MPa=grasp.E_energy_sd_MPa,
        E_least_squares_MPa=grasp.E_least_squares_MPa,
        E_least_squares_sd_MPa=grasp.E_least_squares_sd_MPa,
        residual_um=grasp.residual_um,
        peak_force_N=grasp.peak_force_N,
        travel_mm=grasp.travel_mm,
        frames_used=grasp.frames_used,
    )


def curves_of(grasps: Sequence[GraspRecord]) -> list[ForceCurve]:
    """Force against travel of every pad, recorded and by the model."""
    return [
        ForceCurve(
            grasp=g.grasp,
            pad=c.pad,
            travel_mm=np.array(c.travel_mm),
            force_N=np.array(c.force_N),
            model=None
            if c.model is None
            else ModelLine(
                travel_mm=np.array(c.model.travel_mm),
                force_N=np.array(c.model.force_N),
                sd_mm=np.array(c.model.sd_mm),
            ),
        )
        for g in grasps
        for c in g.curves
    ]


def frames_of(grasps: Sequence[GraspRecord]) -> Iterator[ModulusByFrame]:
    """E by each frame alone."""
    for grasp in grasps:
        for one in grasp.frames:
            yield ModulusByFrame(grasp=grasp.grasp, **one.model_dump())
