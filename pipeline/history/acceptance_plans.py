"""Acceptance sampling plans: how many fruit of a lot to inspect, and when to accept the lot.

Attributes: the code letters and the single sampling plans of MIL-STD-105E (1989), tables I, II-A, II-B and
II-C. ISO 2859-1:1989 has the same tables, and ISO 2859-1:1999 those for normal and tightened inspection. The
plans equal those of the R package AQLSchemes 1.7-2 in all 768 cells (16 letters, 16 AQLs, 3 inspections). The
numbers of a plan depend only on the sum of the row indices of code letter and AQL: along a diagonal of the
table, n times AQL is nearly constant. Variables: the s method with one specification limit of ANSI/ASQ Z1.9,
tables A-2 and B-1 (also in ISO 3951:1989), and for reduced inspection table B-4. The latter lists M, the
largest estimated share of nonconforming fruit that is accepted. It corresponds to k = (n - 1) (1 - 2 B(M)) /
sqrt(n), with B the quantile of the beta distribution with parameters n / 2 - 1 (Lieberman and Resnikoff).
Its sizes and M are those of AQLSchemes 1.7-2 in all 154 cells.

Operating characteristics are exact: binomial for a long series of lots, hypergeometric for this lot. For
variables, Student's noncentral t: P = P(T(n - 1, sqrt(n) z) >= sqrt(n) k), z the normal quantile of 1 - p
(Lieberman and Resnikoff, J. Am. Stat. Assoc. 50, 1955, 457).
"""

import math
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
from jaxtyping import Float
from scipy.optimize import brentq
from scipy.stats import beta, binom, hypergeom, nct, norm

