"""Limits of the search and of the maps: they bound the time of a case, or say what a map shows.

What decides on a mismatch and its name stands in fem.mismatch.selection.decision.
"""

MOST_REFITS = 4
"""drupe refits so many explanations of a verdict at most, the likeliest first. Set by hand, to bound time."""
NEGLIGIBLE = 0.02
"""The same effect on another pad is left out below this ratio of probabilities. Set by hand, below the share
that a verdict may lack."""
LEAST_LISTED = 1e-3
"""Probability from which a pair of effects is listed."""
OTHER_PAD_SHARE = 0.5
"""Share of one pad's linear gain from which the same effect on the other pad is refitted too: with three
misplaced pads the wrong one gained as much or a little more (`benchmarks/mismatch.py`, pose_error)."""
LAST_ROUND_GAIN = 0.3
"""ln evidence; a round of a refit that gains less is the last. A fifteenth of what sets two explanations
apart at odds of 20 to 1, by the temperature of the posterior."""
OTHER_START_SHARE = 0.8
"""Share of the gain at the linear amounts from which another start is taken: it does not rest on slopes at
nothing, and the search ends nearer to the truth from there (`benchmarks/mismatch.py`, pose_error)."""
PLACE_SHARE = 0.7
"""Share of the excess above which one pad, place, phase or component has it. Set by hand: well over half."""
PLACE_EXCESS = 0.05
"""Excess, as a share of noise, below which none of pads, phases and components is told from the others. Set
by hand."""
SPOT_SCORE = 20.0
"""Least standard score of a place in the flesh that is named. Set by hand, high: it is the best of many
places, and model errors score too."""
