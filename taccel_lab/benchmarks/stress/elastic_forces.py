# SPDX-License-Identifier: Apache-2.0
"""Elastic and viscous forces of tets in plain numpy: the stress's own, nothing of the solver's.

Stresses P = d psi / dF of the four materials by their textbook formulas (sources in
``taccel_lab/ipc/elasticity``). A linear tet has one F; a quadratic one takes the shape part at four
points, the volumetric part of their mean, and a guard on the Bernstein coefficients of det F (see
``docs/solver.md``), which are interpolated here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from taccel_lab.geometry import QuadraticMesh
from taccel_lab.geometry.quadratic import TET_EDGES
from taccel_lab.scene import MaterialModel, SoftBody

_POINTS = np.full((4, 4), (5 - 5**0.5) / 20) + np.eye(4) * (5**0.5 / 5)
"""Barycentric coordinates of the quadrature points of a quadratic tet."""
_THIRDS = np.array([p for p in np.ndindex(4, 4, 4, 4) if sum(p) == 3])
"""Exponents of the Bernstein polynomials of degree three in barycentric coordinates [20, 4]; a
third of them are the points whose values determine a cubic polynomial."""
_FROM_VALUES = np.linalg.inv(
    (6 / np.array([math.prod(map(math.factorial, p)) for p in _THIRDS]))
    * ((_THIRDS[:, None] / 3) ** _THIRDS).prod(axis=-1)
)
"""Bernstein coefficients [20] from the values at those points."""
_GUARDED = 0.1
_LOGARITHMIC = (MaterialModel.NEO_HOOKEAN, MaterialModel.MOONEY_RIVLIN)
"""Materials that cannot be inverted."""


def _transposed(a: np.ndarray) -> np.ndarray:
    return np.swapaxes(a, -1, -2)


def _cofactor(f: np.ndarray) -> np.ndarray:
    """d det F / dF, also where F cannot be inverted."""
    a, b, c = f[..., 0], f[..., 1], f[..., 2]
    return np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=-1)


def _times(scalars: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    return scalars[..., None, None] * matrices


@dataclass(frozen=True)
class ElasticLaw:
    """A material by its constants, arrays that broadcast with F [..., 3, 3] less its last axes."""

    model: MaterialModel
    mu: np.ndarray
    lam: np.ndarray
    ratio: np.ndarray

    @property
    def shape_lam(self) -> np.ndarray:
        """Part of lambda that stays with the shape part [Pa]: without it the coefficient of
        (ln J)^2 of a Mooney-Rivlin solid is negative."""
        return 2 * self.ratio * self.mu

    def piola(self, f: np.ndarray, lam: np.ndarray) -> np.ndarray:
        """First Piola-Kirchhoff stress for another lambda; 0 leaves the shape part [Pa]."""
        mu, j = self.mu, np.linalg.det(f)
        if self.model is MaterialModel.ST_VENANT_KIRCHHOFF:
            e = 0.5 * (_transposed(f) @ f - np.eye(3))
            trace = np.trace(e, axis1=-2, axis2=-1)
            return f @ (2 * _times(mu, e)) + _times(lam * trace, f)
        first = (f * f).sum(axis=(-2, -1))
        if self.model is MaterialModel.STABLE_NEO_HOOKEAN:
            m, volumetric = 4 / 3 * mu, lam + 5 / 6 * mu
            pressure = volumetric * (j - 1) - 0.75 * m
            return _times(m * first / (first + 1), f) + _times(pressure, _cofactor(f))
        c01 = 0.5 * mu * self.ratio
        c10 = 0.5 * mu - c01
        log_j = np.log(j)
        pull = ((lam - 4 * c01) * log_j - 2 * (c10 + 2 * c01)) / j
        bent = _times(first, f) - f @ _transposed(f) @ f
        return _times(2 * c10, f) + _times(2 * c01, bent) + _times(pull, _cofactor(f))

    def dilatation(self, f: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """e and de/dF."""
        if self.model is MaterialModel.ST_VENANT_KIRCHHOFF:
            return 0.5 * ((f * f).sum(axis=(-2, -1)) - 3), f
        return np.linalg.det(f) - 1, _cofactor(f)

    def pressure(self, e: np.ndarray) -> np.ndarray:
        """lambda u'(e) [Pa]."""
        slope = np.log1p(e) / (1 + e) if self.model in _LOGARITHMIC else e
        return (self.lam - self.shape_lam) * slope

    def guard(self, f: np.ndarray) -> np.ndarray:
        """Stress of the guard over mu from F [..., 20, 3, 3] at the points of ``_FROM_VALUES``, of
        which each stands for a twentieth of the volume."""
        if self.model not in _LOGARITHMIC:
            return np.zeros_like(f)
        coefficients = np.linalg.det(f) @ _FROM_VALUES.T
        y = np.clip(coefficients / _GUARDED, 1e-300, 1.0)
        slope = (2 * (1 - y) * np.log(y) - (1 - y) ** 2 / y) / _GUARDED
        return _times(slope @ _FROM_VALUES, _cofactor(f))


