# SPDX-License-Identifier: Apache-2.0
"""Referees of a step: each looks at what the solver left behind and trusts none of what it says.

They say nothing about environments that failed with a cause, except that these must be back where
the step began. Whatever they find in an environment that claims to have converged is a *silent*
failure.

Whether an edge passes through a face is decided in exact rational arithmetic. The fast test in
floating point counts volumes within rounding as zero and touching as crossing, so that it misses
nothing; faces that are flat slivers in one plane with an edge then count as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from taccel_lab.benchmarks.stress.balance import ForceBalance, Snapshot
from taccel_lab.benchmarks.stress.case import StressCase
from taccel_lab.benchmarks.stress.contact_law import (
    SurfaceMotion,
    contact_forces,
    friction_forces,
    friction_limits,
)
from taccel_lab.benchmarks.stress.gaps import SurfacePairs
from taccel_lab.bodies.crossings import crossing_pairs
from taccel_lab.bodies.primitives import Ball, unique_edges
from taccel_lab.ipc.contact.overlap_search import Overlap, OverlapKind, find_overlaps
from taccel_lab.ipc.potentials.friction import FrozenContacts
from taccel_lab.model import Model
from taccel_lab.outputs import Outputs
from taccel_lab.scene import SoftBody
from taccel_lab.solvers import SolverConfig, SolverIPC, StepReport
from taccel_lab.solvers.step_report import EnvStatus
from taccel_lab.state import State

Point = tuple[Fraction, Fraction, Fraction]


def _exact(point: np.ndarray) -> Point:
    x, y, z = (Fraction(float(value)) for value in point)
    return x, y, z


def _volume(a: Point, b: Point, c: Point, d: Point) -> Fraction:
    """Six times the signed volume of a tet."""
    u, v, w = ([p[k] - a[k] for k in range(3)] for p in (b, c, d))
    return (
        u[0] * (v[1] * w[2] - v[2] * w[1])
        - u[1] * (v[0] * w[2] - v[2] * w[0])
        + u[2] * (v[0] * w[1] - v[1] * w[0])
    )


def pierces(segment: np.ndarray, triangle: np.ndarray) -> bool:
    """Whether a segment [2, 3] meets a triangle [3, 3] that it does not lie in a plane with."""
    p, q = _exact(segment[0]), _exact(segment[1])
    a, b, c = (_exact(corner) for corner in triangle)
    above, below = _volume(a, b, c, p), _volume(a, b, c, q)
    if above * below > 0 or above == below == 0:
        return False
    sides = [_volume(p, q, a, b), _volume(p, q, b, c), _volume(p, q, c, a)]
    return all(side >= 0 for side in sides) or all(side <= 0 for side in sides)


def really_cross(model: Model, x: np.ndarray, item: Overlap) -> bool:
    """Whether any of the crossings that were found between two bodies is one.

    ``x``: node positions of the environment [node_count, 3]. What is no crossing of surfaces is
    taken as it is.
    """
    if item.kind not in (OverlapKind.CROSSING, OverlapKind.SELF_CROSSING):
        return True
    surfaces = [_surface(model, x, name) for name in (item.first, item.second)]
    if any(len(faces) == 0 for _, faces in surfaces):
        return True
    same = item.first == item.second
    for (nodes, faces), (others, around) in (surfaces, surfaces[::-1]):
        edges = unique_edges(faces).astype(np.int64)
        ids = (edges, around) if same else (None, None)
        edge, face = crossing_pairs(nodes[edges], others[around], *ids)
        pairs = zip(nodes[edges[edge]], others[around[face]], strict=True)
        if any(pierces(segment, triangle) for segment, triangle in pairs):
            return True
    return False


def _surface(model: Model, x: np.ndarray, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and faces of a body; no faces of a ball or a plane."""
    index = model.body_id(name)
    body, nodes = model.scene.bodies[index], x[model.bodies[index].node_slice]
    mesh = body.nodal_mesh if isinstance(body, SoftBody) else getattr(body, "shape", None)
    if mesh is None or isinstance(mesh, Ball):
        return nodes, np.zeros((0, 3), dtype=np.int64)
    return nodes, mesh.faces.astype(np.int64)


