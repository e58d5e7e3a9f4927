# SPDX-License-Identifier: Apache-2.0
"""Stiff bodies that meet in the worst possible way, after the scenes of Erleben (2018), Methodology
for Assessing Mesh-Based Contact Point Methods: tips on tips, ridges on ridges exactly parallel, a
wedge that fills a crack face to face. Everything is centred, so every degenerate case is exact."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.ipc.intersection import find_intersections
from taccel_lab.scene import AffineBody, KinematicBody, Scene, TimeStepping, TriangleMesh, box_mesh
from taccel_lab.solvers.config import SolverConfig
from taccel_lab.solvers.solver_ipc import SolverIPC
from taccel_lab.state import initial_state
from tests.support.blocks import everywhere, pose

SIZE = 1e-2
HALF = 0.5 * SIZE
DHAT = 1e-4


def extruded(
    profile: list[tuple[float, float]], triangles: list[tuple[int, int, int]]
) -> TriangleMesh:
    """A profile (y, z) counter-clockwise as seen against x, with its triangulation, along x."""
    flat = SIZE * np.array(profile)
    n = len(flat)
    ends = [np.column_stack([np.full(n, x), flat]) for x in (-HALF, HALF)]
    caps = np.array(triangles)
    a, b = np.arange(n), np.roll(np.arange(n), -1)
    sides = [np.stack([a, b, b + n], 1), np.stack([a, b + n, a + n], 1)]
    return TriangleMesh(np.concatenate(ends), np.concatenate([caps[:, ::-1], caps + n, *sides]))


def pyramid(height: float) -> TriangleMesh:
    """A square base at z = 0 and an apex at ``height``; below zero it points down."""
    corners = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    base = np.array([(0.5 * x, 0.5 * y, 0) for x, y in corners])
    vertices = SIZE * np.concatenate([base, [[0, 0, height]]])
    faces = np.array([[0, 2, 1], [0, 3, 2], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    return TriangleMesh(vertices, faces if height > 0 else faces[:, ::-1])


def pit() -> TriangleMesh:
    """A block whose upper face, at z = 0, is a pyramid of one half pressed into it."""
    corners = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    top = [(0.5 * x, 0.5 * y, 0) for x, y in corners]
    bottom = [(0.5 * x, 0.5 * y, -1) for x, y in corners]
    vertices = SIZE * np.array([*top, *bottom, (0, 0, -0.5)])
    faces = [(0, 1, 8), (1, 2, 8), (2, 3, 8), (3, 0, 8), (4, 6, 5), (4, 7, 6)]
    for i in range(4):
        j = (i + 1) % 4
        faces += [(i, 4 + i, 4 + j), (i, 4 + j, j)]
    return TriangleMesh(vertices, np.array(faces))


SPIKE_UP, SPIKE_DOWN = pyramid(0.5), pyramid(-0.5)
WEDGE_UP = extruded([(-0.5, 0), (0.5, 0), (0, 0.5)], [(0, 1, 2)])
WEDGE_DOWN = extruded([(-0.5, 0), (0, -0.5), (0.5, 0)], [(0, 1, 2)])
CRACK = extruded(
    [(-0.5, -1), (0.5, -1), (0.5, 0), (0, -0.5), (-0.5, 0)], [(0, 1, 3), (1, 2, 3), (3, 4, 0)]
)
CUBE = box_mesh((SIZE, SIZE, SIZE))

# Fixed body, falling body, its place above the highest point of contact, sideways velocity.
GAP = 0.02 * SIZE
CASES: dict[str, tuple[TriangleMesh, TriangleMesh, tuple[float, float, float], float]] = {
    "spike on spike": (SPIKE_UP, SPIKE_DOWN, (0, 0, SIZE + GAP), 0),
    "spike on wedge": (WEDGE_UP, SPIKE_DOWN, (0, 0, SIZE + GAP), 0),
    "wedge on spike": (SPIKE_UP, WEDGE_DOWN, (0, 0, SIZE + GAP), 0),
    "wedge on wedge": (WEDGE_UP, WEDGE_DOWN, (0, 0, SIZE + GAP), 0),
    "spike in pit": (pit(), SPIKE_DOWN, (0, 0, GAP), 0),
    "spike in crack": (CRACK, SPIKE_DOWN, (0, 0, GAP), 0),
    "wedge in crack": (CRACK, WEDGE_DOWN, (0, 0, GAP), 0),
    "wedge in pit": (pit(), WEDGE_DOWN, (0, 0, HALF + GAP), 0),
    "cube on spike": (SPIKE_UP, CUBE, (0, 0, SIZE + GAP), 0),
    "cliff edges": (CUBE, CUBE, (HALF, SIZE, SIZE + GAP), 0),
    "cube on cube, corner to corner": (CUBE, CUBE, (SIZE, SIZE, SIZE + GAP), 0),
    "spike slides over a seam": (CUBE, SPIKE_DOWN, (-0.3 * SIZE, 0, SIZE + GAP), 0.3),
    "wedge slides along a crack": (CRACK, WEDGE_DOWN, (0, 0, GAP), 0.3),
}


@pytest.mark.parametrize("name", CASES)
def test_nothing_intersects(name: str) -> None:
    fixed, falling, place, along = CASES[name]
    body = AffineBody(
        falling,
        density_kg_m3=1000.0,
        initial_pose=pose(*place),
        initial_velocity_m_s=(along, 0.0, -0.3),
        friction_coefficient=0.2,
    )
    time = TimeStepping(quasi_static=False, dt_s=2e-3, gravity_m_s2=(0.0, 0.0, -9.81))
    made = Scene(
        affine_bodies=body,
        kinematic_bodies=KinematicBody(fixed, friction_coefficient=0.2),
        time=time,
    )
    model = made.finalize()
    config = SolverConfig(dhat_m=DHAT, kappa_pa=1e5, friction_speed_m_s=5e-4)
    solver = SolverIPC(model, config)
    state = initial_state(model, everywhere(1, pose(0, 0, 0)))
    touched = False
    for _ in range(20):
        report = solver.step(state)
        assert report.converged.all(), report.summary()
        assert find_intersections(model, state) == [[]]
        touched |= report.contact_force_n[0] > 0
    assert touched, "they never met"
