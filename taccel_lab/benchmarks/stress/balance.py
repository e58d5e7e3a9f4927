# SPDX-License-Identifier: Apache-2.0
"""The force residual at the end of a step, put together anew in numpy.

Elastic forces, inertia, weight and the stiffness of affine bodies are computed here
from the scene; forces of contact and friction are those that a user reads (``Outputs``), which
``contact_law`` holds against their laws. What is left on the unknowns is compared with the
tolerance that the step claims to have met. Bodies with joints are left out (their forces are the
joints' own), and steps of a dynamic scene that were taken in parts (the velocities between the
parts are not kept).

Stresses P = d psi / dF of the four materials are by their textbook formulas (sources in
``taccel_lab/ipc/elasticity``), nothing of the solver's. A linear tet has one F; a quadratic one
takes the shape part at four points, the volumetric part of their mean, and a guard on the Bernstein
coefficients of det F (see ``docs/solver.md``), which are interpolated here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from taccel_lab.geometry import QuadraticMesh
from taccel_lab.geometry.quadratic import TET_EDGES
from taccel_lab.model import BodyKind, Model
from taccel_lab.scene import MaterialModel, SoftBody, TimeScheme
from taccel_lab.solvers import SolverConfig
from taccel_lab.state import State

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
        self.gradients = quadratic_gradients(slopes, _POINTS) if self.quadratic else slopes[:, None]
        """Gradients of the shape functions at the points [tet, point, node, 3]."""
        self.guarded_gradients = (
            quadratic_gradients(slopes, _THIRDS / 3) if self.quadratic else None
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


def quadratic_gradients(slopes: np.ndarray, points: np.ndarray) -> np.ndarray:
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


@dataclass(frozen=True)
class Snapshot:
    """A state on the host: what a step starts from, and what it may change."""

    positions: np.ndarray
    velocities: np.ndarray
    poses: np.ndarray
    history: tuple[np.ndarray, ...]
    """Positions and velocities one step earlier, length of the step before and the contact forces
    at its end; empty without BDF2."""

    @classmethod
    def of(cls, state: State) -> Snapshot:
        h = state.history
        history = () if h is None else h.arrays()
        return cls(
            positions=state.positions.numpy().copy(),
            velocities=state.velocities.numpy().copy(),
            poses=state.poses.numpy().copy(),
            history=tuple(array.numpy().copy() for array in history),
        )

    def arrays(self) -> list[tuple[str, np.ndarray]]:
        """All arrays [env_count, ...] by name."""
        names = ("previous positions", "previous velocities", "previous step length")
        names += ("previous contact forces",)
        own = [
            ("positions", self.positions),
            ("velocities", self.velocities),
            ("poses", self.poses),
        ]
        return own + list(zip(names, self.history, strict=False))


def _part(pair: tuple[float, float]) -> float:
    return pair[0] / pair[1]


class ForceBalance:
    """Forces of a model's bodies, environment by environment."""

    def __init__(self, model: Model, config: SolverConfig) -> None:
        self.model, self.config = model, config
        self.scene = model.scene
        self.soft = [
            [SoftForces(body, env) for body in self.scene.soft_bodies]
            for env in range(model.rest_count)
        ]
        self.masses = model.masses.numpy()
        self.weighs = model.gravity_scale.numpy()
        self.parents, self.weights = model.parents.numpy(), model.weights.numpy()
        self.lengths = model.affine.lengths.numpy()
        self.stiffness = model.affine.stiffness.numpy()
        self.present, self.bodies = model.present.numpy() != 0, model.surface.node_bodies.numpy()
        self.judged = self._judged_rows()

    def _judged_rows(self) -> np.ndarray:
        """Free nodes, without the control nodes of bodies with joints."""
        rows = self.model.free_nodes.numpy().copy()
        names = [body.name for body in self.scene.affine_bodies]
        left_out: list[int] = []
        for joint in self.scene.joints:
            for name in (joint.first, joint.second):
                if name in names:
                    first = self.model.affine.first_control + 4 * names.index(name)
                    left_out += range(first, first + 4)
        return rows[~np.isin(rows, left_out)]

    def soft_nodes(self) -> list[slice]:
        """Nodes of each soft body."""
        return [b.node_slice for b in self.model.bodies if b.kind is BodyKind.SOFT]

    def volume_ratios(self, env: int, x: np.ndarray) -> list[tuple[bool, np.ndarray]]:
        """Ratios of each soft body: whether it bears inversion, and all det F."""
        forces = self.soft[env % self.model.rest_count]
        return [
            (body.bears_inversion(), body.volume_ratios(x[nodes]))
            for body, nodes in zip(forces, self.soft_nodes(), strict=True)
        ]

    def residual(
        self,
        env: int,
        before: Snapshot,
        now: Snapshot,
        normal: np.ndarray,
        friction: np.ndarray,
        load: np.ndarray,
    ) -> tuple[float, float]:
        """(force that is left, what is allowed) of the body that is furthest from it [N]: sums of
        magnitudes over its nodes; the least of what each of ``_step_ratios`` leaves.

        ``normal``, ``friction``: forces of contact on each node [N], [node_count, 3]; ``load``: the
        same of what the user set. Only for steps taken as a whole, or quasi-static.
        """
        x = now.positions[env]
        still = -(normal + friction + load)
        noise = 0.0
        forces = self.soft[env % self.model.rest_count]
        for body, nodes in zip(forces, self.soft_nodes(), strict=True):
            still[nodes] += body.elastic_gradient(x[nodes])
            noise += body.stiffness_n_m * np.abs(x[nodes]).max()
        forces_n = np.linalg.norm(normal, axis=1)
        if self.scene.time.quasi_static:
            totals = [still]
        else:
            ratios = self._step_ratios(env, before)
            totals = [still + self._inertia(env, before, now, ratio) for ratio in ratios]
        left = []
        for total in totals:
            reduced, stiff = self._reduced(total, x)
            rounding = (noise + stiff) * 8 * np.finfo(float).eps
            left.append(self._worst(env, np.linalg.norm(reduced, axis=1), forces_n, rounding))
        return min(left, key=_part)

    def _worst(
        self, env: int, sizes: np.ndarray, forces_n: np.ndarray, rounding: float
    ) -> tuple[float, float]:
        """What ``residual`` gives, from the sizes of forces that are left on the nodes [N]."""
        worst = (0.0, self.allowance(0.0))
        for body in np.unique(self.bodies[self.judged]):
            if self.present[env][body]:
                rows = self.judged[self.bodies[self.judged] == body]
                force = min(forces_n[self.bodies == body].sum(), 0.5 * forces_n.sum())
                allowed = self.allowance(float(force)) + np.sqrt(len(rows)) * rounding
                worst = max(worst, (float(sizes[rows].sum()), float(allowed)), key=_part)
        return worst

    def _step_ratios(self, env: int, before: Snapshot) -> tuple[float, ...]:
        """Length of the step over that of the one before as BDF2 may have taken it, 0 for implicit
        Euler: so is a step without a past taken, one that has become much longer, and one in which
        BDF2 met an impact, which nothing here tells."""
        dt = self.scene.time.dt_s
        if self.scene.time.scheme is TimeScheme.BDF2 and before.history:
            last = before.history[2][env]
            if last > 0 and dt <= (1 + 2**0.5) * last:
                return (dt / last, 0.0)
        return (0.0,)

    def _inertia(self, env: int, before: Snapshot, now: Snapshot, ratio: float) -> np.ndarray:
        """Mass times acceleration, less the weight [N]."""
        x = now.positions[env]
        dt = self.scene.time.dt_s
        x0, v0 = before.positions[env], before.velocities[env]
        span, carry = dt * (1 + ratio) / (1 + 2 * ratio), ratio**2 / (1 + 2 * ratio)
        if carry > 0:
            past, fast = before.history[0][env], before.history[1][env]
            x0, v0 = x0 + carry * (x0 - past), v0 + carry * (v0 - fast)
        masses = self.masses[env % len(self.masses)][:, None]
        gravity = np.array(self.scene.time.gravity_m_s2)
        pull = masses * self.weighs[:, None] * gravity
        return masses * ((x - x0) / span - v0) / span - pull

    def _reduced(self, total: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, float]:
        """Forces on vertices moved to control nodes, with the stiffness of affine bodies."""
        embedded = np.flatnonzero(self.parents >= 0)
        for k in range(4):
            share = self.weights[embedded, k][:, None] * total[embedded]
            np.add.at(total, self.parents[embedded] + k, share)
        noise = 0.0
        for body in range(self.model.affine.count):
            first = self.model.affine.first_control + 4 * body
            length, stiffness = self.lengths[body], self.stiffness[body]
            a = x[first + 1 : first + 4].T / length
            gradient = 0.5 * stiffness * a @ (a.T @ a - np.eye(3)) / length
            total[first + 1 : first + 4] += gradient.T
            noise += stiffness / length
        return total, noise

    def allowance(self, contact_force_n: float) -> float:
        """Residual that the settings of the solver allow a body [N], rounding aside."""
        c = self.config
        return max(c.absolute_tolerance_n, c.relative_tolerance * contact_force_n)