REACH = 0.4
"""Part of dhat within which every pair of primitives of two bodies has to repel."""
ENERGY_SLACK = 0.25
"""Part of the energy by which it may rise in a step of implicit Euler on which nothing works. For
convex energies that is zero; where elements buckle or a body tips from facet to facet, tenths of
a per cent, and rarely a tenth, are gained."""

LAW_ROUNDING = 1e-6
"""Part of all forces by which they may differ from their laws. Coordinates near 0.1 m resolve the
smallest gaps that occur (1e-11 m) to that."""


@dataclass(frozen=True)
class StressFinding:
    """What a referee objects to."""

    referee: str
    env: int
    says: str

    def __str__(self) -> str:
        return f"{self.referee} (environment {self.env}): {self.says}"


@dataclass(frozen=True)
class Taken:
    """A step that was taken, and all that is looked at."""

    report: StepReport
    before: Snapshot
    now: Snapshot
    target: np.ndarray
    """Poses that were asked for, [env_count, kinematic_count, 7]."""
    normal: np.ndarray
    """Contact force on each node [N], [env_count, node_count, 3]."""
    friction: np.ndarray
    load: np.ndarray
    """Force of the user on each node [N]."""
    pairs: list[dict[str, np.ndarray]]
    """What is in contact in each environment at the end (``Collisions.snapshot``)."""
    frozen: FrozenContacts | None
    """Friction as it was frozen last; None without."""
    static_m: np.ndarray
    """Sliding in the step below which friction is static [m], [env_count]."""
    energies: dict[str, np.ndarray]
    """Stored and kinetic energies by name [J], [env_count] each; empty when not watched."""
    energies_before: dict[str, np.ndarray]
    """Energies after the step before; empty for the first one."""


