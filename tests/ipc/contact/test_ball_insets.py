# SPDX-License-Identifier: Apache-2.0
"""Chords of curved faces may reach into a ball by an inset; the nodes of the gel may not."""

from __future__ import annotations

from dataclasses import dataclass, replace

import ipctk
import numpy as np
import pytest
import warp as wp

from taccel_lab.benchmarks.stress.gaps import SurfacePairs
from taccel_lab.bodies.surface_topology import NO_BALL_INSET, ball_insets, face_reaches_sq
from taccel_lab.ipc.contact.collision_lists import POINT_POINT
from taccel_lab.ipc.contact.collisions import GUARD_FRACTION
from taccel_lab.ipc.contact.step_limit import limit_checks
from taccel_lab.model import Model
from taccel_lab.scene import (
    Ball,
    Element,
    KinematicBody,
    Material,
    Scene,
    SoftBody,
    TriangleMesh,
    box_mesh,
)
from taccel_lab.solvers.config import SolverConfig
from taccel_lab.state import State, initial_state
from tests.ipc.contact_sums import log_barrier
from tests.support.blocks import block_mesh, everywhere, pose
from tests.support.intersection import find_intersections
from tests.verification.assembly import Assembly

RADIUS, GAP, DHAT, KAPPA = 6e-3, 0.5e-6, 1e-6, 1e5
MESH = block_mesh((6, 6, 1), (3e-3, 3e-3, 1e-3))


def made(shape: Ball | TriangleMesh, element: Element = Element.QUADRATIC) -> Model:
    soft = SoftBody(MESH, Material(1e5, 0.4), element=element)
    return Scene(soft, KinematicBody(shape)).finalize()


@dataclass(frozen=True)
class _Dent:
    """A gel whose upper nodes lie ``GAP`` off a ball."""

    model: Model
    state: State
    poses: np.ndarray
    faces: np.ndarray
    """Faces of the dent."""

    @property
    def x(self) -> np.ndarray:
        return self.state.positions.numpy()

    def to_faces(self) -> np.ndarray:
        """Distance of the ball's centre from the faces of the dent [m]."""
        centre = self.poses[0, 0, :3]
        found = [ipctk.point_triangle_distance(centre, *self.x[0, f]) for f in self.faces]
        return np.sqrt(found)

    def moved(self, change: np.ndarray) -> State:
        """With other soft nodes [soft_count, 3]."""
        x = self.x.copy()
        x[0, : self.model.soft_count] = change
        return replace(self.state, positions=wp.array(x, dtype=wp.vec3d))


@pytest.fixture(scope="module")
def dent() -> _Dent:
    model = made(Ball(RADIUS))
    rest = model.rest_positions.numpy()[0, : model.soft_count]
    height = rest[:, 2].max() + RADIUS
    poses = everywhere(1, pose(0, 0, height))
    state = initial_state(model, poses)
    x = state.positions.numpy()
    top = np.flatnonzero(rest[:, 2] > rest[:, 2].max() - 1e-9)
    across_sq = (rest[top, :2] ** 2).sum(axis=1)
    x[0, top, 2] = height - np.sqrt((RADIUS + GAP) ** 2 - across_sq)
    state.positions.assign(x)
    faces = model.surface.faces.numpy()
    return _Dent(model, state, poses, faces[np.isin(faces, top).all(axis=1)])


def test_nodes_alone_carry_a_dent(dent: _Dent) -> None:
    assert dent.to_faces().max() < RADIUS - 1e-6, "chords are inside"
    assert find_intersections(dent.model, dent.state) == [[]]
    near = SurfacePairs(dent.model).nearer_than(dent.x[0], np.ones(2, dtype=bool), DHAT)
    assert near.gaps_m.min() == pytest.approx(GAP, rel=1e-6)
    assembly = Assembly(dent.model, SolverConfig(dhat_m=DHAT, kappa_pa=KAPPA), dent.poses)
    count = assembly.collide(dent.x)
    assert count == len(np.unique(dent.faces))
    assert (assembly.solver.collisions.kinds.numpy()[:count] == POINT_POINT).all()


