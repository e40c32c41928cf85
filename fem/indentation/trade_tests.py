"""Standard tests of firmness as the trade reads them, and what a fruit of modulus E would read, with its error.

Plates: force and secant N/mm at a share of the diameter. FirmTech: the slope of the chord between two forces
of the same curve, in gf/mm (Tetteh, Prussia, Verma, NeSmith, "Apparent modulus of elasticity from FirmTech 2
firmness measurements of blueberries", Trans. ASABE 49, 2006, 113-121); no standard fixes the two forces, and the
slope grows with either. Ball: how deep it goes at a force. ANSI/ASAE S368.4: the apparent modulus.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from scipy.optimize import brentq

from fem.indentation.simulated_presses import BALL_MM, FruitPresses, PressCurve
from fem.solid.closed_forms import s368_parallel_plates_modulus_MPa

N_PER_GF = 9.80665e-3
"""Standard gravity."""
S368_POISSON_RATIO = 0.49
"""That the apparent modulus is computed with, whatever the flesh's is. Set by hand: nearly incompressible."""
CHORD_GF = (50.0, 350.0)
"""Set by hand; an instrument's own settings take their place."""
BALL_N = 1.0
"""Set by hand: the ball goes less than its radius into flesh of 0.1 MPa or more."""
MODULI_MPa = (1e-3, 1e3)
"""Between which a modulus is sought."""


@dataclass(frozen=True, kw_only=True)
class TradeTest:
    """`read`: reading and depth (mm) of a fruit of modulus E (MPa); NaN where the simulation does not reach.

    `name` holds the conditions and ends with the unit. `on`: the curve that is read.
    """

    name: str
    title: str
    unit: str
    source: str
    on: str
    read: Callable[[FruitPresses, float], tuple[float, float]]


@dataclass(frozen=True, kw_only=True)
class Reading:
    """A reading with its standard deviation and the parts of it, in the test's unit. NaN: out of reach."""

    value: float
    sd: float
    parts_sd: dict[str, float]


def trade_tests(
    *, chord_gf: tuple[float, float] = CHORD_GF, ball_N: float = BALL_N
) -> tuple[TradeTest, ...]:
    """The table of tests. Raises ValueError unless 0 <= first < second chord force and ball_N > 0."""
    low, high = chord_gf
    if not (0 <= low < high and ball_N > 0):
        raise ValueError(f"found {low:g} gf, {high:g} gf and {ball_N:g} N, expected 0 <= first < second, 0 < N")
    tests = []
    for share in (0.02, 0.05):
        at = f"plates_{share:.0%}".replace("%", "pct")
        told = f"Plates, {share:.0%} of the diameter"
        source = "force at a share of the diameter: Karageorgiadou et al., Horticulturae 10, 2024, 435"
        tests += [
            TradeTest(
                name=f"{at}_N", title=told, unit="N", source=source, on="plates", read=_squeezed(share)
            ),
            TradeTest(
                name=f"{at}_N_per_mm",
                title=told,
                unit="N/mm",
                source=source,
                on="plates",
                read=_squeezed(share, secant=True),
            ),
        ]
    tests += [
        TradeTest(
            name=f"chord_{low:g}_{high:g}gf_gf_per_mm",
            title=f"FirmTech, chord from {low:g} to {high:g} gf",
            unit="gf/mm",
            source="Tetteh et al., Trans. ASABE 49, 2006, 113-121",
            on="plates",
            read=_chord(low, high),
        ),
        TradeTest(
            name=f"ball_{2 * BALL_MM:g}mm_{ball_N:g}N_mm",
            title=f"{2 * BALL_MM:g} mm ball at {ball_N:g} N, depth",
            unit="mm",
            source="no standard: the ball and its force are the conditions",
            on="ball",
            read=_depth_under_ball(ball_N),
        ),
        TradeTest(
            name="s368_5pct_MPa",
            title="Apparent modulus, plates at 5%",
            unit="MPa",
            source="ANSI/ASAE S368.4 DEC2000, parallel plates, Poisson's ratio 0.49",
            on="plates",
            read=_apparent_modulus(0.05),
        ),
    ]
    return tuple(tests)


