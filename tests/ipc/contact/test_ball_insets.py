# SPDX-License-Identifier: Apache-2.0
"""Chords of curved faces may reach into a ball by an inset; the nodes of the gel may not."""

from __future__ import annotations

from dataclasses import replace

import ipctk
import numpy as np
import pytest
import warp as wp

from taccel_lab.benchmarks.stress.gaps import SurfacePairs
from taccel_lab.bodies.surface_topology import NO_BALL_INSET, ball_insets, face_reaches_sq
from taccel_lab.ipc.contact.collision_lists import POINT_POINT
from taccel_lab.ipc.contact.collisions import GUARD_FRACTION
from taccel_lab.ipc.contact.step_limit import SLACKNESS, limit_checks
from taccel_lab.model import Model
from taccel_lab.scene import Ball, Element, KinematicBody, Scene, TriangleMesh, box_mesh
from taccel_lab.solvers import SolverConfig
from taccel_lab.state import State, initial_state
from tests.ipc.contact_sums import face_areas, log_barrier
from tests.support.blocks import everywhere, pose, soft_block
from tests.support.intersection import find_intersections
from tests.verification.assembly import Assembly

RADIUS, GAP, DHAT, KAPPA = 6e-3, 0.5e-6, 1e-6, 1e5


def made(shape: Ball | TriangleMesh, element: Element = Element.QUADRATIC) -> Model:
    gel = soft_block((6, 6, 1), (3e-3, 3e-3, 1e-3), element=element)
    return Scene(gel, KinematicBody(shape)).finalize()


class Dent:
    """A gel whose upper nodes lie ``GAP`` off a ball."""

    def __init__(self) -> None:
        self.model = made(Ball(RADIUS))
        self.rest = self.model.rest_positions.numpy()[0, : self.model.soft_count]
        self.top = np.flatnonzero(self.rest[:, 2] > self.rest[:, 2].max() - 1e-9)
        self.centre = np.array([0, 0, self.rest[:, 2].max() + RADIUS])
        self.poses = everywhere(1, pose(*self.centre))
        self.at_rest = initial_state(self.model, self.poses)
        faces = self.model.surface.faces.numpy()
        self.faces = faces[np.isin(faces, self.top).all(axis=1)]
        self.state = self.moved(self.dented())

    def dented(self, stretch: float = 1.0) -> np.ndarray:
        """Soft nodes [soft_count, 3], the upper ones stretched from the middle."""
        x = self.rest.copy()
        x[self.top, :2] *= stretch
        across_sq = (x[self.top, :2] ** 2).sum(axis=1)
        x[self.top, 2] = self.centre[2] - np.sqrt((RADIUS + GAP) ** 2 - across_sq)
        return x

    def moved(self, soft: np.ndarray) -> State:
        x = self.at_rest.positions.numpy().copy()
        x[0, : len(soft)] = soft
        return replace(self.at_rest, positions=wp.array(x, dtype=wp.vec3d))

    def assembly(self) -> Assembly:
        return Assembly(self.model, SolverConfig(dhat_m=DHAT, kappa_pa=KAPPA), self.poses)

    def to_faces(self, state: State) -> np.ndarray:
        x = state.positions.numpy()[0]
        return np.sqrt([ipctk.point_triangle_distance(self.centre, *x[f]) for f in self.faces])

    def least_gap(self, state: State) -> float:
        pairs, both = SurfacePairs(self.model), np.ones(2, dtype=bool)
        return pairs.nearer_than(state.positions.numpy()[0], both, DHAT).gaps_m.min()


@pytest.fixture(scope="module")
def dent() -> Dent:
    return Dent()


def test_nodes_alone_carry_a_dent(dent: Dent) -> None:
    assert dent.to_faces(dent.state).max() < RADIUS - 1e-6, "chords are inside"
    assert find_intersections(dent.model, dent.state) == [[]]
    assert dent.least_gap(dent.state) == pytest.approx(GAP, rel=1e-6)
    assembly = dent.assembly()
    count = assembly.collide(dent.state.positions.numpy())
    assert count == len(dent.top)
    assert (assembly.solver.collisions.kinds.numpy()[:count] == POINT_POINT).all()


