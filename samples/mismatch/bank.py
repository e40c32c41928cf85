"""The bank of cases: which effects, how strong, in which order; everything follows from one seed."""

from dataclasses import dataclass
from pathlib import Path

from samples.mismatch.case_simulation import write_first_that_balances
from samples.mismatch.injected import EFFECTS
from samples.mismatch.out_of_catalogue import OUT_OF_CATALOGUE

SEED = 2027
"""Of all cases; any number does. 2026 was the series of even meshes and one sensor."""

_MORE_SINGLES = (
    ("viscoelastic", 1), ("soft_spot", 2), ("pit_offset", 1), ("damage", 1), ("skin", 1),
    ("graded_modulus", 1),
)  # fmt: skip
"""Effects that come again with another fruit, and their level (set by hand)."""
_LATER = (
    ("adhesion",),
    ("sensor_nonlinear", "gel_creep", "gel_hysteresis", "thermal_drift"),
    ("third_contact",),
    ("drainage", "split_pit"),
)
"""Effects that came after the first bank, as they came: their cases stand last, so that the others keep their
draws."""
_PAIRS = (
    ("pit_offset", "viscoelastic"), ("clock_lag", "skin"), ("graded_modulus", "sensor_gain"),
    ("pose_error", "viscoelastic"), ("slip", "soft_spot"), ("gripper_compliance", "pit_size"),
    ("damage", "sensor_drift"), ("anisotropy", "viscoelastic"), ("plastic_set", "sensor_gain"),
    ("skin", "soft_spot"),
)  # fmt: skip


_COME_IN = ("split_pit", "palm", "drainage")
"""Physics that has come into the catalogue since: its number among the cases outside of it stays free."""


@dataclass(frozen=True, kw_only=True)
class BankCase:
    """One case of the bank: its name, which says nothing, and its effects with their levels."""

    case_id: str
    effects: tuple[tuple[str, int], ...]
    seed: tuple[int, ...]
    out_of_catalogue: str | None = None


def singles() -> tuple[BankCase, ...]:
    """Every effect at three levels, then some again with other fruits."""
    first = [effect for effect in EFFECTS if not any(effect in later for later in _LATER)]
    wanted = [(effect, level) for level in (1, 2, 0) for effect in first]
    wanted += list(_MORE_SINGLES)
    wanted += [(effect, level) for later in _LATER for level in (1, 2, 0) for effect in later]
    return tuple(
        BankCase(case_id=f"single-{k + 1:02d}", effects=(one,), seed=(SEED, 1, k))
        for k, one in enumerate(wanted)
    )


def pairs() -> tuple[BankCase, ...]:
    """Two effects at work together, both at the middle level or above."""
    return tuple(
        BankCase(case_id=f"pair-{k + 1:02d}", effects=((a, 2), (b, 1)), seed=(SEED, 2, k))
        for k, (a, b) in enumerate(_PAIRS)
    )


def outsiders() -> tuple[BankCase, ...]:
    """One case of each physics that the catalogue does not have."""
    return tuple(
        BankCase(
            case_id=f"outside-{number:02d}", effects=(), seed=(SEED, 3, number - 1), out_of_catalogue=name
        )
        for number, name in enumerate(OUT_OF_CATALOGUE, start=1)
        if name not in _COME_IN
    )


def write_bank_case(folder: Path, case: BankCase) -> None:
    """Write one case below `folder` with the first draw that balances."""
    write_first_that_balances(
        folder, case.case_id, case.effects, seed=case.seed, out_of_catalogue=case.out_of_catalogue
    )