def test_the_guard_begins_beyond_the_inset(dent: _Dent) -> None:
    """Stretched by a third, chords are in by nearly twice the sagitta at rest."""
    x = dent.x[0, : dent.model.soft_count].copy()
    height = dent.poses[0, 0, 2]
    top = np.unique(dent.faces)
    x[top, :2] *= 1.32
    across_sq = (x[top, :2] ** 2).sum(axis=1)
    x[top, 2] = height - np.sqrt((RADIUS + GAP) ** 2 - across_sq)
    state = dent.moved(x)
    stretched = replace(dent, state=state)
    reaches_sq = face_reaches_sq(dent.model.rest_positions.numpy(), dent.faces)[0]
    inset = ball_insets(RADIUS, reaches_sq)
    gaps = stretched.to_faces() - (RADIUS - inset)
    guard = GUARD_FRACTION * DHAT
    assert 0 < gaps.min() < guard
    p = dent.model.rest_positions.numpy()[0, dent.faces]
    areas = 0.5 * np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
    expected = sum(a * log_barrier(g, guard) for a, g in zip(areas, gaps, strict=True))
    expected += dent.model.surface.node_areas.numpy()[0, top].sum() * log_barrier(GAP, DHAT)
    assembly = Assembly(dent.model, SolverConfig(dhat_m=DHAT, kappa_pa=KAPPA), dent.poses)
    found = assembly.contact_energy(state.positions.numpy())[0]
    assert found == pytest.approx(KAPPA * expected, rel=1e-6)


def test_referees_know_a_node_or_too_much_of_a_chord_inside(dent: _Dent) -> None:
    soft = slice(0, dent.model.soft_count)
    node = np.unique(dent.faces)[3]
    pushed = dent.x[0, soft].copy()
    pushed[node, 2] += 2 * GAP
    stretched = dent.x[0, soft].copy()
    top = np.unique(dent.faces)
    stretched[top, :2] *= 2
    across_sq = (stretched[top, :2] ** 2).sum(axis=1)
    stretched[top, 2] = dent.poses[0, 0, 2] - np.sqrt((RADIUS + GAP) ** 2 - across_sq)
    for x in (pushed, stretched):
        state = dent.moved(x)
        (found,) = find_intersections(dent.model, state)
        assert [item.kind for item in found if item.first != item.second] == ["crossing"]
        gaps = SurfacePairs(dent.model).nearer_than(
            state.positions.numpy()[0], np.ones(2, dtype=bool), DHAT
        )
        assert gaps.gaps_m.min() < 0


@pytest.mark.parametrize("way_m", [(0, 0, -2e-5), (3e-5, 0, -1e-6), (0, 0, 1e-5), (1e-2, 0, -1e-2)])
def test_no_step_takes_a_node_into_the_ball(dent: _Dent, way_m: tuple[float, ...]) -> None:
    way = np.zeros_like(dent.x)
    way[0, dent.model.bodies[1].nodes[0]] = way_m
    solver = Assembly(dent.model, SolverConfig(dhat_m=DHAT), dent.poses).solver
    active = wp.full(1, 1, dtype=wp.int32)
    shift = wp.array(way, dtype=wp.vec3d)
    ends = dent.poses.copy()
    ends[0, 0, :3] += way_m
    starts, stops = (wp.array(p, dtype=wp.transformd) for p in (dent.poses, ends))
    solver.candidates.update(active, dent.state.positions, shift, starts, stops, DHAT)
    limit = wp.ones(1, dtype=wp.float64)
    x = dent.state.positions
    for check in limit_checks(dent.model, active, solver.candidates, x, shift, limit):
        check()
    part = float(limit.numpy()[0])
    offset = dent.x[0, np.unique(dent.faces)] - dent.poses[0, 0, :3]

    def least_gap(t: float) -> float:
        return float(np.linalg.norm(offset - t * np.array(way_m), axis=1).min() - RADIUS)

    if way_m[2] > 0:
        assert part == 1
        return
    # A tenth of the gap is left, and no more.
    assert least_gap(part) == pytest.approx(0.1 * GAP, rel=1e-4)
    assert min(least_gap(t) for t in np.linspace(0, part, 50)) > 0.0999 * GAP


def test_circles_around_faces() -> None:
    corners = np.array([[0, 0, 0], [2, 0, 0], [1, 3**0.5, 0], [0, 2, 0], [4, 0.5, 0]])
    faces = np.array([[0, 1, 2], [0, 1, 3], [0, 4, 1]])
    found = face_reaches_sq(corners[None], faces)[0]
    # Equilateral, right-angled, obtuse: the longest side is a diameter of the last two.
    assert found == pytest.approx([4 / 3, 2, 16.25 / 4])
    assert ball_insets(1.0, np.array([1e-4, 0.0])) == pytest.approx([1e-4, 0], rel=3e-3)
    assert ball_insets(1.0, np.array([NO_BALL_INSET, 1.0])) == pytest.approx([0, 0])


def test_flat_faces_have_no_inset() -> None:
    assert not made(Ball(RADIUS), Element.LINEAR).surface.face_reaches_sq.numpy().any()
    both = made(box_mesh((1e-3, 1e-3, 1e-3)))
    gel, box = (slice(*body.faces) for body in both.bodies)
    reaches_sq = both.surface.face_reaches_sq.numpy()[0]
    assert (reaches_sq[gel] > 0).all() and not reaches_sq[box].any()
