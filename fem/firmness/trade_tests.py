"""Standard tests of firmness as the trade reads them, and what a fruit of modulus E would read.

Plates: force and secant N/mm at a share of the diameter. FirmTech: the slope of the chord between two forces
of the same curve, in gf/mm (Tetteh, Prussia, Verma, NeSmith, "Apparent modulus of elasticity from FirmTech 2
firmness measurements of blueberries", Trans. ASABE 49, 2006, 113-121); no standard fixes the two forces, and
the slope grows with either. Ball: how deep it goes at a force. ANSI/ASAE S368.4: the apparent modulus.
"""

import math
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

from scipy.optimize import brentq

from fem.firmness.simulated_presses import BALL_MM, FruitPresses, PressCurve
from fem.solid.closed_forms import s368_parallel_plates_modulus_MPa

N_PER_GF = 9.80665e-3
"""Standard gravity."""
S368_POISSON_RATIO = 0.49
"""That the apparent modulus is computed with, whatever the flesh's is. Set by hand: nearly incompressible."""
CHORD_GF = (50.0, 350.0)
"""Set by hand; an instrument's own settings take their place."""
BALL_N = 1.0
"""Set by hand: the ball goes less than its radius into flesh of 0.1 MPa or more."""
SQUEEZE = {(5, "N/mm"): "Karageorgiadou et al., Horticulturae 10, 2024, 435"}
"""Who squeezes a fruit by how many per cent of its diameter, and in which unit."""
SINGLE_CONTACT = (
    "Two plates give the lower bound of FirmTech's reading, one rigid contact up to twice as much"
)
"""FirmTech loads a fruit between these two ways (Tetteh et al., abstract). At the same force one contact is
pressed half as far as two. E goes with the slope to the power 3/2: 2^(3/2) = 2.8."""

_Read = Callable[[FruitPresses, float], tuple[float, float]]


@dataclass(frozen=True, kw_only=True)
class TradeTest:
    """`name` holds the conditions and ends with the unit. `read`: reading and depth (mm) for E in MPa, NaN
    where the simulation does not reach. `force_sd`: relative standard deviation of the force at a depth.
    `caveat`: how an instrument may read otherwise.
    """

    name: str
    title: str
    unit: str
    source: str
    read: _Read
    force_sd: Callable[[FruitPresses, float], float] = FruitPresses.plates_sd
    caveat: str = ""

    @property
    def under_ball(self) -> bool:
        """Whether the ball presses, and not the plates."""
        return self.force_sd is FruitPresses.ball_sd


def trade_tests(*, chord_gf: tuple[float, float] = CHORD_GF, ball_N: float = BALL_N) -> tuple[TradeTest, ...]:
    """The table of tests. Raises ValueError unless 0 <= first < second chord force and ball_N > 0."""
    low, high = chord_gf
    if not (0 <= low < high < math.inf and 0 < ball_N < math.inf):
        raise ValueError(f"found {low:g} gf, {high:g} gf, {ball_N:g} N; expected 0 <= first < second, 0 < N")

    def plates(percent: int, unit: str, read: Callable[..., tuple[float, float]]) -> TradeTest:
        return TradeTest(
            name=f"plates_{percent}pct_{unit.replace('/', '_per_')}",
            title=f"Plates, {percent} % of the diameter",
            unit=unit,
            source=SQUEEZE.get((percent, unit), "no standard: the squeeze is the condition"),
            read=partial(read, percent / 100),
        )

    return (
        *(plates(percent, *how) for percent in (2, 5) for how in (("N", _force), ("N/mm", _secant))),
        TradeTest(
            name=f"chord_{low:g}_{high:g}gf_gf_per_mm",
            title=f"FirmTech, chord from {low:g} to {high:g} gf",
            unit="gf/mm",
            source="Tetteh et al., Trans. ASABE 49, 2006, 113-121",
            read=partial(_chord, chord_gf),
            caveat=SINGLE_CONTACT,
        ),
        TradeTest(
            name=f"ball_{2 * BALL_MM:g}mm_{ball_N:g}N_mm",
            title=f"{2 * BALL_MM:g} mm ball at {ball_N:g} N, depth",
            unit="mm",
            source="no standard: the ball and its force are the conditions",
            read=partial(_under_ball, ball_N),
            force_sd=FruitPresses.ball_sd,
        ),
        TradeTest(
            name="s368_5pct_MPa",
            title="Apparent modulus, plates at 5 %",
            unit="MPa",
            source="ANSI/ASAE S368.4 DEC2000, parallel plates, Poisson's ratio 0.49, the ellipsoid's radii",
            read=partial(_apparent_modulus, 0.05),
        ),
    )


