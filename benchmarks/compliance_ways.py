"""Three ways to the compliance of all candidate contact dofs, on the 60k mesh of solver_peers.py.

    OPENBLAS_NUM_THREADS=1 python benchmarks/compliance_ways.py

prints CPU seconds (the least of three runs) of: the factorisation in the best order and the compliance from
it (fem.sparse.condensed_compliance); the factorisation with the candidates forced to the end of the order,
whose last front then holds their condensed stiffness, and its inverse; and plain solves.
"""

import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.linalg.lapack import dpotri
from solver_candidates import NU
from solver_peers import build

import fem.sparse.fronts
from fem.elements.assembly import assemble
from fem.sparse.condensed_compliance import compliance
from fem.sparse.elimination_order import EliminationTree, Groups, elimination_tree, tree_in_order
from fem.sparse.multifrontal import cholesky


def main(size: str) -> None:
    """Build, factorise both ways, compare, print."""
    with tempfile.TemporaryDirectory() as folder:
        build(path := Path(folder, "case.npz"), size)
        with np.load(path) as stored:
            case = dict(stored)
    free = case["free"]
    stiffness = assemble(case["nodes"], case["tets"]).for_unit_modulus(poisson_ratio=NU)[free][:, free]
    last = np.searchsorted(free, (3 * case["candidates"][:, None] + np.arange(3)).ravel())
    plan = fem.sparse.fronts.fronts(stiffness)
    spent, factor = least(lambda: cholesky(plan, stiffness.data))
    condensing, _ = least(lambda: compliance(factor, last))
    hundred, _ = least(lambda: factor.solve(case["load"]))
    line = "{:17}{:4.0f} GFlop  factor {:5.2f} s  {} {:5.2f} s"
    print(f"{len(free)} dofs, {len(last)} candidates")
    print(line.format("best order", gigaflops(plan), spent, "compliance", condensing))

    def candidates_last(groups: Groups) -> EliminationTree:
        order = elimination_tree(groups).order
        is_last = np.isin(order, groups.of_dof[last])
        return tree_in_order(groups, np.concatenate([order[~is_last], order[is_last]]))

    fem.sparse.fronts.elimination_tree = candidates_last
    plan = fem.sparse.fronts.fronts(stiffness)
    spent, factor = least(lambda: cholesky(plan, stiffness.data))
    corner = factor.triangle[-1][-len(last) :, -len(last) :].copy(order="F")
    inverting, _ = least(lambda: dpotri(corner, lower=1))
    print(line.format("candidates last", gigaflops(plan), spent, "inverse   ", inverting))
    print(f"plain solves     {hundred * len(last) / 100:5.1f} s")


def gigaflops(plan: fem.sparse.fronts.Fronts) -> float:
    """Of the factorisation's dense fronts."""
    p, q = np.diff(plan.start).astype(float), np.array([len(rows) for rows in plan.rows], dtype=float)
    return float((p**3 / 3 + p**2 * q + p * q**2).sum() / 1e9)


def least(task):
    """CPU seconds and result."""
    seconds = []
    for _ in range(3):
        begun = time.process_time()
        result = task()
        seconds.append(time.process_time() - begun)
    return min(seconds), result


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "60k")
