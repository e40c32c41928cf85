"""The coarse fruit of injected_mismatch, its flesh losing juice: stepped through time on the truth's mesh.

In terms of a, which fades, the stress of the law is 2 mu eps + lambda ((1 - s) tr eps + s a) 1. Over a step
in which tr eps runs straight, with e = exp(-dt / tau) and q = (1 - e) tau / dt,

    a' = e a + q (tr eps' - tr eps)

so that the displacement u' after it answers to a lower lambda, and to what is left of earlier strains:

    (mu K_mu + lambda (1 - s (1 - q)) K_lambda) u' = f' - s lambda K_lambda (e u_a - q u)
"""

from dataclasses import replace
from functools import cache

import numpy as np
from coarse_fruit import NU
from injected_mismatch import E_MPA, TIME_S, Altered, Recording, bare_grasps, true_mesh, true_pads

from fem.elements.assembly import unit_lame_constants
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.pad_link import pad_link


@cache
def drained_more(share: float, tau_s: float) -> dict[tuple[str, bytes], np.ndarray]:
    """By pad and its axes: what drainage adds to its markers' displacement for E = 1 MPa."""
    mesh = true_mesh()
    mu, lame = unit_lame_constants(NU)
    dt = TIME_S[1] - TIME_S[0]
    fade = np.exp(-dt / tau_s)
    ramp = (1 - fade) * tau_s / dt
    lowered = lame * (1 - share * (1 - ramp))
    ratio = lowered / (2 * (lowered + mu))
    firmer = 2 * mu * (1 + ratio)
    solid = UnitModulusSolid.factorise(mesh, poisson_ratio=ratio, support="free")
    bare, nodes = bare_grasps(mesh)
    solid = replace(solid, contact_nodes=nodes)
    links = [[pad_link(pad, solid) for pad in pads] for pads in bare]
    loads = np.zeros((len(TIME_S), len(bare), *mesh.nodes_mm.shape))
    for grasp, (pad_links, pads) in enumerate(zip(links, bare, strict=True)):
        loads[:, grasp, nodes] = sum(
            link.nodal_force(pad.force_N) for link, pad in zip(pad_links, pads, strict=True)
        )
    moved = [np.zeros_like(loads[0])]
    fading = np.zeros_like(loads[0])
    for force in loads[1:]:
        kept = fade * fading - ramp * moved[-1]
        pull = share * lame * (solid.parts.k_lambda @ kept.reshape(len(kept), -1).T).T.reshape(kept.shape)
        moved.append(solid.displacement(force - pull) / firmer)
        fading = kept + ramp * moved[-1]
    by_pad = {}
    for grasp, (pad_links, pads) in enumerate(zip(links, true_pads(), strict=True)):
        at_nodes = np.stack(moved)[:, grasp, nodes]
        for link, true in zip(pad_links, pads, strict=True):
            by_pad[true.name, true.axes.tobytes()] = link.at_markers(at_nodes) - true.unit
    return by_pad


def drained(share: float, tau_s: float) -> Altered:
    """Every pad as it is where the flesh drains; its jaw follows the skin."""
    more = drained_more(share, tau_s)

    def change(pad: Recording) -> Recording:
        moved = more[pad.name, pad.axes.tobytes()] / E_MPA
        return replace(pad, position_mm=pad.position_mm + moved, origin_mm=pad.origin_mm + moved.mean(axis=1))

    return change