SWITCHING = {
    "normal": "Change to tightened inspection after 2 rejected lots among 5 in a row; reduced inspection "
    "needs 10 accepted lots in a row and steady production",
    "tightened": "Return to normal inspection after 5 accepted lots in a row; stop inspection after 5 "
    "rejected lots in all",
    "reduced": "Return to normal inspection after a lot that is rejected or, by attributes, between Ac "
    "and Re",
}
"""Switching rule of each inspection (MIL-STD-105E, 4.7; ISO 2859-1, 9.3)."""
INSPECTIONS = tuple(SWITCHING)
AQLS = (0.010, 0.015, 0.025, 0.040, 0.065, 0.10, 0.15, 0.25, 0.40, 0.65, 1.0, 1.5, 2.5, 4.0, 6.5, 10.0)
"""Acceptance quality limits, per cent of nonconforming fruit; larger ones in the tables count defects."""
LARGEST_LOTS = (8, 15, 25, 50, 90, 150, 280, 500, 1200, 3200, 10_000, 35_000, 150_000, 500_000)
"""Largest lot of each row of code letters; the last row has no limit."""
LETTERS = {
    "S-1": "AAAABBBBCCCCDDD",
    "S-2": "AAABBBCCCDDDEEE",
    "S-3": "AABBCCDDEEFFGGH",
    "S-4": "AABCCDEEFGGHJJK",
    "I": "AABCCDEFGHJKLMN",
    "II": "ABCDEFGHJKLMNPQ",
    "III": "BCDEFGHJKLMNPQR",
}
"""Table I: for each level, a letter per row of lot sizes."""
ROWS = "ABCDEFGHJKLMNPQRS"
SIZES = (2, 3, 5, 8, 13, 20, 32, 50, 80, 125, 200, 315, 500, 800, 1250, 2000, 3150)
"""Fruit in the sample of each row. Only tightened inspection uses row S."""
REDUCED_SIZES = (2, 2, 2, 3, 5, 8, 13, 20, 32, 50, 80, 125, 200, 315, 500, 800)
"""Fruit in the sample of each row, for reduced inspection."""
ZERO_DIAGONAL = {"normal": 14, "tightened": 15, "reduced": 14}
"""Sum of the row indices (from 0) of letter and AQL at which the acceptance number is 0."""
NUMBERS = {
    "normal": tuple((c, c + 1) for c in (1, 2, 3, 5, 7, 10, 14, 21)),
    "tightened": tuple((c, c + 1) for c in (1, 2, 3, 5, 8, 12, 18)),
    "reduced": ((0, 2), (1, 3), (1, 4), (2, 5), (3, 6), (5, 8), (7, 10), (10, 13)),
}
"""Acceptance and rejection numbers from the third diagonal after ZERO_DIAGONAL; two between have arrows."""
VARIABLES_LOTS = (8, 15, 25, 50, 90, 150, 280, 400, 500, 1200, 3200, 10_000, 35_000, 150_000, 500_000)
"""Largest lot of each row of table A-2; the last row has no limit."""
VARIABLES_LETTERS = {
    "S-3": "BBBBBBBCCDEFGHHH",
    "S-4": "BBBBBCDEEFGHIJKK",
    "I": "BBBCDEFGGHIJKLMN",
    "II": "BBCDEFGHIJKLMNPP",
    "III": "CDEFGHIJJKLMNPPP",
}
"""Table A-2 of ANSI/ASQ Z1.9: for each level, a letter per row of lot sizes."""
VARIABLES_ROWS = "BCDEFGHIJKLMNP"
VARIABLES_SIZES = (3, 4, 5, 7, 10, 15, 20, 25, 35, 50, 75, 100, 150, 200)
"""Fruit in the sample of each row of table B-1."""
VARIABLES_AQLS = AQLS[5:]
"""AQLs of the plans by variables, per cent."""
K = """
  -    -    -    -    -    -    -    -  1.12 .958 .765 .566
  -    -    -    -    -    -  1.45 1.34 1.17 1.01 .814 .617
  -    -    -    -    -  1.65 1.53 1.40 1.24 1.07 .874 .675
  -    -    -  2.00 1.88 1.75 1.62 1.50 1.33 1.15 .955 .755
  -    -  2.24 2.11 1.98 1.84 1.72 1.58 1.41 1.23 1.03 .828
2.53 2.42 2.32 2.20 2.06 1.91 1.79 1.65 1.47 1.30 1.09 .886
2.58 2.47 2.36 2.24 2.11 1.96 1.82 1.69 1.51 1.33 1.12 .917
2.61 2.50 2.40 2.26 2.14 1.98 1.85 1.72 1.53 1.35 1.14 .936
2.65 2.54 2.45 2.31 2.18 2.03 1.89 1.76 1.57 1.39 1.18 .969
2.71 2.60 2.50 2.35 2.22 2.08 1.93 1.80 1.61 1.42 1.21 1.00
2.77 2.66 2.55 2.41 2.27 2.12 1.98 1.84 1.65 1.46 1.24 1.03
2.80 2.69 2.58 2.43 2.29 2.14 2.00 1.86 1.67 1.48 1.26 1.05
2.84 2.73 2.61 2.47 2.33 2.18 2.03 1.89 1.70 1.51 1.29 1.07
2.85 2.73 2.62 2.47 2.33 2.18 2.04 1.89 1.70 1.51 1.29 1.07
"""
"""Table B-1: k by letter (row) and AQL (column). The first AQL has the second column in normal inspection,
the first in tightened inspection; "-" is an arrow down.
"""
REDUCED_VARIABLES_SIZES = (3, 3, 3, 3, 4, 5, 7, 10, 15, 20, 25, 30, 50, 75)
"""Fruit in the sample of each row of VARIABLES_ROWS, for reduced inspection."""
REDUCED_M = """
3    -    -    -    -    -    -  7.59 18.86 26.94 33.69 40.47
4    -    -    -    -  1.49 5.46 10.88 16.41 22.84 29.43 36.79
5    -    - .041 1.34 3.33 5.82 9.80 14.37 20.19 26.55 33.94
7 .087 .421 1.06 2.13 3.54 5.34 8.40 12.19 17.34 23.30 30.50
10 .349 .714 1.27 2.14 3.27 4.72 7.26 10.53 15.17 20.73 27.65
15 .491 .839 1.33 2.09 3.06 4.32 6.55 9.48 13.74 18.97 25.63
20 .531 .864 1.33 2.03 2.93 4.10 6.18 8.95 13.01 18.07 24.58
25 .551 .874 1.32 2.00 2.86 3.97 5.98 8.65 12.60 17.55 23.97
30 .567 .885 1.32 1.98 2.82 3.91 5.87 8.48 12.37 17.25 23.61
50 .503 .778 1.16 1.73 2.47 3.44 5.21 7.61 11.23 15.87 21.99
75 .461 .711 1.06 1.59 2.27 3.17 4.83 7.10 10.58 15.07 21.05
"""
"""Table B-4, per cent: number of fruit, then M by AQL in VARIABLES_AQLS; "-" is an arrow down."""
OC_COLUMNS = ("nonconforming_percent", "acceptance_probability", "lot_acceptance_probability")
"""Columns of the table of an operating characteristic."""
CURVE_POINTS = 101
"""Points of an operating characteristic: steps of a hundredth of its width resolve its shape."""
LEAST_ACCEPTED = 0.005
"""Probability of acceptance at which a curve ends."""


