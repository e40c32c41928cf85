"""The main parts of an error bar of E, and how to reduce them."""

from collections.abc import Mapping

from fem.estimation.error_budget import MODEL, PIT_PLACE, REGISTRATION, SCATTER, TACTILE
from fem.estimation.information import FORCE_SCALE
from fem.estimation.sensitivity import PIT_SIZE, POISSON_RATIO
from pipeline.batch.records import ModulusRecord
from pipeline.fruit.elasticity import CONFIRMED, GAIN, OWN_GAIN, PLAIN_JAW, SENSOR
from pipeline.fruit.input_doubts import DOUBTED
from pipeline.fruit.pressed_fruit import RECORDINGS, SHAPE
from pipeline.ranking.reference_ratio import PART as REFERENCE
from reports.words import percent

ADVICE = {
    TACTILE: "another grasp, a deeper one, or a hold of some seconds at its end",
    REGISTRATION: "more photos, sharper photos, or a second set with the fruit upside down",
    PIT_PLACE: "another grasp, turned by 90 degrees about the stem",
    PIT_SIZE: (
        "another grasp, turned by 90 degrees about the stem, or a pit prior of your cultivar "
        "([pit] prior in batch.toml) from a dozen measured pits"
    ),
    POISSON_RATIO: "poisson_ratio and poisson_ratio_sd of your cultivar in batch.toml",
    MODEL: "another grasp at another place (drupe explain shows the missing physics)",
    SCATTER: "more grasps, at other places",
    FORCE_SCALE: "a calibration of the gel on a load cell (drupe calibrate)",
    SENSOR: "a calibration of the sensor's camera (picture_scale_sd under [sensor] in batch.toml)",
    GAIN: "a calibration of the gel on a load cell (drupe calibrate), or a reference body",
    OWN_GAIN: "more grasps",
    PLAIN_JAW: "a gel on the other jaw",
    CONFIRMED: "more precise parameters of the effects in batch.toml (their sd)",
    DOUBTED: "an answer to the doubts above",
    SHAPE: "photos or a scan instead of three diameters",
    RECORDINGS: "another squeeze, along another diameter",
    REFERENCE: "more reference bodies, or bodies with a better known modulus",
}
"""Advice on each part of an error bar (pipeline/batch/records.py, parts_sd_MPa); nothing reduces that of the
elements."""
COMMON_SCALE = "common scale of force and gel stiffness"
"""No recording shows it, and all fruit of a sensor share it."""
MUCH = 0.5
"""Share of E's variance above which one part alone is named: the others together are less. Set by hand."""


def about_error(modulus: ModulusRecord) -> str:
    """Sentences on E's error bar, and on the common scale that it excludes."""
    said = smaller_error(modulus.parts_sd_MPa)
    if not modulus.scale_sd_MPa > 0:
        return said
    return (
        f"{said} A {COMMON_SCALE} adds ± {100 * modulus.scale_sd_MPa / modulus.E_MPa:.2g} % of E. All "
        "fruit share it and no recording shows it; it affects the class but not the ranking. To "
        "remove it, add a body of known modulus to fruits.csv (reference = true)."
    ).strip()


def smaller_error(parts_sd_MPa: Mapping[str, float]) -> str:
    """The main part or parts of E's variance, and how to reduce them; empty if no part is known."""
    total = sum(sd**2 for sd in parts_sd_MPa.values())
    if not total > 0:
        return ""
    shares = sorted(((sd**2 / total, name) for name, sd in parts_sd_MPa.items()), reverse=True)
    named = shares[:1] if shares[0][0] >= MUCH else shares[:2]
    said = []
    for share, name in named:
        remedy = f"; smaller with {ADVICE[name]}" if name in ADVICE else ""
        said.append(f"{percent(share)} of its variance comes from: {name}{remedy}.")
    return " ".join(said)