class SoftForces:
    """Forces of one soft body on its own nodes."""

    def __init__(self, body: SoftBody, environment: int) -> None:
        mesh = body.nodal_mesh
        self.tets = mesh.tets.astype(np.int64)
        self.node_count = mesh.node_count
        self.quadratic = isinstance(mesh, QuadraticMesh)
        rest = body.mesh.nodes_m
        if body.rest_positions_m is not None:
            rest = body.rest_positions_m[environment]
        edges = _transposed(rest[self.tets[:, 1:4]] - rest[self.tets[:, :1]])
        inverse = np.linalg.inv(edges)
        self.volumes = np.linalg.det(edges) / 6
        slopes = np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1)
        """Gradients of the barycentric coordinates [tet, 4, 3]."""
        self.gradients = (
            _quadratic_gradients(slopes, _POINTS) if self.quadratic else slopes[:, None]
        )
        """Gradients of the shape functions at the points [tet, point, node, 3]."""
        self.guarded_gradients = (
            _quadratic_gradients(slopes, _THIRDS / 3) if self.quadratic else None
        )
        count = len(self.tets)
        material = body.material
        mu, lam = (
            np.broadcast_to(getattr(material, name), count).astype(np.float64)
            for name in ("shear_modulus_pa", "lame_lambda_pa")
        )
        ratio = np.broadcast_to(material.mooney_ratio, count)
        self.law = ElasticLaw(material.model, mu[:, None], lam[:, None], ratio[:, None])
        steepest = np.linalg.norm(slopes, axis=-1).max(axis=1)
        self.stiffness_n_m = float(np.linalg.norm((lam + 2 * mu) * self.volumes * steepest**2))
        """Times the rounding of a coordinate: the rounding of the forces. Slivers have the most."""

    def deformations(self, x: np.ndarray) -> np.ndarray:
        """F at the points [tet, point, 3, 3] of nodes [node, 3]."""
        return np.einsum("tia,tqib->tqab", x[self.tets], self.gradients)

    def volume_ratios(self, x: np.ndarray) -> np.ndarray:
        """det F at all points, and what quadratic tets are guarded by: its Bernstein coefficients,
        or where the material bears inversion its values at thirds of the edges; shape [n]."""
        ratios = np.linalg.det(self.deformations(x)).ravel()
        if self.guarded_gradients is None:
            return ratios
        f = np.einsum("tia,tqib->tqab", x[self.tets], self.guarded_gradients)
        guarded = np.linalg.det(f)
        if not self.bears_inversion():
            guarded = guarded @ _FROM_VALUES.T
        return np.concatenate([ratios, guarded.ravel()])

    def bears_inversion(self) -> bool:
        """Whether the energy stays finite through inversion."""
        return self.law.model not in _LOGARITHMIC

    def elastic_gradient(self, x: np.ndarray) -> np.ndarray:
        """d(elastic energy)/dx [N], shape [node, 3]."""
        f = self.deformations(x)
        if not self.quadratic:
            return self._assembled(self.law.piola(f, self.law.lam), self.gradients)
        shape = self.law.piola(f, self.law.shape_lam)
        e, slope = self.law.dilatation(f)
        pressure = self.law.pressure(e.mean(axis=1, keepdims=True))
        total = self._assembled(shape + _times(pressure, slope), self.gradients)
        assert self.guarded_gradients is not None
        f = np.einsum("tia,tqib->tqab", x[self.tets], self.guarded_gradients)
        guard = _times(self.law.mu, self.law.guard(f))
        return total + self._assembled(guard, self.guarded_gradients)

    def _assembled(self, stress: np.ndarray, gradients: np.ndarray) -> np.ndarray:
        """Nodal sums of V/points P grad N."""
        weights = self.volumes[:, None] / gradients.shape[1]
        local = np.einsum("tq,tqab,tqib->tia", weights, stress, gradients)
        total = np.zeros((self.node_count, 3))
        np.add.at(total, self.tets.ravel(), local.reshape(-1, 3))
        return total


def _quadratic_gradients(slopes: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Gradients of the ten shape functions at barycentric points [q, 4]: [tet, q, 10, 3]."""
    corners = (4 * points - 1)[None, :, :, None] * slopes[:, None]
    middles = [
        4
        * (
            points[None, :, [j], None] * slopes[:, None, [i]]
            + points[None, :, [i], None] * slopes[:, None, [j]]
        )
        for i, j in TET_EDGES
    ]
    return np.concatenate([corners, *middles], axis=2)
