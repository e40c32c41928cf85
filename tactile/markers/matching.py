"""Assigns the blobs of a frame to markers.

Neighbouring markers have similar displacements, since a gel is continuous. Each guess of the displacements is
matched to the blobs, grown from its consistent part, and shifted by every step of the markers' grid. The
match of least cost wins. If a grid continues beyond the picture, a match shifted by one pitch is equally
smooth and complete. Only the part of the gel that has not moved distinguishes the two. If no part has stayed,
`Match.margin` is small. A gel that moves by nearly whole pitches (within 0.2 of one) appears to have stayed;
nothing here detects this.

After a jump of about one spacing, markers can be matched with their neighbours' blobs while that is smoother.
When the labels become right again, all of them jump by a spacing. Labelling backwards from there finds the
frames between. Of the two labellings, the one with less total motion is right. Let d be the true jump and p
the spacing. A wrong label moves by |d - p| at first and by p when it is corrected, and |d - p| + p >= d.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from tactile.markers.marker_detection import inside
from tactile.markers.marker_lattice import Lattice, voted, whole_displacement

GATE = 0.5
"""Largest distance of a blob from a marker's expected place, in spacings."""
UNMATCHED_COST = 1.0
"""Cost if every marker is unmatched, in the unit of neighbours' misfit (square spacings). Set by hand."""
SPARE_COST = 1.0
"""Cost if as many blobs as there are markers are unmatched. Blobs count only if their place on the reference
was in view. Set by hand."""
MOVED_COST = 0.1
"""Cost if every marker is further than STAYS from every guess: half of that of a visible grid of ten rows
that is a row off. A tenth of the markers and of the blobs are then unmatched. Set by hand."""
FAR_COST = 0.01
"""Cost if every marker is a spacing from the nearest guess: of equal matches the nearest wins. Set by
hand."""
STAYS = 0.2
"""Distance from a guess, in spacings, below which a marker has stayed there. Set by hand."""
SURE = 0.02
"""Cost below which a match is accepted at once: neighbours differ by a seventh of the spacing."""
LEAST_MARGIN = 0.02
"""Least excess cost of a match's shifts: that of a fifth of the markers that have stayed. Of 150 synthetic
jumps of 0.3 to 1.5 pitches, all five that were matched a pitch off had less, and 11 of the 145 others."""
STEPS_GONE = 4
"""Most steps of the grid by which a match is shifted successively: further than VOTE_REACH. Set by hand."""
SEAM = 0.4
"""Difference of neighbours' displacements, in spacings, above which a seam (discontinuity) separates them."""
SEEDS = 3
"""Patches of markers with similar motion from which a match is grown again. Set by hand."""
FEWEST_SEEDS = 4
"""Fewest markers of such a patch. Set by hand."""
GROWTH_ROUNDS = 12
"""Rounds of matching the neighbours of a patch: enough for a gel some 25 markers wide. Set by hand."""
GROWTH_NEIGHBOURS = 6
"""Nearest markers of one; two of them must be matched before it is. Set by hand."""


UNSURE = 1.0
"""Certainty below which a frame is flagged; later displacements may be a pitch off, so E has no meaning."""
JUMP = 0.5
"""Motion between two frames, in spacings, above which a marker may have changed its label."""
FEWEST = 3
"""Fewest markers that must jump together before their labels are checked. Set by hand."""
LOOK_BACK = 25
"""Most frames to go back: bounds time and memory. Set by hand."""


@dataclass(frozen=True)
class Match:
    """`blob[n]` is marker n's blob or -1; `cost` is lower for a smoother and more complete match. `margin`:
    excess cost of the best match that is shifted by a step of the grid; infinite if none was tried.
    """

    blob: Int[np.ndarray, " n"]
    cost: float
    margin: float = float("inf")

    @property
    def matched(self) -> Bool[np.ndarray, " n"]:
        """Whether each marker has a blob."""
        return np.asarray(self.blob >= 0)

    @property
    def certainty(self) -> float:
        """0 if a match shifted by a step of the grid costs no more, 1 if it costs LEAST_MARGIN more."""
        return min(1.0, self.margin / LEAST_MARGIN)