def trade_test_of(name: str) -> TradeTest | None:
    """The test to which `trade_tests` gives this name with some forces, or None; capitals count as small
    letters.

    >>> trade_test_of("Chord_40_300gf_gf_per_mm").title
    'FirmTech, chord from 40 to 300 gf'
    >>> [trade_test_of(name) for name in ("chord_3", "plates_2")]
    [None, None]
    """
    numbers = [float(text) for text in re.findall(r"\d+(?:\.\d+)?", name)] or [0.0]
    named = partial(trade_tests, chord_gf=(numbers[0], numbers[-1])), partial(trade_tests, ball_N=numbers[-1])
    tests = [*trade_tests()]
    for make in named:
        with suppress(ValueError):  # the numbers are no forces
            tests += make()
    return next((test for test in tests if test.name.lower() == name.lower()), None)


def reading(
    test: TradeTest, presses: Sequence[FruitPresses], *, E_MPa: float, E_sd_MPa: float
) -> tuple[float, float]:
    """The fruit's reading and its standard deviation; NaN where the simulation does not reach.

    `presses`: the fruit's and their variants (fem.firmness.simulated_presses). The error is that of E and
    of the method, which scale the force, and of Poisson's ratio and the pit's size. E's own error holds the
    last two too and is not freed of them, so that the whole is rather too large.
    """
    plain, *varied = presses
    value, depth_mm = test.read(plain, E_MPa)
    relative = math.hypot(E_sd_MPa / E_MPa, test.force_sd(plain, depth_mm))
    firmer = test.read(plain, E_MPa * math.exp(relative))[0] - value
    others = (test.read(variant, E_MPa)[0] - value for variant in varied)
    return value, math.hypot(firmer, *others)


def modulus_at(test: TradeTest, presses: FruitPresses, limit: float) -> float:
    """E (MPa, 0.001 to 1000) of a fruit of this shape that reads `limit`; NaN where no such E is in reach."""

    def missing(ln_E: float) -> float:
        return test.read(presses, math.exp(ln_E))[0] - limit

    low, high = math.log(1e-3), math.log(1e3)
    while low < high and not math.isfinite(missing(low)):
        low += 0.02  # too soft for the force
    if low >= high or missing(low) * missing(high) > 0:
        return math.nan
    return math.exp(float(brentq(missing, low, high, rtol=1e-12)))


def _force(share: float, presses: FruitPresses, E_MPa: float) -> tuple[float, float]:
    depth = share * presses.diameters_mm[0]
    return E_MPa * presses.plates.force_N_per_MPa(depth), depth


def _secant(share: float, presses: FruitPresses, E_MPa: float) -> tuple[float, float]:
    force, depth = _force(share, presses, E_MPa)
    return force / depth, depth


def _chord(forces_gf: tuple[float, float], presses: FruitPresses, E_MPa: float) -> tuple[float, float]:
    first, last = (_depth_mm(presses.plates, gf * N_PER_GF / E_MPa) for gf in forces_gf)
    return (forces_gf[1] - forces_gf[0]) / (last - first), last


def _under_ball(force_N: float, presses: FruitPresses, E_MPa: float) -> tuple[float, float]:
    depth = _depth_mm(presses.ball, force_N / E_MPa)
    return depth, depth


def _apparent_modulus(share: float, presses: FruitPresses, E_MPa: float) -> tuple[float, float]:
    force, depth = _force(share, presses, E_MPa)
    radius, other = presses.radii_mm
    modulus = s368_parallel_plates_modulus_MPa(
        force_N=force,
        deformation_mm=depth,
        poisson_ratio=S368_POISSON_RATIO,
        radius_mm=radius,
        other_radius_mm=other,
    )
    return modulus, depth


def _depth_mm(curve: PressCurve, force_N_per_MPa: float) -> float:
    """Where the curve reaches the force; NaN beyond its deepest sample."""
    deepest = float(curve.depth_mm[-1])
    if not curve.force_N_per_MPa(deepest) >= force_N_per_MPa:
        return math.nan
    return float(brentq(lambda d: curve.force_N_per_MPa(d) - force_N_per_MPa, 0.0, deepest, xtol=1e-12))
