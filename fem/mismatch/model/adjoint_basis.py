"""Sensitivity of the recordings to the modulus of every piece of flesh, by projections and adjoint solves.

The leading pattern of forces, U_1 with its share a_1(t), carries nearly all of a recording's load. The
markers' displacement is projected on basis functions psi_k(t) = a_1(t) p_k: polynomials p_k over each pad,
in three directions. The projections of a field phi are y_k = psi_k . W phi
(fem.mismatch.model.marker_equations). The covariance of their noise is

    M_kl = psi_k . W psi_l

If a piece e of flesh is softer by x, the stiffness is K0 - x K_e. One adjoint solve per basis function gives
the derivatives d_ke of its projection for all pieces:

    d_ke = s Lambda_k' K_e U_1,      Lambda_k = K0^-1 L sum_t a_1(t) (W psi_k)(t)

Projections are stored whitened: uncorrelated, with unit variance. Parts of a field outside the basis count
neither in the score of a piece nor in its Fisher information.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy.polynomial.legendre import legvander2d
from scipy.sparse import csr_array

from fem.mismatch.model.marker_equations import MarkerEquations
from fem.mismatch.model.plain_model import Fields, GraspResponse, PlainModel
from fem.parallel_map import parallel_map
from fem.solid.strain_field import PLACE, FleshStrain, elastic_stress

DEGREE = 2
"""Degree of a pad's polynomials: six for each of three directions."""
LEAST_INFORMATION = 1e-5
"""Combinations of basis functions are dropped if rigid motions and scales explain all but this share."""


@dataclass(frozen=True, kw_only=True)
class GraspBasis:
    """One recording's basis: k whitened projections of v basis functions.

    `basis_functions`: psi, mm. `whitening`: (v, k). `moved`: Lambda_k at all nodes of the flesh. `plain`: the
    projections of s c(t).
    """

    equations: MarkerEquations
    basis_functions: Float[np.ndarray, "v f n 3"]
    whitening: Float[np.ndarray, "v k"]
    moved: Float[np.ndarray, "k m 3"]
    plain: Float[np.ndarray, " k"]

    def observed(self, field: Float[np.ndarray, "f n 3"]) -> Float[np.ndarray, " k"]:
        """The whitened projections of a displacement field at the markers, mm."""
        weighed = self.equations.weighed(field)
        return np.asarray(self.whitening.T @ np.tensordot(self.basis_functions, weighed, axes=3))


@dataclass(frozen=True, kw_only=True)
class AdjointBasis:
    """The bases of all recordings together; the modulus of the whole flesh is free.

    `cells`: d at four points of every element, per unit drop of modulus there. `plain`: the unit vector of a
    change of E.
    """

    grasps: tuple[GraspBasis, ...]
    cells: Float[np.ndarray, "q k"]
    plain: Float[np.ndarray, " k"]

    @classmethod
    def of(
        cls, base: PlainModel, points: FleshStrain, *, compliance: float, workers: int = 1
    ) -> "AdjointBasis":
        """`compliance`: s = 1/E of the plain model."""
        whitened = parallel_map(
            lambda recording: _whitened(base, recording, compliance), base.grasps, workers=workers
        )
        moved = base.displacements([loads for _, loads in whitened])
        grasps = tuple(
            replace(basis, moved=adjoint) for (basis, _), adjoint in zip(whitened, moved, strict=True)
        )
        cells = []
        for recording, adjoint in zip(base.grasps, moved, strict=True):
            pushed = _push(points, recording.moved[0], recording.solid.poisson_ratio)
            cells.append(compliance * np.asarray(pushed @ adjoint.reshape(len(adjoint), -1).T))
        plain = np.concatenate([grasp.plain for grasp in grasps])
        return cls(
            grasps=grasps,
            cells=np.hstack(cells),
            plain=plain / np.linalg.norm(plain),
        )

    def observed(self, fields: Fields) -> Float[np.ndarray, " k"]:
        """The projections of one field per recording, orthogonal to a change of E."""
        together = [basis.observed(field) for basis, field in zip(self.grasps, fields, strict=True)]
        return self.without_modulus(np.concatenate(together))

    def without_modulus(self, numbers: Float[np.ndarray, "*b k"]) -> Float[np.ndarray, "*b k"]:
        """The part of whitened projections that a change of E cannot explain."""
        return np.asarray(numbers - (numbers @ self.plain)[..., None] * self.plain)