@dataclass(frozen=True)
class _Sought:
    """Lattice, `guesses` of the displacements (px), and blobs of one frame."""

    lattice: Lattice
    guesses: Sequence[Float[np.ndarray, "n 2"]]
    blobs_px: Float[np.ndarray, "m 2"]
    tree: cKDTree

    def match(self, blob: Int[np.ndarray, " n"]) -> Match:
        """The match with its cost."""
        return Match(blob, self._cost(blob))

    def displacement(self, blob: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
        """Each marker's displacement, px; for one without a blob the estimate by its neighbours."""
        return whole_displacement(self.lattice, self.places(blob))

    def places(self, blob: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
        """Each marker's place, px; NaN without a blob."""
        return np.where((blob >= 0)[:, None], self.blobs_px[blob], np.nan)

    def missing(self, blob: Int[np.ndarray, " n"]) -> tuple[int, int, int]:
        """Numbers of unmatched markers that should be in view, of unmatched blobs whose place the reference
        showed, and of markers that should be in view.
        """
        lattice, known = self.lattice, blob >= 0
        place = self.displacement(blob)
        expected = inside(lattice.rest_px + place, lattice.shape, lattice.margin_px)
        spare = np.ones(len(self.blobs_px), dtype=bool)
        spare[blob[known]] = False
        others = self.blobs_px[spare]
        nearest = np.asarray(cKDTree(lattice.rest_px + place).query(others.reshape(-1, 2))[1], dtype=np.int64)
        were = others - place[nearest]
        unmarked = int(inside(were, lattice.shape, lattice.margin_px + STAYS * lattice.spacing_px).sum())
        return int((expected & ~known).sum()), unmarked, int((expected | known).sum())

    def _cost(self, blob: Int[np.ndarray, " n"]) -> float:
        """Mean square difference of neighbours (spacings, at most 1 each). Shares of markers without a blob,
        of blobs without a marker and of markers far from every guess add to it.
        """
        known = blob >= 0
        if not known.any():
            return float("inf")
        displacement = (self.blobs_px[blob] - self.lattice.rest_px) / self.lattice.spacing_px
        a, b = self.lattice.edges.T
        both = known[a] & known[b]
        apart = ((displacement[a[both]] - displacement[b[both]]) ** 2).sum(axis=1)
        rough = float(np.minimum(apart, 1.0).mean()) if both.any() else 1.0
        unmatched, spare, count = self.missing(blob)
        lost = UNMATCHED_COST * unmatched + SPARE_COST * spare
        away = self.away(blob)
        moved = MOVED_COST * float((away > STAYS).mean()) + FAR_COST * float(away.mean())
        return rough + lost / max(1, count) + moved

    def away(self, blob: Int[np.ndarray, " n"]) -> Float[np.ndarray, " k"]:
        """Distance of each matched marker from the nearest guess, in spacings."""
        known = blob >= 0
        place = self.blobs_px[blob[known]] - self.lattice.rest_px[known]
        away = [np.linalg.norm(place - guess[known], axis=1) for guess in self.guesses]
        return np.asarray(np.min(away, axis=0) / self.lattice.spacing_px)


def match(
    lattice: Lattice,
    guesses: Sequence[Float[np.ndarray, "n 2"]],
    blobs_px: Float[np.ndarray, "m 2"],
) -> Match:
    """The best match over the guessed displacements (px), matches grown from them, and shifts by the grid.

    A marker that a match moves out of view needs no blob.
    """
    if not len(blobs_px):
        return Match(np.full(len(lattice.rest_px), -1), np.inf, margin=0.0)
    sought = _Sought(lattice, guesses, blobs_px, cKDTree(blobs_px))
    tried = [_matched(sought, guess) for guess in guesses]
    best = min(tried, key=attrgetter("cost"))
    if best.cost < SURE:
        return best
    seeds = [_stayed(sought, trial.blob, guess) for trial, guess in zip(tried, guesses, strict=True)]
    tried += [_grown(sought, seed) for seed in seeds if (seed >= 0).sum() >= FEWEST_SEEDS]
    missing, spare, _ = sought.missing(best.blob)
    if missing >= 2 and spare >= 2:
        jumps = (blobs_px[None] - (lattice.rest_px + guesses[0])[:, None]).reshape(-1, 2)
        tried += [_matched(sought, guesses[0] + jump) for jump in voted(jumps, lattice.spacing_px)]
    best = min(tried, key=attrgetter("cost"))
    tried += list(_regrown(sought, best))
    best = min(tried, key=attrgetter("cost"))
    return _against_shifts(sought, best)


def _against_shifts(sought: _Sought, best: Match) -> Match:
    """The cheapest among a match and its shifts by steps of the grid, with its margin."""
    for _ in range(STEPS_GONE):
        place = sought.displacement(best.blob)
        shifted = [_matched(sought, place + step) for step in sought.lattice.steps_px]
        next_best = min([best, *shifted], key=attrgetter("cost"))
        if not np.isfinite(next_best.cost):
            return replace(best, margin=0.0)
        if next_best is best:
            others = [candidate.cost for candidate in shifted if _differs(best, candidate)]
            return replace(best, margin=min(others, default=np.inf) - best.cost)
        best = next_best
    return replace(best, margin=0.0)


def _differs(candidate: Match, other: Match) -> bool:
    """Whether most of the markers that both matches contain have another blob."""
    both = candidate.matched & other.matched
    return bool(both.any() and (candidate.blob[both] != other.blob[both]).mean() > 0.5)


def _stayed(
    sought: _Sought, blob: Int[np.ndarray, " n"], guess: Float[np.ndarray, "n 2"]
) -> Int[np.ndarray, " n"]:
    """Blobs of the markers that are, like half of their neighbours, near the guess; -1 for the rest."""
    place = sought.blobs_px[blob] - sought.lattice.rest_px
    near = (blob >= 0) & (np.linalg.norm(place - guess, axis=1) < STAYS * sought.lattice.spacing_px)
    around = near[sought.lattice.nearest].mean(axis=1) >= 0.5
    return np.where(near & around, blob, -1)


def _matched(sought: _Sought, guess: Float[np.ndarray, "n 2"]) -> Match:
    """Mutual nearest neighbours, repeated after moving each marker by its neighbours' median error."""
    lattice, blobs_px = sought.lattice, sought.blobs_px
    blob = _mutual(sought, lattice.rest_px + guess)
    known = blob >= 0
    error = np.where(known[:, None], blobs_px[blob] - lattice.rest_px - guess, 0.0)
    drift = _median_of_known(error[lattice.nearest], known[lattice.nearest])
    return sought.match(_mutual(sought, lattice.rest_px + guess + drift))


def _median_of_known(
    values: Float[np.ndarray, "n k 2"], known: Bool[np.ndarray, "n k"]
) -> Float[np.ndarray, "n 2"]:
    """Median over the known values of each row; zero if none is known."""
    ordered = np.sort(np.where(known[..., None], values, np.inf), axis=1)
    count = known.sum(axis=1)
    rows = np.arange(len(values))
    low, high = np.maximum(count - 1, 0) // 2, count // 2
    middle = (ordered[rows, low] + ordered[rows, high]) / 2
    return np.where((count > 0)[:, None], middle, 0.0)


def _seams(sought: _Sought, best: Match) -> Bool[np.ndarray, " e"]:
    """Pairs of neighbours that a match tears apart or pushes onto each other."""
    displacement = sought.blobs_px[best.blob] - sought.lattice.rest_px
    a, b = sought.lattice.edges.T
    apart = np.linalg.norm(displacement[a] - displacement[b], axis=1) > SEAM * sought.lattice.spacing_px
    return np.asarray(apart & best.matched[a] & best.matched[b])


def _regrown(sought: _Sought, best: Match) -> Iterator[Match]:
    """Matches grown from one continuous part of `best`; none if all of it is continuous.

    A region that took its neighbours' blobs is smooth inside; only the seam around it shows.
    """
    torn = _seams(sought, best)
    if not torn.any():
        return
    count = len(sought.lattice.rest_px)
    a, b = sought.lattice.edges[~torn & best.matched[sought.lattice.edges].all(axis=1)].T
    links = coo_array((np.ones(len(a)), (a, b)), shape=(count, count))
    part = connected_components(links, directed=False)[1]
    sizes = np.bincount(part[best.matched], minlength=1)
    for seed in np.argsort(-sizes, kind="stable")[:SEEDS]:
        if sizes[seed] < FEWEST_SEEDS:
            return
        yield _grown(sought, np.where((part == seed) & best.matched, best.blob, -1))


def _grown(sought: _Sought, seed: Int[np.ndarray, " n"]) -> Match:
    """The match that grows from a part of one, marker by marker, each near the estimate by its neighbours."""
    lattice, blob = sought.lattice, seed
    for _ in range(GROWTH_ROUNDS):
        known = blob >= 0
        ready = ~known & (known[lattice.nearest[:, :GROWTH_NEIGHBOURS]].sum(axis=1) >= 2)
        partner = _mutual(sought, lattice.rest_px + sought.displacement(blob))
        grown = ready & (partner >= 0) & ~np.isin(partner, blob[known])
        if not grown.any():
            break
        blob = np.where(grown, partner, blob)
    return sought.match(blob)


def _mutual(sought: _Sought, where_px: Float[np.ndarray, "n 2"]) -> Int[np.ndarray, " n"]:
    """Pairs that are each other's nearest within the gate; -1 for the other markers."""
    away, blob = sought.tree.query(where_px)
    marker = cKDTree(where_px).query(sought.blobs_px)[1]
    near = np.asarray(away) <= GATE * sought.lattice.spacing_px
    fits = near & (np.asarray(marker)[blob] == np.arange(len(where_px)))
    return np.where(fits, blob, -1)


def relabelled(
    lattice: Lattice,
    position: Float[np.ndarray, "t n 2"],
    blobs_px: Sequence[Float[np.ndarray, "_ 2"]],
) -> Float[np.ndarray, "t n 2"]:
    """`position` (px, NaN if lost) with corrected labels between a jump and the jump back.

    `blobs_px`: each frame's blobs. Labels that stay wrong for more than LOOK_BACK frames are not corrected.
    """
    whole = position.copy()
    for t in range(2, len(position)):
        if _differ(lattice, whole[t - 1], whole[t]) < FEWEST:
            continue
        back: list[np.ndarray] = []
        after = whole[t]
        for k in range(t - 1, max(-1, t - 1 - LOOK_BACK), -1):
            now = _relabelled_frame(lattice, after, blobs_px[k])
            if _differ(lattice, now, whole[k]) < FEWEST:
                if back and _path(whole[k : t + 1], back) < 0:
                    whole[k + 1 : t] = back[::-1]
                break
            back.append(now)
            after = np.where(np.isfinite(now), now, after)
    return whole


def _relabelled_frame(
    lattice: Lattice,
    after: Float[np.ndarray, "n 2"],
    blobs_px: Float[np.ndarray, "m 2"],
) -> Float[np.ndarray, "n 2"]:
    """The blobs labelled by the markers' places one frame later."""
    moved = whole_displacement(lattice, after)
    best = match(lattice, [moved, np.zeros_like(moved)], blobs_px)
    return np.where(best.matched[:, None], blobs_px[best.blob] if len(blobs_px) else np.nan, np.nan)


def _differ(lattice: Lattice, first_px: Float[np.ndarray, "n 2"], second_px: Float[np.ndarray, "n 2"]) -> int:
    """Number of markers whose two positions differ by more than half a spacing."""
    apart = np.linalg.norm(first_px - second_px, axis=1)
    return int((np.nan_to_num(apart) > JUMP * lattice.spacing_px).sum())


def _path(forward: Float[np.ndarray, "k n 2"], back: list[Float[np.ndarray, "n 2"]]) -> float:
    """Excess total motion (px) of the second labelling, over markers that both follow throughout."""
    other = np.stack([forward[0], *back[::-1], forward[-1]])
    both = np.isfinite(forward).all(axis=(0, 2)) & np.isfinite(other).all(axis=(0, 2))
    lengths = [np.linalg.norm(np.diff(way[:, both], axis=0), axis=2).sum() for way in (forward, other)]
    return float(lengths[1] - lengths[0])