def reading(
    test: TradeTest, presses: Sequence[FruitPresses], *, E_MPa: float, E_sd_MPa: float
) -> Reading:
    """What the fruit reads, from its presses and their variants (fem.indentation.simulated_presses).

    Parts: of E, of the method (both scale the force), and of Poisson's ratio and the pit's size together.
    E's own error holds theirs too and is not freed of them, so that the whole is rather too large.
    """
    plain, *varied = presses
    value, depth_mm = test.read(plain, E_MPa)
    if not math.isfinite(value):
        return Reading(value=math.nan, sd=math.nan, parts_sd={})
    method = plain.ball_sd(depth_mm) if test.on == "ball" else plain.plates_sd(depth_mm)

    def scaled_by(relative: float) -> float:
        near = (test.read(plain, E_MPa * math.exp(way * min(relative, 0.3)))[0] for way in (1, -1))
        ends = [end if math.isfinite(end) else value for end in near]
        reached = sum(end != value for end in ends)
        return abs(ends[0] - ends[1]) / max(reached, 1) * relative / min(relative, 0.3) if relative else 0.0

    others = [test.read(one, E_MPa)[0] - value for one in varied]
    parts = {
        "E": scaled_by(E_sd_MPa / E_MPa),
        "method": scaled_by(method),
        "Poisson's ratio and pit size": math.hypot(*[x for x in others if math.isfinite(x)]),
    }
    return Reading(value=value, sd=math.hypot(*parts.values()), parts_sd=parts)


def modulus_at(test: TradeTest, presses: FruitPresses, limit: float) -> float:
    """E (MPa) of a fruit of this shape that reads `limit`; NaN where the simulation reaches no such E.

    Readings grow with E, but for depth under the ball, which falls. Where a soft fruit is out of reach, the
    search goes on among firmer ones.
    """
    low, high = MODULI_MPa
    while not math.isfinite(test.read(presses, low)[0]):
        low *= 1.02
        if low > high:
            return math.nan
    ends = [test.read(presses, E)[0] - limit for E in (low, high)]
    if ends[0] * ends[1] > 0:
        return math.nan
    return float(brentq(lambda E: test.read(presses, E)[0] - limit, low, high, rtol=1e-10))


def _squeezed(share: float, *, secant: bool = False) -> Callable[[FruitPresses, float], tuple[float, float]]:
    def read(presses: FruitPresses, E_MPa: float) -> tuple[float, float]:
        depth = share * presses.diameters_mm[0]
        force = E_MPa * presses.plates.force_N_per_MPa(depth)
        return (force / depth if secant else force), depth

    return read


def _chord(low_gf: float, high_gf: float) -> Callable[[FruitPresses, float], tuple[float, float]]:
    def read(presses: FruitPresses, E_MPa: float) -> tuple[float, float]:
        first, last = (_depth_mm(presses.plates, gf * N_PER_GF / E_MPa) for gf in (low_gf, high_gf))
        return (high_gf - low_gf) / (last - first), last

    return read


def _depth_under_ball(force_N: float) -> Callable[[FruitPresses, float], tuple[float, float]]:
    def read(presses: FruitPresses, E_MPa: float) -> tuple[float, float]:
        depth = _depth_mm(presses.ball, force_N / E_MPa)
        return depth, depth

    return read


def _apparent_modulus(share: float) -> Callable[[FruitPresses, float], tuple[float, float]]:
    def read(presses: FruitPresses, E_MPa: float) -> tuple[float, float]:
        depth = share * presses.diameters_mm[0]
        radius_mm, other_mm = presses.radii_mm
        modulus = s368_parallel_plates_modulus_MPa(
            force_N=E_MPa * presses.plates.force_N_per_MPa(depth),
            deformation_mm=depth,
            poisson_ratio=S368_POISSON_RATIO,
            radius_mm=radius_mm,
            other_radius_mm=other_mm,
        )
        return modulus, depth

    return read


def _depth_mm(curve: PressCurve, force_N_per_MPa: float) -> float:
    """Where the curve reaches the force; NaN beyond its deepest sample."""
    deepest = float(curve.depth_mm[-1])
    if not curve.force_N_per_MPa(deepest) >= force_N_per_MPa:
        return math.nan
    return float(brentq(lambda d: curve.force_N_per_MPa(d) - force_N_per_MPa, 0.0, deepest, xtol=1e-12))
