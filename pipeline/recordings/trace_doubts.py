"""What can be doubted of a bare indenter's trace before anything is explained: its force, and its E."""

from pathlib import Path

from fem.fem_failure import FemFailure
from fem.indentation.explain_trace import linear_modulus
from fem.indentation.no_contact import require_force
from pipeline.fruit.bare_traces import bare_recording, joined_traces
from pipeline.fruit.input_doubts import implausible_E
from pipeline.fruit.trace_geometry import OPTIONS, Stated
from pipeline.problem import BatchRefused
from recon.pit.priors import PitPrior
from tactile.io.recording import Recording
from tactile.io.specimen import PressedSpecimen


def trace_doubts(recording: Recording, prior: PitPrior | None, *, source: Path) -> tuple[str, ...]:
    """A sentence where no force stands out from the noise, or where no flesh of the category has the E that
    linear elasticity gives. Without a category nothing is said of E, without a known geometry nothing at all.
    """
    stated = Stated(specimen=PressedSpecimen(), where="the options", name_of=OPTIONS)
    try:
        bare = bare_recording(recording, source=str(source), stated=stated, prior=prior)
        trace = joined_traces([bare]).trace
    except (BatchRefused, FemFailure):  # drupe explain and drupe grade say what is missing
        return ()
    try:
        require_force(trace)
    except FemFailure as failure:
        return (f"{source.name}: {failure.detail}",)
    if prior is None or prior.poisson_ratio is None:
        return ()
    try:
        modulus = linear_modulus(
            trace, thickness_mm=bare.known.thickness_mm, poisson_ratio=prior.poisson_ratio
        )
    except FemFailure:  # no law fits: drupe explain says why
        return ()
    wrong = implausible_E({"E": modulus.value}, prior)
    return () if wrong is None else (f"{source.name}: {wrong}",)
