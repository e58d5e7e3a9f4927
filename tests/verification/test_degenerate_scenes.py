# SPDX-License-Identifier: Apache-2.0
"""Soft and stiff bodies in degenerate contact: tips, ridges, cracks, seams, knives, rollers.

After the scenes of Erleben (2018), Methodology for Assessing Mesh-Based Contact Point Methods: tips
on tips, ridges on ridges exactly parallel, a wedge that fills a crack face to face, all centred, so
that every degenerate case is exact; with soft counterparts. And the mat on knives and the roller
ball of the IPC paper [Li et al. 2020]. Every step has to converge; the referee may find nothing.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from taccel_lab.bodies.material import MaxwellBranch
from taccel_lab.geometry import TetMesh
from taccel_lab.scene import (
    AffineBody,
    KinematicBody,
    Material,
    Scene,
    TriangleMesh,
    box_mesh,
    cylinder_mesh,
)
from tests.support.blocks import everywhere, free_block, pose
from tests.support.scene_steps import G, Watched, in_time, linear
from tests.verification.shapes import (
    SIZE,
    ball_tets,
    extruded,
    filled,
    mapped_block,
    pit,
    pyramid,
    roof,
)

SOFT = Material(1e5, 0.4, density_kg_m3=1000.0)
FREE = np.zeros(0, dtype=np.int64)


SPIKE_UP, SPIKE_DOWN = pyramid(0.5), pyramid(-0.5)
WEDGE_UP = extruded([(-0.5, 0), (0.5, 0), (0, 0.5)], [(0, 1, 2)])
WEDGE_DOWN = extruded([(-0.5, 0), (0, -0.5), (0.5, 0)], [(0, 1, 2)])
CRACK = extruded(
    [(-0.5, -1), (0.5, -1), (0.5, 0), (0, -0.5), (-0.5, 0)], [(0, 1, 3), (1, 2, 3), (3, 4, 0)]
)
CUBE = box_mesh((SIZE, SIZE, SIZE))
SOFT_CUBE = free_block((2, 2, 2), SIZE)
"""Its upper face at z = 0."""
HALF, GAP = 0.5 * SIZE, 0.02 * SIZE
# Fixed body, falling body, its place just above, sideways velocity.
CASES: dict[str, tuple[TriangleMesh, TriangleMesh | TetMesh, tuple[float, float, float], float]] = {
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
    "soft spike on spike": (SPIKE_UP, filled(SPIKE_DOWN), (0, 0, SIZE + GAP), 0),
    "soft spike on wedge": (WEDGE_UP, filled(SPIKE_DOWN), (0, 0, SIZE + GAP), 0),
    "soft wedge on spike": (SPIKE_UP, filled(WEDGE_DOWN), (0, 0, SIZE + GAP), 0),
    "soft wedge on wedge": (WEDGE_UP, filled(WEDGE_DOWN), (0, 0, SIZE + GAP), 0),
    "soft spike in pit": (pit(), filled(SPIKE_DOWN), (0, 0, GAP), 0),
    "soft wedge in crack": (CRACK, filled(WEDGE_DOWN), (0, 0, GAP), 0),
    "soft cube on spike": (SPIKE_UP, SOFT_CUBE, (0, 0, 1.5 * SIZE + GAP), 0),
    "soft cube on wedge": (WEDGE_UP, SOFT_CUBE, (0, 0, 1.5 * SIZE + GAP), 0),
    "soft cube at a cliff": (CUBE, SOFT_CUBE, (HALF, SIZE, 1.5 * SIZE + GAP), 0),
    "soft cube slides on cube": (CUBE, SOFT_CUBE, (0, 0, 1.5 * SIZE + GAP), 0.3),
}


def falling(mesh: TriangleMesh | TetMesh, name: str, place: np.ndarray, **options: Any) -> dict:
    options |= {"name": name, "initial_pose": place}
    if isinstance(mesh, TriangleMesh):
        return {"affine_bodies": AffineBody(mesh, 1000.0, **options)}
    return {"soft_bodies": linear(mesh, SOFT, bonded_nodes=FREE, **options)}


@pytest.mark.parametrize("name", CASES)
def test_bodies_in_degenerate_contact(name: str) -> None:
    fixed, mesh, place, along = CASES[name]
    options = {"friction_coefficient": 0.2, "initial_velocity_m_s": (along, 0.0, -0.3)}
    body = falling(mesh, "falling", pose(*place), **options)
    stiff = {"kappa_pa": 1e5, "friction_speed_m_s": 5e-4} if "affine_bodies" in body else {}
    scene = Scene(time=in_time(2e-3), kinematic_bodies=KinematicBody(fixed, 0.2), **body)
    run = Watched(scene, dhat_m=1e-4, **stiff)
    forces = [float(run.step().contact_force_n[0]) for _ in range(20 if stiff else 16)]
    assert max(forces) > (0 if stiff else 5e-3), "they never met"


@pytest.mark.parametrize("soft", [False, True])
def test_a_block_slides_over_a_seam(soft: bool) -> None:
    """Two boxes side by side make one floor: without friction nothing may catch at their edges."""
    speed, dt, apart = 0.5, 2e-3, 1e-6
    floor = box_mesh((20e-3, 30e-3, 5e-3))
    half = 10e-3 + apart / 2
    floors = [KinematicBody(floor, 0.0, name=f"floor {k}") for k in range(2)]
    sides = [pose(x, 0, -2.5e-3) for x in (-half, half)]
    dhat = 5e-5
    # About at rest on the layer that carries it.
    mesh = free_block((3, 3, 2), 8e-3) if soft else box_mesh((8e-3, 8e-3, 8e-3))
    start = pose(-8e-3, 0, (8e-3 if soft else 4e-3) + 0.9 * dhat)
    body = falling(mesh, "block", start, initial_velocity_m_s=(speed, 0, 0))
    scene = Scene(time=in_time(dt), kinematic_bodies=floors, **body)
    run = Watched(scene, *sides, dhat_m=dhat, kappa_pa=1e4)
    mass = 1000 * 8e-3**3
    places = [run.x("block")[:, 0].mean()]
    for _ in range(16):
        run.step()
        places.append(run.x("block")[:, 0].mean())
        assert abs(run.force("block")[0]) < 2e-2 * mass * G
    speeds = np.diff(places) / dt
    assert places[0] < -7e-3 and places[-1] > 7e-3
    np.testing.assert_allclose(speeds, speed, rtol=2e-3)


@pytest.mark.thorough
@pytest.mark.parametrize(
    "cells", [pytest.param(8, id="coarse"), pytest.param(20, id="fine", marks=pytest.mark.slow)]
)
def test_a_mat_falls_on_knives(cells: int) -> None:
    """It hangs over four edges of 10 degrees between their nodes, and its weight rests on them."""
    side, height = 40e-3, 1e-3
    half = np.array([side, side, height]) / 2
    mat = mapped_block((cells, cells, 1), lambda nodes: nodes * half + [0, 0, height / 2])
    shape = roof(0.9e-3, 10e-3, 1.5 * side)
    knives = [KinematicBody(shape, 0.3, name=f"knife {k}") for k in range(4)]
    body = linear(
        mat,
        Material(1e4, 0.4, 1000.0, branches=(MaxwellBranch(1.0, 2e-2),)),
        bonded_nodes=FREE,
        friction_coefficient=0.3,
        initial_pose=pose(0.3e-3, 0.2e-3, 0.5e-3, (0, 0, 1), 7),
        initial_velocity_m_s=(0, 0, -0.2),
    )
    places = [pose(x, 0, 0, deg=90) for x in (-15e-3, -5e-3, 5e-3, 15e-3)]
    run = Watched(Scene(body, knives, time=in_time(5e-3)), *places, dhat_m=1e-4)
    for _ in range(40 if cells < 10 else 100):
        run.step()
    weight = 1000 * side**2 * height * G
    forces = [-run.force(f"knife {k}")[2] for k in range(4)]
    rubs = run.friction("gel").sum(axis=0)
    assert min(forces) > 0.1 * weight
    assert sum(forces) + rubs[2] == pytest.approx(weight, rel=0.05)
    # It sags between the edges, and below them beside the outer ones.
    low = run.x("gel")[:, 2]
    assert low.min() < -1e-4


@pytest.mark.thorough
@pytest.mark.parametrize(
    "cells", [pytest.param(4, id="coarse"), pytest.param(8, id="fine", marks=pytest.mark.slow)]
)
def test_a_ball_is_drawn_through_two_rollers(cells: int) -> None:
    """3 mm nearer than the ball is wide, they draw it through their gap by friction."""
    radius, roller, gap = 5e-3, 12e-3, 7e-3
    ball = ball_tets(radius, cells)
    half = roller + gap / 2
    # Where the ball rests on both rollers.
    rest = np.sqrt((roller + radius) ** 2 - half**2)
    body = linear(
        ball,
        SOFT,
        bonded_nodes=FREE,
        friction_coefficient=1.0,
        initial_pose=pose(0, 0, rest + 2e-4),
    )
    cylinder = cylinder_mesh(roller, 14e-3, 48)
    rollers = [KinematicBody(cylinder, 1.0, name=name) for name in ("left", "right")]
    lying = Rotation.from_euler("x", 90, degrees=True)

    def turned(deg: float) -> np.ndarray:
        turns = [Rotation.from_euler("y", side * deg, degrees=True) * lying for side in (1, -1)]
        places = ([-half, 0, 0], [half, 0, 0])
        poses = zip(places, turns, strict=True)
        return everywhere(1, *(np.append(place, turn.as_quat()) for place, turn in poses))

    run = Watched(Scene(body, rollers, time=in_time(1e-2)), turned(0), dhat_m=1e-4)
    heights, narrow = [], 1.0
    for step in range(1, 41):
        run.step(turned(2.0 * step))
        nodes = run.x("gel")
        heights.append(nodes[:, 2].mean())
        narrow = min(narrow, np.ptp(nodes[:, 0]) / (2 * radius))
    assert heights[-1] < -radius
    assert narrow < 0.8