def _whitened(
    base: PlainModel, recording: GraspResponse, compliance: float
) -> tuple[GraspBasis, Float[np.ndarray, "k m 3"]]:
    """One recording's basis, with adjoint fields still zero, and the loads of their solves."""
    equations = MarkerEquations.of(
        recording,
        compliance=compliance,
        gel_scale_sd=base.case.budget.gel_scale_sd,
        design_effect=1.0,
    )
    shapes, share = _polynomials(recording), recording.shares[:, 0]
    basis_functions = share[:, None, None] * shapes[:, None]
    touching = recording.touching
    in_contact = basis_functions[:, touching].reshape(len(basis_functions), -1)
    heavy = equations.weighed_in_contact(in_contact)
    weighed = np.zeros_like(basis_functions)
    weighed[:, touching] = heavy.reshape(len(heavy), -1, 3)
    covariance = in_contact @ heavy.T
    whole = in_contact**2 @ equations.weight_in_contact
    scale = 1 / np.sqrt(whole)
    size, way = np.linalg.eigh(covariance * scale * scale[:, None])
    keep = size > LEAST_INFORMATION
    whitening = scale[:, None] * way[:, keep] / np.sqrt(size[keep])
    forces = np.tensordot(whitening.T, np.tensordot(weighed, share, axes=([1], [0])), axes=1)
    loads = recording.loads(forces)
    plain = recording.tracks.unit_displacement * compliance
    basis = GraspBasis(
        equations=equations,
        basis_functions=basis_functions,
        whitening=whitening,
        moved=np.zeros_like(loads),
        plain=whitening.T @ np.tensordot(weighed, plain, axes=3),
    )
    return basis, loads


def _polynomials(recording: GraspResponse) -> Float[np.ndarray, "v n 3"]:
    """Legendre polynomials up to DEGREE over each pad's markers, in each of three directions."""
    orders = [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]
    shapes = []
    for number, pad in enumerate(recording.case.history.pads):
        flat = pad.rest_mm[:, :2]
        low, high = flat.min(axis=0), flat.max(axis=0)
        x, y = (2 * (flat - low) / np.maximum(high - low, 1e-9) - 1).T
        values = legvander2d(x, y, [DEGREE, DEGREE]).reshape(len(flat), DEGREE + 1, DEGREE + 1)
        on_pad = recording.pad_of_marker == number
        for i, j in orders:
            for way in np.eye(3):
                shape = np.zeros((len(on_pad), 3))
                shape[on_pad] = values[:, i, j, None] * way
                shapes.append(shape)
    return np.stack(shapes)


def _push(points: FleshStrain, moved: Float[np.ndarray, "n 3"], poisson_ratio: float) -> csr_array:
    """K_e U for the flesh at each of the four points of every element: (4 m, 3 n)."""
    stress = elastic_stress(points.strain(moved[None])[0], poisson_ratio=poisson_ratio)
    flux = (stress * points.volume_mm3[..., None])[..., PLACE]  # (m, 4, 3, 3)
    entries = np.swapaxes(flux @ points.slope, 2, 3).reshape(-1, 30)
    dofs = (3 * points.mesh.tets[:, :, None] + np.arange(3)).reshape(-1, 30)
    columns = np.repeat(dofs, 4, axis=0)
    start = np.arange(0, columns.size + 1, 30)
    shape = (len(entries), 3 * points.n_nodes)
    return csr_array((entries.ravel(), columns.ravel(), start), shape=shape)
