"""A viscoelastic contact as a row of independent springs: exact for contact that grows and for one unloading.

A convex force-depth curve phi(d) is a row of springs: spring j is touched at depth y_j and has stiffness w_j,
the jump of phi's slope there, so that sum w_j (d - y_j)+ is phi. Give each spring the memory of the flesh,
and let it leave the ball when its force falls to nothing: while contact grows the sum is Lee and Radok's
integral, F = int R(t - s) d phi(d(s)); on unloading the last spring in touch is the one with
int_{t1}^{t} R(t - s) dd(s) = 0, which is Ting's condition for the shrinking contact, and the force is his.
Unlike his formula the row goes on through any number of cycles. On a half-space the row is exact; on a slab
exact while contact grows.

Sources: Lee and Radok, "The contact problem for viscoelastic bodies", J. Appl. Mech. 27, 1960, 438-444;
Ting, "The contact stresses between a rigid indenter and a viscoelastic half-space", J. Appl. Mech. 33, 1966,
845-854; Argatov and Popov, "Rebound indentation problem for a viscoelastic half-space and axisymmetric
indenter: solution by the method of dimensionality reduction", ZAMM 96, 2016, 956-967.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from scipy.linalg.lapack import dtbtrs

#: springs; the force then errs by about a third of their inverse square, relative to the largest
SPRINGS = 40
#: a ball that falls back by less than this share of its largest depth is still going in
JITTER = 1e-3


def springs(
    curve: Callable[[Float[np.ndarray, "p n"]], Float[np.ndarray, "p n"]],
    deepest_mm: Float[np.ndarray, " p"],
) -> tuple[Float[np.ndarray, "p n"], Float[np.ndarray, "p n"]]:
    """Touch depths y (mm) and stiffnesses w of each row, denser at first touch: y grows as a square."""
    share = (np.arange(SPRINGS + 1) / SPRINGS) ** 2
    level = deepest_mm[:, None] * share
    slope = np.diff(curve(level)) / np.diff(level)
    return level[:, :-1], np.diff(slope, prepend=0.0, axis=1)


def pressed_mm(
    depth_mm: Float[np.ndarray, "p t"],
    slack_mm: Float[np.ndarray, "p t n"] | None,
    level_mm: Float[np.ndarray, "p n"],
    toe_mm: Float[np.ndarray, " p"] | None = None,
) -> Float[np.ndarray, "p t n"]:
    """Compression of each spring, (d - y - slack)+: the mean over first touches that are spread evenly over a
    width w round the onset, ((x + w/2)+^2 - (x - w/2)+^2)/(2 w), where `toe_mm` is given.
    """
    pressed = depth_mm[:, :, None] - level_mm[:, None]
    if slack_mm is not None:
        pressed = pressed - slack_mm
    if toe_mm is None:
        return np.asarray(np.maximum(pressed, 0.0))
    half = toe_mm[:, None, None] / 2
    inside = np.clip(pressed, -half, half)
    return np.asarray(np.maximum(pressed - half, 0.0) + (inside + half) ** 2 / (4 * half))


def elastic_force(
    depth_mm: Float[np.ndarray, "p t"],
    slack_mm: Float[np.ndarray, "p t n"] | None,
    level_mm: Float[np.ndarray, "p n"],
    stiffness: Float[np.ndarray, "p n"],
    toe_mm: Float[np.ndarray, " p"] | None = None,
) -> Float[np.ndarray, "p t"]:
    """Without memory: the springs' compressions times their stiffnesses.

    Without slack only the springs above a depth d count, of which sums of w, w y and w y^2 are enough:
    sum w (d - y)+ = d W - M, and its integral over d, which a toe asks for, d^2 W/2 - d M + Q/2.
    """
    if slack_mm is not None:
        return np.asarray(
            np.einsum("ptn,pn->pt", pressed_mm(depth_mm, slack_mm, level_mm, toe_mm), stiffness)
        )
    sums = [np.cumsum(stiffness * level_mm**k, axis=1) for k in (0, 1, 2)]

    def integral(depth: Float[np.ndarray, "p t"], times: int) -> Float[np.ndarray, "p t"]:
        touched = np.maximum(depth, 0.0)
        rows = zip(level_mm, touched, strict=True)
        last = np.stack([np.searchsorted(level, depth, side="right") for level, depth in rows]) - 1
        w, m, q = (np.take_along_axis(total, last, axis=1) for total in sums)
        return np.asarray(touched * w - m if times == 0 else touched * (touched * w / 2 - m) + q / 2)

    if toe_mm is None:
        return np.asarray(np.where(depth_mm > 0, integral(depth_mm, 0), 0.0))
    half = toe_mm[:, None] / 2
    upper, lower = (np.where(at > 0, integral(at, 1), 0.0) for at in (depth_mm + half, depth_mm - half))
    return np.asarray((upper - lower) / (2 * half))


def relaxing_force(
    time_s: Float[np.ndarray, " t"],
    depth_mm: Float[np.ndarray, "p t"],
    slack_mm: Float[np.ndarray, "p t n"] | None,
    level_mm: Float[np.ndarray, "p n"],
    stiffness: Float[np.ndarray, "p n"],
    share: Float[np.ndarray, "k p"],
    tau_s: Float[np.ndarray, "k p"],
    toe_mm: Float[np.ndarray, " p"] | None = None,
) -> Float[np.ndarray, "p t"]:
    """With memory R(t) = 1 - sum g + sum g exp(-t/tau): p rows side by side, depth linear between frames.

    Spring compression v and arm states Q_k obey Q_k' = e_k Q_k + g_k c_k (v' - v), e = exp(-dt/tau),
    c = tau/dt (1 - e), exact for linear v. While the ball goes in, one such recursion for the whole row does.
    What touches in the first frame has been touching for long: it starts relaxed.
    """
    step = np.diff(time_s)[:, None, None] / tau_s
    fade = np.exp(-step)
    take = share * -np.expm1(-step) / step
    rest = 1 - share.sum(axis=0)
    turn = last_growing_frame(depth_mm)
    first = None if slack_mm is None else slack_mm[:, : turn + 1]
    whole = elastic_force(depth_mm[:, : turn + 1], first, level_mm, stiffness, toe_mm).T
    arms = np.zeros((turn + 1, *tau_s.shape))
    arms[1:] = _kept(fade[:turn], take[:turn] * np.diff(whole, axis=0)[:, None])
    growing = rest * whole + arms.sum(axis=1)
    if turn == len(time_s) - 1:
        return np.asarray(growing.T)

    pressed = pressed_mm(depth_mm[:, : turn + 1], first, level_mm, toe_mm)
    weight = take[:turn] * np.exp(-(time_s[turn] - time_s[1 : turn + 1])[:, None, None] / tau_s)
    state = np.einsum("tkp,ptn->kpn", weight, np.diff(pressed, axis=1), optimize=True)
    later = None if slack_mm is None else slack_mm[:, turn + 1 :]
    demanded = np.moveaxis(pressed_mm(depth_mm[:, turn + 1 :], later, level_mm, toe_mm), 1, 0)
    always = np.ones((len(time_s) - 1 - turn, 1, len(rest)))
    springs_N = _any_path(
        demanded,
        np.concatenate([(rest[:, None] * pressed[:, -1])[None], state]),
        pressed[:, -1],
        np.concatenate([always, fade[turn:]], axis=1)[..., None],
        np.concatenate([always * rest, take[turn:]], axis=1)[..., None],
    )
    return np.concatenate([growing.T, np.einsum("tpn,pn->pt", springs_N, stiffness)], axis=1)


def _kept(fade: Float[np.ndarray, "t k p"], added: Float[np.ndarray, "t k p"]) -> Float[np.ndarray, "t k p"]:
    """x_i = fade_i x_(i-1) + added_i from x_(-1) = 0: a bidiagonal system for each arm of each row."""
    frames = len(added)
    if not frames:
        return added
    kept = np.empty((added[0].size, frames))
    band = np.ones((2, frames), order="F")
    for solution, fades, source in zip(
        kept, fade.reshape(frames, -1).T, added.reshape(frames, -1).T, strict=True
    ):
        band[1, :-1] = -fades[1:]
        solution[:] = dtbtrs(band, source, uplo="L", diag="U")[0]
    return np.asarray(kept.T.reshape(added.shape))


def last_growing_frame(depth_mm: Float[np.ndarray, "p t"]) -> int:
    """The last frame before any row's depth falls back by more than jitter, a thousandth of its largest."""
    back = np.maximum.accumulate(depth_mm, axis=1) - depth_mm
    touched = np.maximum.accumulate(depth_mm, axis=1) > 0
    falls = ((back > JITTER * depth_mm.max(axis=1, keepdims=True)) & touched).any(axis=0)
    return int(np.argmax(falls)) - 1 if falls.any() else depth_mm.shape[1] - 1


def _any_path(
    demanded_mm: Float[np.ndarray, "t p n"],
    parts: Float[np.ndarray, "k p n"],
    pressed_mm: Float[np.ndarray, "p n"],
    fade: Float[np.ndarray, "t k p 1"],
    take: Float[np.ndarray, "t k p 1"],
) -> Float[np.ndarray, "t p n"]:
    """Force of each spring over its stiffness, frame by frame from a known state.

    `parts` are the spring that never relaxes (fade 1) and the arms. Where the ball does not press, v moves
    such that their sum stays zero; where that is less than the ball demands, the ball has its way.
    """
    stiff = take.sum(axis=1)
    inverse_stiffness = -1 / stiff
    force = np.empty_like(demanded_mm)
    for i, wanted in enumerate(demanded_mm):
        parts = parts * fade[i]
        held = np.add.reduce(parts, axis=0)
        moved = np.maximum(held * inverse_stiffness[i], wanted - pressed_mm)
        parts += take[i] * moved
        pressed_mm = pressed_mm + moved
        np.add(held, stiff[i] * moved, out=force[i])
    return force
