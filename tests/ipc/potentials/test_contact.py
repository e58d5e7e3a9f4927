# SPDX-License-Identifier: Apache-2.0
"""Contact of any two bodies: finite differences, balance, and the plain sums it stands for."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
import warp as wp

from taccel_lab.bodies.bodies import Surface
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.ipc.broad_phase.candidates import Candidates
from taccel_lab.ipc.contact.collision_lists import (
    EDGE_EDGE,
    POINT_EDGE,
    POINT_PLANE,
    POINT_POINT,
    POINT_TRIANGLE,
)
from taccel_lab.ipc.contact.collisions import GUARD_FRACTION, Collisions, body_ranks, self_ranges
from taccel_lab.ipc.linear.problem.scatter import NewtonSystem
from taccel_lab.ipc.potentials.contact import ContactPotential
from taccel_lab.model import Model
from taccel_lab.model.embedding import embed_vertices
from taccel_lab.scene import (
    AffineBody,
    Ball,
    Element,
    KinematicBody,
    Material,
    Plane,
    Scene,
    SoftBody,
    TimeStepping,
    TriangleMesh,
    box_mesh,
)
from taccel_lab.state import initial_state
from tests.ipc.contact_sums import edge_pair_sum, log_barrier, node_face_sum
from tests.ipc.dense_system import Dense, differences, empty_system
from tests.support.blocks import block_mesh, bumpy_body, everywhere, pose

DHAT, KAPPA, STEP = 2e-4, 1e5, 1e-8
FREE = TimeStepping(quasi_static=False)
SOFT = Material(1e5, 0.4, 1000.0)
NONE = np.zeros(0, dtype=np.int64)
SIZE = (1e-3, 1e-3, 0.5e-3)
CUBE = box_mesh((0.8e-3, 0.7e-3, 0.6e-3))


def touchable(mesh: TetMesh) -> TetMesh:
    """The mesh with nothing glued to anything."""
    return replace(mesh, face_regions=np.full(len(mesh.faces), int(Region.SIDE)))


def block(cells: tuple[int, int, int], seed: int, at: np.ndarray, **options: Any) -> SoftBody:
    """A soft block whose upper face is at z = 0 in its own frame."""
    mesh = touchable(block_mesh(cells, SIZE, jitter=0.2, seed=seed))
    return SoftBody(
        mesh, SOFT, bonded_nodes=NONE, initial_pose=at, element=Element.LINEAR, **options
    )


def folded() -> SoftBody:
    """A strip to be bent until its ends face each other."""
    mesh = touchable(block_mesh((6, 1, 1), (3e-3, 0.4e-3, 0.3e-3), jitter=0.1, seed=1))
    return SoftBody(mesh, SOFT, bonded_nodes=NONE, self_contact=True, element=Element.LINEAR)


UP = 0.5e-3 + 0.06 * DHAT
THICK = Surface(thickness_m=3e-5)
SCENES: dict[str, Scene] = {
    "gel on gel": Scene(
        [
            block((2, 2, 1), 1, pose(0, 0, 0), name="below"),
            block((3, 2, 1), 2, pose(2e-4, 1e-4, UP, (0, 0, 1), 20), name="above"),
        ],
        time=FREE,
    ),
    "thick gels": Scene(
        [
            block((2, 2, 1), 1, pose(0, 0, 0), name="below", surface=THICK),
            block((3, 2, 1), 2, pose(2e-4, 1e-4, UP + 6e-5), name="above", surface=THICK),
        ],
        time=FREE,
    ),
    "itself": Scene(folded(), time=FREE),
    "plane": Scene(
        block((2, 2, 1), 1, pose(0, 0, UP, (1, 2, 0), 1), surface=THICK),
        planes=Plane((0.0, 0.0, -6e-5), (0.03, -0.02, 1.0)),
        time=FREE,
    ),
    "affine on gel": Scene(
        block((2, 2, 1), 1, pose(0, 0, 0)),
        affine_bodies=AffineBody(
            CUBE,
            initial_pose=pose(1e-4, 0, 0.35e-3 + 0.03 * DHAT, (0.01, 0.02, 1), 20),
            surface=THICK,
        ),
        time=FREE,
    ),
    "affine on affine": Scene(
        affine_bodies=[
            AffineBody(CUBE, name="below"),
            AffineBody(
                CUBE, name="above", initial_pose=pose(1e-4, 2e-4, 0.62e-3, (0.01, 0.02, 1), 40)
            ),
        ],
        time=FREE,
    ),
    "affine on plane": Scene(
        affine_bodies=AffineBody(CUBE, initial_pose=pose(0, 0, 0.37e-3, (1, 1, 0.2), 5)),
        planes=Plane(),
        time=FREE,
    ),
}

GEL = block_mesh((2, 2, 1), (2e-3, 2e-3, 1e-3), jitter=0.2, seed=4)
SPIKE = TriangleMesh(
    np.array([[0, 0, 0], [2e-4, 0, 1e-3], [-1e-4, 2e-4, 1e-3], [-1e-4, -2e-4, 1e-3]]),
    np.array([[0, 2, 1], [0, 3, 2], [0, 1, 3], [1, 2, 3]]),
)
# A shallow roof over the gel, concave from below: the gel sees four faces at once.
ROOF = TriangleMesh(
    np.array(
        [
            [0, 0, 1.4e-4],
            *([7e-4 * x, 7e-4 * y, 0] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))),
        ]
    ),
    np.array([[0, 2, 1], [0, 3, 2], [0, 4, 3], [0, 1, 4]]),
)
# The node in the middle of the contact face: its nearest feature of the spike is the tip.
MIDDLE = GEL.nodes_m[GEL.region_nodes(Region.CONTACT)][4]
TOOLS: dict[str, tuple[TriangleMesh | Ball, np.ndarray]] = {
    "concave": (bumpy_body(1, 0.8e-3), pose(1e-4, -2e-4, 0, (1, 2, 3), 40)),
    "dented": (bumpy_body(6, 1e-3, 0.6), pose(-2e-4, 1e-4, 0, (3, 1, -1), 75)),
    "corner": (box_mesh((1e-3, 1e-3, 1e-3)), pose(1e-4, 5e-5, 0, (1, 1.1, 0.1), 50)),
    "parallel edges": (box_mesh((1e-3, 0.8e-3, 1e-3)), pose(1e-4, 6.2e-4, 0, (1, 0.3, 0.5), 0.7)),
    "spike": (SPIKE, pose(MIDDLE[0] + 3e-5, MIDDLE[1] - 2e-5, 0)),
    "roof": (ROOF, pose(MIDDLE[0] - 4e-6, MIDDLE[1] + 5e-6, 0, (1, 0.2, 0), 1)),
    "ball": (Ball(1.5e-3), pose(2e-4, -1e-4, 0)),
}
"""On a gel with a glued back; each is set down with a gap of a twentieth of dhat."""


class Contact:
    """The potential with its collisions found anew at each position."""

    def __init__(self, model: Model, x: np.ndarray, poses: np.ndarray | None = None) -> None:
        self.model = model
        self.collisions = Collisions(model, KAPPA, DHAT)
        self.potential = ContactPotential(model, self.collisions)
        self.candidates = Candidates(model)
        self.poses = initial_state(model, poses).poses
        self.gaps = wp.zeros(model.env_count, dtype=wp.float64)

    def _collide(self, active: wp.array, x: wp.array) -> None:
        embed_vertices(self.model, x)
        still = wp.zeros_like(x)
        self.candidates.update(active, x, still, self.poses, self.poses, DHAT)
        self.collisions.update(active, x, self.candidates)

    def energy(self, active: wp.array, x: wp.array) -> np.ndarray:
        self._collide(active, x)
        return self.potential.energy(active, x)

    def nodal_gradient(self, active: wp.array, x: wp.array) -> np.ndarray:
        self._collide(active, x)
        out = wp.zeros_like(x)
        self.gaps.fill_(np.inf)
        self.potential.add_gradient(active, x, out, self.gaps)
        return out.numpy()

    def add_gradient(self, active: wp.array, x: wp.array, gradient: wp.array) -> None:
        found = self.nodal_gradient(active, x)
        parents, weights = self.model.parents.numpy(), self.model.weights.numpy()
        for node in np.flatnonzero(parents >= 0):
            for k in range(4):
                found[:, parents[node] + k] += weights[node, k] * found[:, node]
        gradient.assign(gradient.numpy() + found)

    def add_hessian(
        self, active: wp.array, x: wp.array, system: NewtonSystem, modes: wp.array
    ) -> None:
        self._collide(active, x)
        self.potential.add_hessian(active, x, system, modes)


@lru_cache
def made(name: str) -> tuple[Dense, np.ndarray]:
    """The scene in 48 environments, and positions with some noise, all in reach of contact."""
    if name in TOOLS:
        return set_down(*TOOLS[name])
    model = replace(SCENES[name], env_count=48).finalize()
    x = initial_state(model).positions.numpy()[0]
    if name == "itself":
        angle = x[:, 0] / 3e-3 * np.deg2rad(357)
        radius = 0.62e-3 - x[:, 2]
        x = np.column_stack([radius * np.sin(angle), x[:, 1], radius * np.cos(angle)])
    soft = slice(0, model.soft_count)
    x[soft] += np.random.default_rng(3).uniform(-1, 1, x[soft].shape) * 0.01 * DHAT
    return Dense(model, Contact(model, x), x), x


def set_down(shape: TriangleMesh | Ball, placed: np.ndarray) -> tuple[Dense, np.ndarray]:
    """The same of a tool on a gel."""
    gel = SoftBody(GEL, SOFT, element=Element.LINEAR)
    model = Scene(gel, KinematicBody(shape), env_count=48).finalize()
    lowest = -1.5e-3
    if isinstance(shape, TriangleMesh):
        turned = initial_state(model, everywhere(48, placed)).positions.numpy()
        lowest = turned[0, GEL.node_count :, 2].min()
    poses = everywhere(48, placed + [0, 0, 0.05 * DHAT - lowest, 0, 0, 0, 0])
    x = initial_state(model, poses).positions.numpy()[0]
    x[: GEL.node_count] += np.random.default_rng(0).uniform(-2e-5, 1e-5, (GEL.node_count, 3))
    return Dense(model, Contact(model, x, poses), x), x


ALL = [*SCENES, *TOOLS]


@pytest.mark.parametrize("name", ALL)
def test_gradient_and_matrix_are_derivatives(name: str) -> None:
    problem, x = made(name)
    free = x[problem.free]
    gradient = problem.gradient(free[None])[0]
    slope = differences(problem.energy, free, STEP).reshape(gradient.shape)
    scale = np.abs(gradient).max()
    assert scale > 1e-6, "nothing touches"
    np.testing.assert_allclose(gradient, slope, atol=3e-6 * scale)
    matrix = problem.hessian(free, 0)
    expected = differences(problem.gradient, free, STEP).reshape(matrix.shape)
    np.testing.assert_allclose(matrix, expected, atol=1e-5 * np.abs(expected).max())
    projected = problem.hessian(free, 1)
    values = np.linalg.eigvalsh(projected)
    assert values[0] > -1e-12 * values[-1]
    if name in TOOLS:
        assert np.linalg.eigvalsh(matrix)[0] < -1e-6 * scale, "nothing to project"


@pytest.mark.parametrize("name", ALL)
def test_action_is_reaction(name: str) -> None:
    problem, x = made(name)
    gradient = problem.potential.nodal_gradient(
        problem.active, problem.positions(x[problem.free][None])
    )[0]
    scale = np.abs(gradient).sum()
    np.testing.assert_allclose(gradient.sum(axis=0), 0, atol=1e-13 * scale)
    if "plane" not in name:
        moment = np.cross(x - x.mean(axis=0), gradient).sum(axis=0)
        np.testing.assert_allclose(moment, 0, atol=1e-12 * scale * np.ptp(x))


def surfaces(model: Model) -> list[np.ndarray]:
    faces = model.surface.faces.numpy()
    return [faces[slice(*body.faces)] for body in model.bodies]


def reference(name: str) -> float:
    """The same energy from plain sums; without thickness."""
    problem, x = made(name)
    model = problem.model
    rest, area = model.rest_positions.numpy()[0], model.surface.node_areas.numpy()[0]
    guard = GUARD_FRACTION * DHAT
    parts = surfaces(model)
    if name == "itself":
        own = np.unique(parts[0])
        reach = self_ranges(model, DHAT).numpy()[0, own]
        total = node_face_sum(x, parts[0], own, 0.5 * area[own], reach)
        return KAPPA * (total + edge_pair_sum(x, rest, parts[0], parts[0], guard))
    ranks = body_ranks(model)
    total = edge_pair_sum(x, rest, parts[0], parts[1], guard)
    for mine, other in ((0, 1), (1, 0)):
        nodes = np.unique(parts[mine])
        difference = ranks[mine] - ranks[other]
        share = 0.5 if difference == 0 else 1.0
        reach = np.full(len(nodes), guard if difference < 0 else DHAT)
        total += node_face_sum(x, parts[other], nodes, share * area[nodes], reach)
    return KAPPA * total


@pytest.mark.parametrize("name", ["gel on gel", "itself", "affine on affine"])
def test_energy_is_the_plain_sum(name: str) -> None:
    problem, x = made(name)
    expected = reference(name)
    assert expected > 0
    assert problem.energy(x[problem.free][None])[0] == pytest.approx(expected, rel=1e-9)


def collisions(name: str) -> dict[str, np.ndarray]:
    problem, x = made(name)
    problem.energy(x[problem.free][None])
    return problem.potential.collisions.snapshot(0)


def test_each_case_touches_as_it_should() -> None:
    for name in ("gel on gel", "itself", "affine on gel", "affine on affine"):
        found = collisions(name)
        assert EDGE_EDGE in found["kinds"] and (found["kinds"] != EDGE_EDGE).any(), name
    for name in ("plane", "affine on plane"):
        assert set(collisions(name)["kinds"]) == {POINT_PLANE}
    seen: set[tuple[int, bool]] = set()
    lowest = 0.0
    for name in TOOLS:
        found, x = collisions(name), made(name)[1]
        a, b, c, d = (x[found["stencils"][:, k]] for k in range(4))
        mollified = (np.cross(b - a, d - c) ** 2).sum(axis=1) < found["thresholds"]
        seen |= set(zip(found["kinds"].tolist(), mollified.tolist(), strict=True))
        lowest = min(lowest, found["stiffnesses"].min())
    points = {(kind, False) for kind in (POINT_TRIANGLE, POINT_EDGE, POINT_POINT)}
    assert seen == points | {(EDGE_EDGE, False), (EDGE_EDGE, True)}
    assert lowest < 0, "no subtracted duplicate of a concave surface among the cases"


def test_the_soft_and_then_the_finer_surface_measures() -> None:
    assert body_ranks(made("gel on gel")[0].model).tolist() == [1, 2]
    assert body_ranks(made("affine on gel")[0].model).tolist() == [1, 0]
    assert body_ranks(made("affine on affine")[0].model).tolist() == [0, 0]


def test_a_plane_weighs_nodes_by_their_whole_area() -> None:
    problem, x = made("plane")
    model = problem.model
    energy = problem.energy(x[problem.free][None])[0]
    plane = model.node_count - 1
    normal = model.surface.plane_normals.numpy()[plane]
    gap = (x[: model.soft_count] - x[plane]) @ normal - 3e-5
    area = model.surface.node_areas.numpy()[0]
    expected = sum(a * log_barrier(g, DHAT) for a, g in zip(area, gap, strict=False))
    assert energy == pytest.approx(KAPPA * expected, rel=1e-12)


def test_thickness_counts_once_for_each_body() -> None:
    """Gels that are further apart by the thickness of both push just as much."""
    energies = []
    for thickness in (0.0, 3e-5):
        surface = Surface(thickness_m=thickness)
        high = 0.5e-3 + 0.5 * DHAT + 2 * thickness
        upper = touchable(block_mesh((3, 3, 1), (0.5e-3, 0.5e-3, 0.5e-3), jitter=0.2))
        bodies = [
            block((2, 2, 1), 1, pose(0, 0, 0), name="below", surface=surface),
            SoftBody(
                upper,
                SOFT,
                NONE,
                initial_pose=pose(0, 0, high),
                surface=surface,
                element=Element.LINEAR,
            ),
        ]
        model = Scene(bodies, time=FREE).finalize()
        x = initial_state(model).positions.numpy()[0]
        energies.append(
            Dense(model, Contact(model, x), x).energy(x[model.free_nodes.numpy()][None])[0]
        )
    assert energies[0] > KAPPA * 0.25e-6 * log_barrier(0.5 * DHAT, DHAT) > 0
    assert energies[1] == pytest.approx(energies[0], rel=1e-9)


def test_neighbours_at_rest_exert_nothing() -> None:
    """A self-contact mesh far finer than dhat."""
    mesh = touchable(block_mesh((8, 8, 4), (4e-4, 4e-4, 2e-4), jitter=0.25))
    body = SoftBody(mesh, SOFT, bonded_nodes=NONE, self_contact=True, element=Element.LINEAR)
    model = Scene(body, time=FREE).finalize()
    x = initial_state(model).positions.numpy()[0]
    problem = Dense(model, Contact(model, x), x)
    assert problem.energy(x[problem.free][None])[0] == 0
    ranges = self_ranges(model, DHAT).numpy()[0]
    assert 0 < ranges[np.unique(mesh.faces)].min() < 0.25 * 5e-5


@pytest.mark.parametrize("name", TOOLS)
def test_prescribed_motion_reaches_the_right_hand_side(name: str) -> None:
    """The force that a motion of the tool's nodes adds, to first order."""
    problem, x = made(name)
    model, contact, free = problem.model, problem.potential, problem.free
    motion = np.zeros((1, model.node_count, 3))
    motion[0, GEL.node_count :] = np.random.default_rng(1).normal(size=(len(x) - GEL.node_count, 3))
    system = empty_system(model)
    system.displacements.assign(np.repeat(motion, model.env_count, axis=0))
    modes = wp.zeros(model.env_count, dtype=wp.int32)
    contact.add_hessian(problem.active, problem.positions(x[free][None]), system, modes)
    sides = []
    for side in (-1, 1):
        moved = np.repeat(x[None] + side * STEP * motion, model.env_count, axis=0)
        positions = wp.array(moved, dtype=wp.vec3d)
        sides.append(contact.nodal_gradient(problem.active, positions)[0, free])
    expected = -(sides[1] - sides[0]) / (2 * STEP)
    assert np.abs(expected).max() > 1
    found = system.rhs.numpy()[0]
    np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())
