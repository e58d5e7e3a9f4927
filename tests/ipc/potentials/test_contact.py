# SPDX-License-Identifier: Apache-2.0
"""Contact of any two bodies: finite differences, balance, and the plain sums it stands for."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
import warp as wp

from taccel_lab.geometry import Region
from taccel_lab.ipc.broad_phase.candidates import Candidates
from taccel_lab.ipc.contact.collision_lists import (
    EDGE_EDGE,
    POINT_EDGE,
    POINT_PLANE,
    POINT_POINT,
    POINT_TRIANGLE,
)
from taccel_lab.ipc.contact.collisions import Collisions, body_ranks, self_ranges
from taccel_lab.ipc.elasticity.principal import PSD_CLAMP, PSD_NONE
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
    Surface,
    TimeStepping,
    TriangleMesh,
    box_mesh,
)
from taccel_lab.state import initial_state
from tests.ipc.contact_sums import log_barrier, plain_sum
from tests.ipc.derivatives import Dense, assert_derivatives, assert_semidefinite, empty_system
from tests.support.blocks import block_mesh, bumpy_body, everywhere, pose

DHAT, KAPPA, STEP = 2e-4, 1e5, 1e-8
SIZE = (1e-3, 1e-3, 0.5e-3)
CUBE = box_mesh((0.8e-3, 0.7e-3, 0.6e-3))
UP = 0.5e-3 + 0.06 * DHAT
THICK = Surface(thickness_m=3e-5)


def block(
    cells: tuple[int, int, int],
    at: np.ndarray | None = None,
    size: tuple[float, float, float] = SIZE,
    jitter: float = 0.2,
    seed: int = 0,
    **options: Any,
) -> SoftBody:
    """A soft block that nothing is glued to; its upper face is at z = 0 in its own frame."""
    mesh = block_mesh(cells, size, jitter=jitter, seed=seed)
    mesh = replace(mesh, face_regions=np.full(len(mesh.faces), int(Region.SIDE)))
    if at is not None:
        options["initial_pose"] = at
    material, nothing = Material(1e5, 0.4, 1000.0), np.zeros(0, dtype=np.int64)
    return SoftBody(mesh, material, nothing, element=Element.LINEAR, **options)


def scene(*gels: SoftBody, **others: Any) -> Scene:
    return Scene(gels, time=TimeStepping(quasi_static=False), **others)


LOW = block((2, 2, 1), seed=1, name="below")
HIGH = block((3, 2, 1), pose(2e-4, 1e-4, UP, (0, 0, 1), 20), seed=2, name="above")
SCENES: dict[str, Scene] = {
    "gel on gel": scene(LOW, HIGH),
    "thick gels": scene(
        replace(LOW, surface=THICK),
        replace(HIGH, surface=THICK, initial_pose=pose(2e-4, 1e-4, UP + 6e-5)),
    ),
    "itself": scene(block((6, 1, 1), None, (3e-3, 0.4e-3, 0.3e-3), 0.1, seed=1, self_contact=True)),
    "plane": scene(
        block((2, 2, 1), pose(0, 0, UP, (1, 2, 0), 1), seed=1, surface=THICK),
        planes=Plane((0.0, 0.0, -6e-5), (0.03, -0.02, 1.0)),
    ),
    "affine on gel": scene(
        LOW,
        affine_bodies=AffineBody(
            CUBE,
            initial_pose=pose(1e-4, 0, 0.35e-3 + 0.03 * DHAT, (0.01, 0.02, 1), 20),
            surface=THICK,
        ),
    ),
    "affine on affine": scene(
        affine_bodies=[
            AffineBody(CUBE, name="below"),
            AffineBody(
                CUBE, name="above", initial_pose=pose(1e-4, 2e-4, 0.62e-3, (0.01, 0.02, 1), 40)
            ),
        ]
    ),
    "affine on plane": scene(
        affine_bodies=AffineBody(CUBE, initial_pose=pose(0, 0, 0.37e-3, (1, 1, 0.2), 5)),
        planes=Plane(),
    ),
}

GEL = block_mesh((2, 2, 1), (2e-3, 2e-3, 1e-3), jitter=0.2, seed=4)
SPIKE = TriangleMesh(
    1e-4 * np.array([[0, 0, 0], [2, 0, 10], [-1, 2, 10], [-1, -2, 10]]),
    np.array([[0, 2, 1], [0, 3, 2], [0, 1, 3], [1, 2, 3]]),
)
# A shallow roof over the gel, concave from below: the gel sees four faces at once.
ROOF = TriangleMesh(
    1e-4 * np.array([[0, 0, 1.4], [-7, -7, 0], [7, -7, 0], [7, 7, 0], [-7, 7, 0]]),
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

    def __init__(self, model: Model, poses: np.ndarray | None) -> None:
        self.model = model
        self.collisions = Collisions(model, KAPPA, DHAT)
        self.potential = ContactPotential(model, self.collisions)
        self.candidates = Candidates(model)
        self.poses = initial_state(model, poses).poses

    def _collide(self, active: wp.array, x: wp.array) -> None:
        embed_vertices(self.model, x)
        self.candidates.update(active, x, wp.zeros_like(x), self.poses, self.poses, DHAT)
        self.collisions.update(active, x, self.candidates)

    def energy(self, active: wp.array, x: wp.array) -> np.ndarray:
        self._collide(active, x)
        return self.potential.energy(active, x)

    def nodal_gradient(self, active: wp.array, x: wp.array) -> np.ndarray:
        self._collide(active, x)
        out = wp.zeros_like(x)
        gaps = wp.full(self.model.env_count, np.inf, dtype=wp.float64)
        self.potential.add_gradient(active, x, out, gaps)
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


class Case(Dense):
    """The scene, or one of a tool on a gel, and positions ``x`` of environment 0."""

    def __init__(
        self, model: Model, x: np.ndarray | None = None, poses: np.ndarray | None = None
    ) -> None:
        x = initial_state(model, poses).positions.numpy()[0] if x is None else x
        super().__init__(model, Contact(model, poses), x)
        self.x, self.now = x, x[self.free][None]

    def collisions(self) -> dict[str, np.ndarray]:
        self.energy(self.now)
        return self.potential.collisions.snapshot(0)


@lru_cache
def made(name: str) -> Case:
    """In 48 environments, with some noise of the positions, all in reach of contact."""
    if name in TOOLS:
        return set_down(*TOOLS[name])
    model = replace(SCENES[name], env_count=48).finalize()
    x = initial_state(model).positions.numpy()[0]
    if name == "itself":
        # Bent until its ends face each other.
        angle = x[:, 0] / 3e-3 * np.deg2rad(357)
        radius = 0.62e-3 - x[:, 2]
        x = np.column_stack([radius * np.sin(angle), x[:, 1], radius * np.cos(angle)])
    soft = slice(0, model.soft_count)
    x[soft] += np.random.default_rng(3).uniform(-1, 1, x[soft].shape) * 0.01 * DHAT
    return Case(model, x)


def set_down(shape: TriangleMesh | Ball, placed: np.ndarray) -> Case:
    gel = SoftBody(GEL, Material(1e5, 0.4, 1000.0), element=Element.LINEAR)
    model = Scene(gel, KinematicBody(shape), env_count=48).finalize()
    lowest = -1.5e-3
    if isinstance(shape, TriangleMesh):
        turned = initial_state(model, everywhere(48, placed)).positions.numpy()
        lowest = turned[0, GEL.node_count :, 2].min()
    poses = everywhere(48, placed + [0, 0, 0.05 * DHAT - lowest, 0, 0, 0, 0])
    x = initial_state(model, poses).positions.numpy()[0]
    x[: GEL.node_count] += np.random.default_rng(0).uniform(-2e-5, 1e-5, (GEL.node_count, 3))
    return Case(model, x, poses)


@pytest.mark.parametrize("name", [*SCENES, *TOOLS])
def test_forces_are_derivatives_and_in_balance(name: str) -> None:
    case = made(name)
    matrix = case.hessian(case.now[0], PSD_NONE)
    within = (3e-6, 1e-5)
    assert_derivatives(
        case.now[0], STEP, case.energy, case.gradient, matrix, least=(1e-6, 0), within=within
    )
    assert_semidefinite(case.hessian(case.now[0], PSD_CLAMP))
    if name in TOOLS:
        scale = np.abs(case.gradient(case.now)).max()
        assert np.linalg.eigvalsh(matrix)[0] < -1e-6 * scale, "nothing to project"
    forces = case.potential.nodal_gradient(case.active, case.positions(case.now))[0]
    scale = np.abs(forces).sum()
    np.testing.assert_allclose(forces.sum(axis=0), 0, atol=1e-13 * scale)
    if "plane" not in name:
        moment = np.cross(case.x - case.x.mean(axis=0), forces).sum(axis=0)
        np.testing.assert_allclose(moment, 0, atol=1e-12 * scale * np.ptp(case.x))


@pytest.mark.parametrize("name", ["gel on gel", "itself", "affine on affine"])
def test_energy_is_the_plain_sum(name: str) -> None:
    case = made(name)
    expected = KAPPA * plain_sum(case.model, case.x, DHAT)
    assert expected > 0 and case.energy(case.now)[0] == pytest.approx(expected, rel=1e-9)


def test_each_case_touches_as_it_should() -> None:
    for name in ("gel on gel", "itself", "affine on gel", "affine on affine"):
        kinds = made(name).collisions()["kinds"]
        assert EDGE_EDGE in kinds and (kinds != EDGE_EDGE).any(), name
    for name in ("plane", "affine on plane"):
        assert set(made(name).collisions()["kinds"]) == {POINT_PLANE}
    seen: set[tuple[int, bool]] = set()
    lowest = 0.0
    for case in map(made, TOOLS):
        found = case.collisions()
        a, b, c, d = (case.x[found["stencils"][:, k]] for k in range(4))
        mollified = (np.cross(b - a, d - c) ** 2).sum(axis=1) < found["thresholds"]
        seen |= set(zip(found["kinds"].tolist(), mollified.tolist(), strict=True))
        lowest = min(lowest, found["stiffnesses"].min())
    points = {(kind, False) for kind in (POINT_TRIANGLE, POINT_EDGE, POINT_POINT)}
    assert seen == points | {(EDGE_EDGE, False), (EDGE_EDGE, True)}
    assert lowest < 0, "no subtracted duplicate of a concave surface among the cases"
    # The soft and then the finer surface measures.
    names = ("gel on gel", "affine on gel", "affine on affine")
    assert [body_ranks(made(name).model).tolist() for name in names] == [[1, 2], [1, 0], [0, 0]]


def test_a_plane_weighs_nodes_by_their_whole_area() -> None:
    case = made("plane")
    surface, plane = case.model.surface, case.model.node_count - 1
    normal = surface.plane_normals.numpy()[plane]
    gaps = (case.x[: case.model.soft_count] - case.x[plane]) @ normal - 3e-5
    areas = surface.node_areas.numpy()[0]
    expected = KAPPA * sum(a * log_barrier(g, DHAT) for a, g in zip(areas, gaps, strict=False))
    assert case.energy(case.now)[0] == pytest.approx(expected, rel=1e-12)


def test_thickness_counts_once_for_each_body() -> None:
    """Gels that are further apart by the thickness of both push just as much."""
    energies = []
    for thickness in (0.0, 3e-5):
        surface = Surface(thickness_m=thickness)
        place = pose(0, 0, 0.5e-3 + 0.5 * DHAT + 2 * thickness)
        upper = block((3, 3, 1), place, (0.5e-3, 0.5e-3, 0.5e-3), surface=surface)
        case = Case(scene(replace(LOW, surface=surface), upper).finalize())
        energies.append(case.energy(case.now)[0])
    assert energies[0] > KAPPA * 0.25e-6 * log_barrier(0.5 * DHAT, DHAT) > 0
    assert energies[1] == pytest.approx(energies[0], rel=1e-9)


def test_neighbours_at_rest_exert_nothing() -> None:
    """A self-contact mesh far finer than dhat."""
    body = block((8, 8, 4), None, (4e-4, 4e-4, 2e-4), 0.25, self_contact=True)
    case = Case(scene(body).finalize())
    assert case.energy(case.now)[0] == 0
    ranges = self_ranges(case.model, DHAT).numpy()[0]
    assert 0 < ranges[np.unique(body.mesh.faces)].min() < 0.25 * 5e-5


@pytest.mark.parametrize("name", TOOLS)
def test_prescribed_motion_reaches_the_right_hand_side(name: str) -> None:
    """The force that a motion of the tool's nodes adds, to first order."""
    case = made(name)
    motion = np.zeros_like(case.x)
    tool = motion[GEL.node_count :]
    tool[:] = np.random.default_rng(1).normal(size=tool.shape)
    system, env_count = empty_system(case.model), case.model.env_count
    system.displacements.assign(np.repeat(motion[None], env_count, axis=0))
    modes = wp.full(env_count, PSD_NONE, dtype=wp.int32)
    case.potential.add_hessian(case.active, case.positions(case.now), system, modes)

    def forces(side: int) -> np.ndarray:
        moved = np.repeat(case.x[None] + side * STEP * motion, env_count, axis=0)
        positions = wp.array(moved, dtype=wp.vec3d)
        return case.potential.nodal_gradient(case.active, positions)[0, case.free]

    expected = -(forces(1) - forces(-1)) / (2 * STEP)
    assert np.abs(expected).max() > 1
    np.testing.assert_allclose(system.rhs.numpy()[0], expected, atol=1e-5 * np.abs(expected).max())
