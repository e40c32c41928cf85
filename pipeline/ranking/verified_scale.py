"""A modulus whose sensor was checked on bodies of known modulus: what that leaves of the sensor's error.

`ratio` is E found over E known, `ln_sd` the standard deviation of its logarithm.
"""

import math
from collections.abc import Mapping

from pipeline.batch.records import ModulusRecord
from pipeline.fruit.elasticity import GAIN, SENSOR
from tactile.unseen_error import unseen_error


def sd_of_fruit_MPa(modulus: ModulusRecord) -> float:
    """E's standard deviation without the sensor's scale and gain, which a reference body measures."""
    parts = modulus.parts_sd_MPa
    sensor = math.hypot(parts.get(SENSOR, 0.0), parts.get(GAIN, 0.0))
    return math.sqrt(max(modulus.E_sd_MPa**2 - sensor**2, 0.0))


def shared_sd_of_fruit_MPa(modulus: ModulusRecord) -> float:
    """The same of the part that all fruit share."""
    return math.sqrt(max(modulus.common_sd_MPa**2 - modulus.parts_sd_MPa.get(SENSOR, 0.0) ** 2, 0.0))


def verified(modulus: ModulusRecord, ln_ratio: float, ln_sd: float) -> ModulusRecord:
    """The same E, of whose scale the reference bodies say ln r ± sd: what that leaves of the common scale and
    of the sensor's own (tactile.unseen_error), each by the same share.
    """
    own = modulus.parts_sd_MPa.get(SENSOR, 0.0)
    assumed = math.hypot(modulus.scale_sd_MPa, own) / modulus.E_MPa
    if assumed == 0.0:
        return modulus
    share = min(1.0, unseen_error(ln_ratio, ln_sd, prior_sd=assumed) / assumed)
    return with_sensor(modulus, {SENSOR: share * own}, scale_sd_MPa=share * modulus.scale_sd_MPa)


def with_sensor(
    modulus: ModulusRecord, parts_sd_MPa: Mapping[str, float], *, scale_sd_MPa: float
) -> ModulusRecord:
    """The same E with other parts of its error by the sensor (MPa); no part is added that it did not have."""
    parts = dict(modulus.parts_sd_MPa)
    changed = {name: sd for name, sd in parts_sd_MPa.items() if name in parts}
    less = sum(parts[name] ** 2 - sd**2 for name, sd in changed.items())
    shared = parts[SENSOR] ** 2 - changed[SENSOR] ** 2 if SENSOR in changed else 0.0
    return modulus.model_copy(
        update={
            "E_sd_MPa": math.sqrt(max(modulus.E_sd_MPa**2 - less, 0.0)),
            "common_sd_MPa": math.sqrt(max(modulus.common_sd_MPa**2 - shared, 0.0)),
            "scale_sd_MPa": scale_sd_MPa,
            "parts_sd_MPa": parts | changed,
        }
    )