def test_the_guard_begins_beyond_the_inset(dent: Dent) -> None:
    """Stretched by a third, chords are in by nearly twice the sagitta at rest."""
    state, rest = dent.moved(dent.dented(1.32)), dent.model.rest_positions.numpy()
    inset = ball_insets(RADIUS, face_reaches_sq(rest, dent.faces)[0])
    gaps, guard = dent.to_faces(state) - (RADIUS - inset), GUARD_FRACTION * DHAT
    assert 0 < gaps.min() < guard
    expected = face_areas(rest[0], dent.faces) @ [log_barrier(g, guard) for g in gaps]
    expected += dent.model.surface.node_areas.numpy()[0, dent.top].sum() * log_barrier(GAP, DHAT)
    found = dent.assembly().contact_energy(state.positions.numpy())[0]
    assert found == pytest.approx(KAPPA * expected, rel=1e-6)


def test_referees_know_a_node_or_too_much_of_a_chord_inside(dent: Dent) -> None:
    pushed = dent.dented()
    pushed[dent.top[3], 2] += 2 * GAP
    for state in (dent.moved(pushed), dent.moved(dent.dented(2))):
        (found,) = find_intersections(dent.model, state)
        assert [item.kind for item in found if item.first != item.second] == ["crossing"]
        assert dent.least_gap(state) < 0


@pytest.mark.parametrize("way_m", [(0, 0, -2e-5), (3e-5, 0, -1e-6), (0, 0, 1e-5), (1e-2, 0, -1e-2)])
def test_no_step_takes_a_node_into_the_ball(dent: Dent, way_m: tuple[float, ...]) -> None:
    x, active = dent.state.positions, wp.full(1, 1, dtype=wp.int32)
    way, ends = np.zeros(x.numpy().shape), dent.poses.copy()
    way[0, dent.model.bodies[1].nodes[0]] = way_m
    ends[0, 0, :3] += way_m
    candidates, shift = dent.assembly().solver.candidates, wp.array(way, dtype=wp.vec3d)
    starts, stops = (wp.array(p, dtype=wp.transformd) for p in (dent.poses, ends))
    candidates.update(active, x, shift, starts, stops, DHAT)
    limit = wp.ones(1, dtype=wp.float64)
    for check in limit_checks(dent.model, active, candidates, x, shift, limit):
        check()
    part = float(limit.numpy()[0])
    if way_m[2] > 0:
        assert part == 1
        return
    offset = x.numpy()[0, dent.top] - dent.centre
    parts = np.append(np.linspace(0, part, 50), part)[:, None, None]
    gaps = np.linalg.norm(offset - parts * np.array(way_m), axis=-1).min(axis=1) - RADIUS
    # That part of the gap is left, and no more.
    left = SLACKNESS * GAP
    assert gaps[-1] == pytest.approx(left, rel=1e-4) and gaps.min() > 0.9999 * left


def test_circles_around_faces_and_none_around_flat_ones() -> None:
    corners = np.array([[0, 0, 0], [2, 0, 0], [1, 3**0.5, 0], [0, 2, 0], [4, 0.5, 0]])
    found = face_reaches_sq(corners[None], np.array([[0, 1, 2], [0, 1, 3], [0, 4, 1]]))[0]
    # Equilateral, right-angled, obtuse: the longest side is a diameter of the last two.
    assert found == pytest.approx([4 / 3, 2, 16.25 / 4])
    assert ball_insets(1.0, np.array([1e-4, 0.0])) == pytest.approx([1e-4, 0], rel=3e-3)
    assert ball_insets(1.0, np.array([NO_BALL_INSET, 1.0])) == pytest.approx([0, 0])
    assert not made(Ball(RADIUS), Element.LINEAR).surface.face_reaches_sq.numpy().any()
    both = made(box_mesh((1e-3, 1e-3, 1e-3)))
    gel, box = (both.surface.face_reaches_sq.numpy()[0, slice(*b.faces)] for b in both.bodies)
    assert (gel > 0).all() and not box.any()
