"""What is known of a sensor's gel apart from a recording: stiffness per area, pitch of the markers."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tactile.io.sensor_model import Published, SensorModel
from tactile.layer_stiffness import bonded_stiffness


@dataclass(frozen=True, kw_only=True)
class PublishedGel:
    """`source`: who says so. `stiffness`: by the name of a pad's attribute, the value (MPa/mm) and its
    relative standard deviation. `pitch_mm`: geometric mean of both steps of the grid, with its relative
    `pitch_sd`.
    """

    source: str
    stiffness: Mapping[str, tuple[float, float]]
    pitch_mm: float | None = None
    pitch_sd: float = 0.0


def gel_of_model(model: SensorModel) -> PublishedGel:
    """What the sensor's published values say of its gel.

    Where the stiffness itself is not published it is the bonded layer's (tactile.layer_stiffness),
    errors to first order.
    """
    pitch = model.pitch_mm
    return PublishedGel(
        source=f'the sensor model "{model.key}"',
        stiffness={**_of_a_layer(model.gel), **_as_published(model.gel)},
        pitch_mm=None if pitch is None else float(np.exp(np.log(pitch.value).mean())),
        pitch_sd=0.0 if pitch is None else pitch.relative_sd,
    )


def _as_published(gel: Mapping[str, Published]) -> dict[str, tuple[float, float]]:
    names = ("gel_kn_MPa_per_mm", "gel_kt_MPa_per_mm")
    return {name: (float(gel[name].value[0]), gel[name].relative_sd) for name in names if name in gel}


def _of_a_layer(gel: Mapping[str, Published]) -> dict[str, tuple[float, float]]:
    """Both stiffnesses of a bonded layer; none unless modulus, Poisson's ratio and thickness are known."""
    if not {"E_MPa", "nu", "thickness_mm"} <= gel.keys():
        return {}
    E, nu, h = (float(gel[name].value[0]) for name in ("E_MPa", "nu", "thickness_mm"))
    nu_sd, scale_sd = gel["nu"].sd, np.hypot(gel["E_MPa"].relative_sd, gel["thickness_mm"].relative_sd)
    kn, kt = bonded_stiffness(E, nu, h)
    of_kn, of_kt = 2 / (1 - 2 * nu) - 1 / (1 - nu) - 1 / (1 + nu), 1 / (1 + nu)
    return {
        "gel_kn_MPa_per_mm": (kn, float(np.hypot(scale_sd, of_kn * nu_sd))),
        "gel_kt_MPa_per_mm": (kt, float(np.hypot(scale_sd, of_kt * nu_sd))),
    }
