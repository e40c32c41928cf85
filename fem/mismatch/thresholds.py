"""Limits of the search and of the maps: they bound the time of a case, or say what a map shows.

What decides on a mismatch and its name stands in fem.mismatch.selection.decision.
"""

MOST_SINGLES, MOST_PAIRS = 5, 2
"""Explanations of the linear round that are refitted at most. Set by hand, to bound the time of a case."""
REFIT_SHARE = 0.15
"""Share of the best linear gain from which an effect is worth its nonlinear refit. Set by hand, wide: linear
signatures miss most of what laws that bend gain."""
NEGLIGIBLE = 0.02
"""Ratio of probabilities below which an alternative is left out: another pad, or a pair beside its single.
Set by hand, below the share that a verdict may lack."""
SIDE_BY_SIDE = 2
"""Effects refitted at the same time, after the first. It decides what each is compared with (BEATEN_SHARE)
and so is the same for any number of threads. Set by hand, for two cores; each takes memory of its own."""
OTHER_PAD_SHARE = 0.5
"""Share of one pad's linear gain from which the same effect on the other pad is refitted too: with three
misplaced pads the wrong one gained as much or a little more (`benchmarks/mismatch.py`, pose_error)."""
BEATEN_SHARE = 0.7
"""A refit that even with what its slopes promise gains less than such a share of another is given up. Set by
hand, below 1 for what the slopes do not tell."""
LAST_ROUND_GAIN = 0.3
"""ln evidence; a round of a refit that gains less is the last. A fifteenth of what sets two explanations
apart at odds of 20 to 1, by the temperature of the posterior."""
OTHER_START_SHARE = 0.8
"""Share of the gain at the linear amounts from which another start is taken: it does not rest on slopes at
nothing, and the search ends nearer to the truth from there (`benchmarks/mismatch.py`, pose_error)."""
CLEARLY_LARGELY = 25.0
"""ln evidence, best signatures beside it, by which flesh deforms largely or not, so that the other is not
tried with full models. Set by hand, to save refits: a strong skin's signature gains 26 where its full model
gains 53."""

PLACE_SHARE = 0.7
"""Share of the excess above which one pad, place, phase or component has it. Set by hand: well over half."""
PLACE_EXCESS = 0.05
"""Excess, as a share of noise, below which none of pads, phases and components is told from the others. Set
by hand."""
SPOT_SCORE = 20.0
"""Least standard score of a place in the flesh that is named. Set by hand, high: it is the best of many
places, and model errors score too."""
