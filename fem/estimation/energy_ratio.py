"""Young's modulus by the strain-energy ratio.

The work of the measured forces on the measured displacement is the fruit's strain energy (twice), and the
same forces in a fruit of unit modulus store f' C f = U0' K0 U0, E times as much (Zhao et al., eq. 2, solved
with the measured forces rather than the measured displacement: K0's inverse smooths noise, K0 itself
amplifies it):

    E = f' C f / f' u = sum f . [c(t) - c(t_i)] / sum f . [y(t) - y(t_i) - R q(t) + R q(t_i)]

Each marker is compared with its own first touch at t_i, less the fruit's rigid motion q. The sums run over
the markers in contact and over all frames, so each frame is weighted by its energy.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from fem.estimation.coloured_noise import variance_inflation
from fem.estimation.compliance_fit import MarkerTracks


@dataclass(frozen=True, kw_only=True)
class EnergyRatio:
    """The modulus and two parts of its relative standard deviation: displacement noise and marker scales.

    The scale errors of the markers are independent, so each counts by its share of the energy. `work_Nmm` is
    summed over frames; it is not positive if displacement and force do not match.
    """

    modulus_MPa: float
    work_Nmm: float
    displacement_noise: float
    gel_scale: float

    @property
    def elastic(self) -> bool:
        """Whether the forces do positive work on the displacement."""
        return self.work_Nmm > 0 and self.modulus_MPa > 0


def since_first_touch(
    values: Float[np.ndarray, "t n 3"], episode: Int[np.ndarray, "t n"]
) -> Float[np.ndarray, "t n 3"]:
    """Each marker's series less its value in the first frame of the same contact; zero out of contact.

    >>> readings = np.array([3.0, 4.0, 5.0, 7.0]).repeat(3).reshape(4, 1, 3)
    >>> since_first_touch(readings, np.array([[0], [1], [1], [1]]))[:, 0, 0]
    array([0., 0., 1., 3.])
    """
    change = np.zeros_like(values)
    markers = np.arange(values.shape[1])
    for contact in range(int(episode.max()) + 1):
        during = episode == contact
        first = values[during.argmax(axis=0), markers]
        change += np.where(during[:, :, None], values - first, 0.0)
    return change


def energy_ratio(
    tracks: MarkerTracks,
    force_N: Float[np.ndarray, "t n 3"],
    motion_mm: Float[np.ndarray, "t n 3"],
    *,
    gel_scale_sd: float,
) -> EnergyRatio:
    """The ratio above, from forces at the markers and the fruit's rigid motion at them."""
    c = since_first_touch(tracks.unit_displacement, tracks.episode)
    u = since_first_touch(tracks.position_mm - motion_mm, tracks.episode)
    d = since_first_touch(tracks.gel_displacement_mm, tracks.episode)
    stored, work = float((force_N * c).sum()), float((force_N * u).sum())
    colour = variance_inflation(tracks.lag1)
    # The noise of a marker's own frames, and of its first touch, with which all of them are compared.
    leverage = colour * (force_N**2).sum(axis=(0, 2)) + (force_N.sum(axis=0) ** 2).sum(axis=1)
    return EnergyRatio(
        modulus_MPa=stored / work if work else float("inf"),
        work_Nmm=work,
        displacement_noise=_root(tracks.sd_mm**2 * leverage) / abs(work),
        gel_scale=gel_scale_sd * _root((force_N * d).sum(axis=(0, 2)) ** 2) / abs(work),
    )


def _root(squares: Float[np.ndarray, " n"]) -> float:
    return float(np.sqrt(squares.sum()))
