# SPDX-License-Identifier: Apache-2.0
"""The force residual at the end of a step, put together anew in numpy.

Elastic and viscous forces, inertia, weight and the stiffness of affine bodies are computed here
from the scene; forces of contact and friction are those that a user reads (``Outputs``), which
``contact_law`` holds against their laws. What is left on the unknowns is compared with the
tolerance that the step claims to have met. Bodies with joints are left out (their forces are the
joints' own), and steps of a dynamic scene that were taken in parts (the velocities between the
parts are not kept).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.benchmarks.stress.elastic_forces import SoftForces
from taccel_lab.model import BodyKind, Model
from taccel_lab.scene import TimeScheme
from taccel_lab.solvers import SolverConfig
from taccel_lab.state import State


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
        """Of each soft body: whether it bears inversion, and all det F."""
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
        magnitudes over its nodes.

        ``normal``, ``friction``: forces of contact on each node [N], [node_count, 3]; ``load``: the
        same of what the user set. Only for steps taken as a whole, or quasi-static.
        """
        ratios = (0.0,) if self.scene.time.quasi_static else self._step_ratios(env, before)
        given = (env, before, now, normal, friction, load)
        return min((self._residual(*given, ratio) for ratio in ratios), key=_part)

    def _residual(
        self,
        env: int,
        before: Snapshot,
        now: Snapshot,
        normal: np.ndarray,
        friction: np.ndarray,
        load: np.ndarray,
        ratio: float,
    ) -> tuple[float, float]:
        """``residual`` of a step with one of ``_step_ratios``."""
        x = now.positions[env]
        total = -(normal + friction + load)
        noise = 0.0
        forces = self.soft[env % self.model.rest_count]
        for body, nodes in zip(forces, self.soft_nodes(), strict=True):
            total[nodes] += body.elastic_gradient(x[nodes])
            noise += body.stiffness_n_m * np.abs(x[nodes]).max()
        if not self.scene.time.quasi_static:
            total += self._inertia(env, before, now, ratio)
        total, stiff = self._reduced(total, x)
        noise += stiff
        noise *= 8 * np.finfo(float).eps
        sizes, forces_n = np.linalg.norm(total, axis=1), np.linalg.norm(normal, axis=1)
        worst = (0.0, self.allowance(0.0))
        for body in np.unique(self.bodies[self.judged]):
            if self.present[env][body]:
                rows = self.judged[self.bodies[self.judged] == body]
                force = min(forces_n[self.bodies == body].sum(), 0.5 * forces_n.sum())
                allowed = self.allowance(float(force)) + np.sqrt(len(rows)) * noise
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