class NoPlan(ValueError):
    """There is no plan; the text is a sentence with the reason."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Inspect `n` fruit of a lot of `lot_size`; `aql` in per cent; `letter`: code letter of the row used."""

    lot_size: int
    aql: float
    level: str
    inspection: str
    letter: str
    n: int

    def _words(self, kind: str, numbers: str) -> str:
        return (
            f"Lot of {self.lot_size}, AQL {self.aql:g} %, level {self.level}, {self.inspection} inspection "
            f"by {kind}, code letter {self.letter}: n = {self.n}, {numbers}"
        )


@dataclass(frozen=True, kw_only=True)
class AttributesPlan(Plan):
    """Accept the lot with at most `ac` nonconforming fruit in the sample, reject it with `re` or more.

    Reduced inspection also accepts it between the two; the next lot then gets normal inspection.
    """

    ac: int
    re: int

    @property
    def words(self) -> str:
        """In one sentence without its stop."""
        return self._words("attributes", f"Ac = {self.ac}, Re = {self.re}")

    def acceptance(self, share: Float[np.ndarray, " p"]) -> Float[np.ndarray, " p"]:
        """Probability of accepting lots of a process with this share of nonconforming fruit (binomial)."""
        return np.asarray(binom.cdf(self.re - 1, self.n, share))

    def lot_acceptance(self, nonconforming: Float[np.ndarray, " p"]) -> Float[np.ndarray, " p"]:
        """Probability of accepting this lot if it has this number of nonconforming fruit (hypergeometric)."""
        return np.asarray(hypergeom.cdf(self.re - 1, self.lot_size, nonconforming, self.n))


@dataclass(frozen=True, kw_only=True)
class VariablesPlan(Plan):
    """Accept the lot if the sample's mean is at least `k` standard deviations inside the limit."""

    k: float

    @property
    def words(self) -> str:
        """In one sentence without its stop."""
        return self._words("variables (s method)", f"k = {self.k:g}")

    def acceptance(self, share: Float[np.ndarray, " p"]) -> Float[np.ndarray, " p"]:
        """Probability of accepting lots of a normal characteristic with this share beyond the limit."""
        z = norm.isf(np.clip(share, 1e-9, 1 - 1e-9))
        return np.asarray(nct.sf(math.sqrt(self.n) * self.k, self.n - 1, math.sqrt(self.n) * z))


SamplingPlan: TypeAlias = AttributesPlan | VariablesPlan


def attributes_plan(
    lot_size: int, aql: float, *, level: str = "II", inspection: str = "normal"
) -> AttributesPlan:
    """The plan of MIL-STD-105E; the sample is at most the whole lot. Raises NoPlan for invalid arguments.

    >>> plan = attributes_plan(1000, 1.0)
    >>> plan.letter, plan.n, plan.ac, plan.re
    ('J', 80, 2, 3)
    """
    _require_known(lot_size, aql, AQLS, level, LETTERS, inspection)
    row = ROWS.index(LETTERS[level][sum(lot_size > most for most in LARGEST_LOTS)])
    row, ac, re = _cell(row, AQLS.index(aql), inspection)
    n = (REDUCED_SIZES if inspection == "reduced" else SIZES)[row]
    asked: dict[str, Any] = {"lot_size": lot_size, "aql": aql, "level": level, "inspection": inspection}
    return AttributesPlan(**asked, letter=ROWS[row], n=min(n, lot_size), ac=ac, re=re)


def _cell(row: int, column: int, inspection: str) -> tuple[int, int, int]:
    """Row of the plan after the table's arrows, with its acceptance and rejection numbers."""
    numbers, past = NUMBERS[inspection], row + column - ZERO_DIAGONAL[inspection]
    last_row = len(ROWS) - 1 if inspection == "tightened" else len(ROWS) - 2
    zero_row = row - past
    if past == 0 and not (inspection == "tightened" and row == 0):
        return row, 0, 1
    if past < 0:
        return zero_row, 0, 1
    arrow_up = past == 1 and inspection != "tightened" and row > 0
    if past < 3:
        below = zero_row + 3
        return (zero_row, 0, 1) if arrow_up or below > last_row else (below, *numbers[0])
    kept = min(past - 3, len(numbers) - 1)
    return row - (past - 3 - kept), *numbers[kept]


