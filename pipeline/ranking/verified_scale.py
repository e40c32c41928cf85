"""A modulus after a check of its sensor on bodies of known modulus: the sensor's remaining error.

`ratio` is E found over E known, `ln_sd` the standard deviation of its logarithm.
"""

import math

from pipeline.batch.records import ModulusRecord
from pipeline.fruit.elasticity import GAIN, OWN_GAIN, SENSOR
from tactile.consistency.gain import unseen_error

SHARED = (SENSOR, GAIN)
"""Parts of an error bar by the sensor that all fruit share; a reference body measures them."""


def verified(modulus: ModulusRecord, ln_ratio: float, ln_sd: float) -> ModulusRecord:
    """The same E with the errors that remain after the reference bodies' ln r ± sd: of the common scale and
    of the sensor's SHARED parts (tactile.consistency.gain), each by the same share. They grow if ln r
    contradicts them.
    """
    assumed = math.hypot(modulus.scale_sd_MPa, _shared_sd_MPa(modulus)) / modulus.E_MPa
    if assumed == 0.0:
        return modulus
    return _with_sensor(modulus, unseen_error(ln_ratio, ln_sd, prior_sd=assumed) / assumed)


def shared_gain(modulus: ModulusRecord) -> float:
    """The relative part of E's error by a gain that all fruit share."""
    return modulus.parts_sd_MPa.get(GAIN, 0.0) / modulus.E_MPa


def with_own_gain(modulus: ModulusRecord, shared: float) -> ModulusRecord:
    """The same E and error bar; its gain beyond `shared`, that of other bodies (relative), counts as its
    own."""
    parts = modulus.parts_sd_MPa
    kept = min(parts.get(GAIN, 0.0), shared * modulus.E_MPa)
    more = parts.get(GAIN, 0.0) ** 2 - kept**2
    if more <= 0:
        return modulus
    own_gain_sd = math.sqrt(parts.get(OWN_GAIN, 0.0) ** 2 + more)
    return modulus.model_copy(
        update={
            "common_sd_MPa": math.sqrt(max(modulus.common_sd_MPa**2 - more, 0.0)),
            "parts_sd_MPa": parts | {GAIN: kept, OWN_GAIN: own_gain_sd},
        }
    )


def without_sensor(modulus: ModulusRecord) -> ModulusRecord:
    """The same E without the common scale and the sensor's SHARED parts."""
    return _with_sensor(modulus, 0.0)


def _with_sensor(modulus: ModulusRecord, share: float) -> ModulusRecord:
    """The same E with its common scale and the sensor's SHARED parts multiplied by `share`."""
    more = (share**2 - 1) * _shared_sd_MPa(modulus) ** 2
    parts = modulus.parts_sd_MPa
    return modulus.model_copy(
        update={
            "E_sd_MPa": math.sqrt(max(modulus.E_sd_MPa**2 + more, 0.0)),
            "common_sd_MPa": math.sqrt(max(modulus.common_sd_MPa**2 + more, 0.0)),
            "scale_sd_MPa": share * modulus.scale_sd_MPa,
            "parts_sd_MPa": parts | {name: share * parts[name] for name in SHARED if name in parts},
        }
    )


def _shared_sd_MPa(modulus: ModulusRecord) -> float:
    return math.hypot(*(modulus.parts_sd_MPa.get(name, 0.0) for name in SHARED))