class Referees:
    """All referees of one case."""

    def __init__(self, case: StressCase, model: Model, config: SolverConfig) -> None:
        self.case, self.model, self.config = case, model, config
        self.balance = ForceBalance(model, config)
        self.surfaces = SurfacePairs(model)
        self.present = model.present.numpy() != 0
        self.residual_ratio = 0.0
        """Largest residual found over what is allowed."""
        self.balanced_steps = 0
        """Converged steps whose residual was put together anew, in all environments."""
        self.smallest_gap = np.inf
        self.inverted_legally = False
        """Whether a tet of a material that bears it was inverted."""

    def findings(self, taken: Taken, state: State, step: int) -> list[StressFinding]:
        """Everything that is wrong after a step."""
        found: list[StressFinding] = []
        converged = taken.report.converged
        for env in range(self.model.env_count):
            if not converged[env]:
                found += rolled_back(taken, env)
                continue
            broken = not_finite(taken, env)
            found += broken
            if broken:
                continue
            found += missed_target(taken, env)
            found += self.gaps(taken, env)
            found += reaction(taken, env)
            found += self.laws(taken, env)
            found += self.energy(taken, env)
            inverted = self.volumes(taken, env)
            # Forces of what is inside out are not numbers.
            found += inverted or self.forces(taken, env)
        finite = np.isfinite(taken.now.positions).all(axis=(1, 2))
        if (converged & finite).any():
            found += self.intersections(state, converged & finite)
            says = self.case.expect(self.model, state, step) if self.case.expect else None
            if says is not None and converged.all():
                found.append(StressFinding("expectation", 0, says))
        return found

    # Geometry --------------------------------------------------------------------------------

    def intersections(self, state: State, judged: np.ndarray) -> list[StressFinding]:
        """Edges through faces, bodies inside bodies, nodes below planes, where ``judged``."""
        found = []
        x = state.positions.numpy()
        for env, items in enumerate(find_overlaps(self.model, state)):
            for item in items:
                if judged[env] and really_cross(self.model, x[env], item):
                    says = f"{item.first} and {item.second}: {item.kind}, {item.where}"
                    found.append(StressFinding("intersection", env, says))
        return found

    def volumes(self, taken: Taken, env: int) -> list[StressFinding]:
        """Inverted elements, at all quadrature points and corners."""
        found = []
        bodies = self.balance.volume_ratios(env, taken.now.positions[env])
        for index, (bears, ratios) in enumerate(bodies):
            if ratios.min() > 0:
                continue
            self.inverted_legally |= bears
            if not bears:
                says = (
                    f"{(ratios <= 0).sum()} points of soft body {index}, det F {ratios.min():.3g}"
                )
                found.append(StressFinding("inversion", env, says))
        return found

    def gaps(self, taken: Taken, env: int) -> list[StressFinding]:
        """Gaps that are gone, and pairs within reach that the solver did not see."""
        near = self.surfaces.nearer_than(
            taken.now.positions[env], self.present[env], REACH * self.config.dhat_m
        )
        if len(near.gaps_m) == 0:
            return []
        worst = int(near.gaps_m.argmin())
        gap, said = float(near.gaps_m[worst]), float(taken.report.min_distance_m[env])
        self.smallest_gap = min(self.smallest_gap, gap)
        if gap <= 0:
            return [StressFinding("gap", env, f"{gap:.3g} m at {near.where(worst)}")]
        # Distances are rounded like coordinates; a gap of 1e-12 m is not known to six digits.
        if said > gap * (1 + 1e-6) + 1e-15:
            says = f"{near.where(worst)} are {gap:.6g} m apart, the report says {said:.6g} m"
            return [StressFinding("missed contact", env, says)]
        return []

    # Forces ----------------------------------------------------------------------------------

    def forces(self, taken: Taken, env: int) -> list[StressFinding]:
        """The residual, put together anew."""
        whole = taken.report.substeps[env] == 1
        if not (whole or self.model.scene.time.quasi_static) or not len(self.balance.judged):
            return []
        forces = (taken.normal[env], taken.friction[env], taken.load[env])
        left, allowed = self.balance.residual(env, taken.before, taken.now, *forces)
        self.residual_ratio = max(self.residual_ratio, left / allowed)
        self.balanced_steps += 1
        if left <= 1.01 * allowed:
            return []
        says = f"{left:.3g} N are left, {allowed:.3g} N are allowed"
        says += f" (the report says {taken.report.residual_n[env]:.3g} N)"
        return [StressFinding("residual", env, says)]

    def laws(self, taken: Taken, env: int) -> list[StressFinding]:
        """Forces of contact and friction that are not those of their laws."""
        pairs, x = taken.pairs[env], taken.now.positions[env]
        contact = contact_forces(pairs, x, self.model)
        found = differs("contact law", env, taken.normal[env], contact.on_nodes)
        if taken.frozen is None:
            return found + differs("friction law", env, taken.friction[env], np.zeros_like(x))
        # Where a step was taken in parts only the last one counts, whose start is not kept.
        if taken.report.substeps[env] != 1:
            return found
        before = taken.before
        motion = SurfaceMotion(
            x - before.positions[env],
            *(p[env].reshape(-1, 7) for p in (before.poses, taken.now.poses)),
        )
        rubbing = friction_forces(taken.frozen, env, motion, taken.static_m[env], self.model)
        found += differs("friction law", env, taken.friction[env], rubbing.on_nodes)
        said, right = rubbing.of_pairs, friction_limits(pairs, contact.of_pairs, self.model)
        return found + differs("friction limit", env, np.sort(said), np.sort(right))

    def energy(self, taken: Taken, env: int) -> list[StressFinding]:
        """Energy that nothing has given."""
        if not (self.case.watches_energy and taken.energies and taken.energies_before):
            return []
        before = sum(float(value[env]) for value in taken.energies_before.values())
        now = sum(float(value[env]) for value in taken.energies.values())
        parts = {n: float(v[env]) for n, v in taken.energies_before.items() if n != "weight"}
        weight = abs(
            float(taken.energies.get("weight", np.zeros(env + 1))[env])
            - float(taken.energies_before.get("weight", np.zeros(env + 1))[env])
        )
        scale = sum(abs(value) for value in parts.values()) + weight
        slack = ENERGY_SLACK * scale
        # What the residual that is allowed may do along the way.
        moved_m = np.linalg.norm(taken.now.positions[env] - taken.before.positions[env])
        # The nodal contact forces on one side.
        contact_n = 0.5 * float(np.linalg.norm(taken.normal[env], axis=-1).sum())
        slack += self.balance.allowance(contact_n) * float(moved_m)
        if now - before <= slack:
            return []
        says = f"rose by {now - before:.3g} J of {scale:.3g} J"
        return [StressFinding("energy", env, says)]