def variables_plan(
    lot_size: int, aql: float, *, level: str = "II", inspection: str = "normal"
) -> VariablesPlan:
    """The s plan of ANSI/ASQ Z1.9 for one limit. Raises NoPlan for invalid arguments or a sample larger than
    the lot.

    >>> plan = variables_plan(300, 1.0)
    >>> plan.letter, plan.n, plan.k
    ('H', 20, 1.82)
    """
    _require_known(lot_size, aql, VARIABLES_AQLS, level, VARIABLES_LETTERS, inspection)
    row = VARIABLES_ROWS.index(VARIABLES_LETTERS[level][sum(lot_size > most for most in VARIABLES_LOTS)])
    column = VARIABLES_AQLS.index(aql)
    if inspection == "reduced":
        row, n, k = _reduced_by_variables(row, column)
    else:
        cells = [line.split()[column + (inspection == "normal")] for line in K.strip().splitlines()]
        row = next(at for at in range(row, len(cells)) if cells[at] != "-")
        n, k = VARIABLES_SIZES[row], float(cells[row])
    if n > lot_size:
        raise NoPlan(f"the plan needs {n} fruit, but the lot has {lot_size}; use a plan by attributes")
    asked: dict[str, Any] = {"lot_size": lot_size, "aql": aql, "level": level, "inspection": inspection}
    return VariablesPlan(**asked, letter=VARIABLES_ROWS[row], n=n, k=k)


def _reduced_by_variables(row: int, column: int) -> tuple[int, int, float]:
    """Row of the plan after the arrows, n and k (three significant digits, as in table B-1)."""
    lines = [line.split() for line in REDUCED_M.strip().splitlines()]
    cells = {int(line[0]): line[1 + column] for line in lines}
    row = next(at for at in range(row, len(VARIABLES_ROWS)) if cells[REDUCED_VARIABLES_SIZES[at]] != "-")
    n = REDUCED_VARIABLES_SIZES[row]
    quantile = float(beta.ppf(float(cells[n]) / 100, n / 2 - 1, n / 2 - 1))
    return row, n, float(f"{(n - 1) * (1 - 2 * quantile) / math.sqrt(n):.3g}")


def _require_known(
    lot_size: int, aql: float, aqls: tuple[float, ...], level: str, levels: dict[str, str], inspection: str
) -> None:
    if lot_size < 2:
        raise NoPlan(f"found a lot of {lot_size} fruit, expected 2 or more")
    if aql not in aqls:
        raise NoPlan(
            f"found AQL {aql:g} %, expected one of {', '.join(f'{known_aql:g}' for known_aql in aqls)}"
        )
    if level not in levels:
        raise NoPlan(f'found inspection level "{level}", expected one of {", ".join(levels)}')
    if inspection not in INSPECTIONS:
        raise NoPlan(f'found inspection "{inspection}", expected one of {", ".join(INSPECTIONS)}')


def share_accepted_with(plan: SamplingPlan, probability: float) -> float:
    """Share of nonconforming fruit at which the plan accepts lots with this probability."""

    def beyond(share: float) -> float:
        return float(plan.acceptance(np.array([share]))[0]) - probability

    return float(brentq(beyond, 1e-9, 1 - 1e-9))


def operating_characteristic(plan: SamplingPlan) -> pd.DataFrame:
    """Probability of acceptance over the nonconforming fruit (per cent), down to LEAST_ACCEPTED.

    The curve of a plan by attributes has points at whole numbers of fruit, and a column for this finite lot.
    If the sample is the whole lot, it ends at the rejection number.
    """
    if isinstance(plan, AttributesPlan) and plan.n >= plan.lot_size:
        end = plan.re / plan.lot_size
    else:
        end = share_accepted_with(plan, LEAST_ACCEPTED)
    share, added = np.linspace(0.0, end, CURVE_POINTS), []
    if isinstance(plan, AttributesPlan):
        fruit = np.unique(np.ceil(share * plan.lot_size))
        share, added = fruit / plan.lot_size, [plan.lot_acceptance(fruit)]
    columns = (100 * share, plan.acceptance(share), *added)
    return pd.DataFrame(dict(zip(OC_COLUMNS, columns, strict=False))).round(6)