# Referees that need nothing but the step --------------------------------------------------------


def rolled_back(taken: Taken, env: int) -> list[StressFinding]:
    """An environment that failed is where it was, bit by bit."""
    found = []
    for (name, before), (_, now) in zip(taken.before.arrays(), taken.now.arrays(), strict=True):
        if not np.array_equal(before[env], now[env], equal_nan=True):
            off = np.abs(np.asarray(now[env]) - before[env]).max()
            status = EnvStatus(taken.report.status[env]).name
            says = f"{name} differ by {off:.3g} from the start of the step that failed ({status})"
            found.append(StressFinding("rollback", env, says))
    return found


def not_finite(taken: Taken, env: int) -> list[StressFinding]:
    """NaN or infinite values in a state or its forces."""
    arrays = [*taken.now.arrays(), ("normal forces", taken.normal), ("friction", taken.friction)]
    return [
        StressFinding("not a number", env, f"{name} hold {bad} values that are not finite")
        for name, array in arrays
        if (bad := int((~np.isfinite(array[env])).sum()))
    ]


def missed_target(taken: Taken, env: int) -> list[StressFinding]:
    """A kinematic body that is not where its target is."""
    poses = taken.now.poses[env].reshape(taken.target[env].shape)
    off = float(np.abs(poses - taken.target[env]).max(initial=0.0))
    return [] if off <= 1e-12 else [StressFinding("target", env, f"missed by {off:.3g}")]


def reaction(taken: Taken, env: int) -> list[StressFinding]:
    """Contact and friction give no momentum: they act on two bodies in opposite directions."""
    found = []
    for name, force in (("contact", taken.normal[env]), ("friction", taken.friction[env])):
        total, scale = np.linalg.norm(force.sum(axis=0)), np.linalg.norm(force, axis=-1).sum()
        if total > 1e-9 * scale:
            says = f"forces of {name} add up to {total:.3g} N of {scale:.3g} N"
            found.append(StressFinding("reaction", env, says))
    return found


def differs(referee: str, env: int, said: np.ndarray, right: np.ndarray) -> list[StressFinding]:
    """Forces that are off by more than rounding [N]."""
    if said.shape != right.shape:
        return [StressFinding(referee, env, f"{len(said)} forces where there are {len(right)}")]
    scale = max(np.abs(said).sum(), np.abs(right).sum())
    off = np.abs(said - right).sum()
    if off <= LAW_ROUNDING * scale + 1e-15:
        return []
    return [StressFinding(referee, env, f"{off:.3g} N of {scale:.3g} N are not those of the law")]


def take(
    solver: SolverIPC,
    outputs: Outputs,
    state: State,
    target: np.ndarray,
    watch_energy: bool,
    earlier: Taken | None,
) -> Taken:
    """One step, with all that the referees look at; ``earlier`` is the step before."""
    before = Snapshot.of(state)
    report = solver.step(state, target)
    outputs.update(state)
    load, friction = state.external_forces, solver.friction
    watched = outputs.update(state).energies if watch_energy else {}
    return Taken(
        report=report,
        before=before,
        now=Snapshot.of(state),
        target=target,
        pairs=[solver.collisions.snapshot(env) for env in range(solver.model.env_count)],
        frozen=None if friction is None else friction.frozen,
        static_m=np.zeros(0) if friction is None else friction.eps_u_m.numpy().copy(),
        normal=outputs.normal_forces.numpy(),
        friction=outputs.friction_forces.numpy(),
        load=np.zeros_like(before.positions) if load is None else load.numpy().copy(),
        energies={name: value.copy() for name, value in watched.items()},
        energies_before=earlier.energies if earlier else {},
    )
