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

from taccel_lab.bodies.material import MaxwellBranch
from taccel_lab.geometry import TetMesh
from taccel_lab.scene import (
    AffineBody,
    Element,
    KinematicBody,
    Material,
    Scene,
    SoftBody,
    TimeStepping,
    TriangleMesh,
    box_mesh,
    cylinder_mesh,
)
from tests.support.blocks import everywhere, free_block, pose
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
from tests.verification.watched import Watched

G = 9.81
SOFT = Material(young_modulus_pa=1e5, poisson_ratio=0.4, density_kg_m3=1000.0)
FREE = np.zeros(0, dtype=np.int64)


def in_time(dt: float, **bodies: object) -> Scene:
    time = TimeStepping(quasi_static=False, dt_s=dt, gravity_m_s2=(0.0, 0.0, -G))
    return Scene(time=time, **bodies)  # type: ignore[arg-type]


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
    """A stiff body of a surface, a soft one of tets, as a scene takes it."""
    options |= {"name": name, "initial_pose": place}
    if isinstance(mesh, TriangleMesh):
        return {"affine_bodies": AffineBody(mesh, 1000.0, **options)}
    return {"soft_bodies": SoftBody(mesh, SOFT, FREE, element=Element.LINEAR, **options)}


@pytest.mark.parametrize("name", CASES)
def test_bodies_in_degenerate_contact(name: str) -> None:
    fixed, mesh, place, along = CASES[name]
    body = falling(
        mesh,
        "falling",
        pose(*place),
        friction_coefficient=0.2,
        initial_velocity_m_s=(along, 0.0, -0.3),
    )
    stiff = {"kappa_pa": 1e5, "friction_speed_m_s": 5e-4} if "affine_bodies" in body else {}
    run = Watched(
        in_time(2e-3, kinematic_bodies=KinematicBody(fixed, 0.2, name="fixed"), **body),
        everywhere(1, pose(0, 0, 0)),
        dhat_m=1e-4,
        **stiff,
    )
    forces = [float(run.step().contact_force_n[0]) for _ in range(20 if stiff else 16)]
    assert max(forces) > (0 if stiff else 5e-3), "they never met"


# Internal edges ---------------------------------------------------------------------------------


@pytest.mark.parametrize("soft", [False, True])
def test_a_block_slides_over_a_seam(soft: bool) -> None:
    """Two boxes side by side make one floor: without friction nothing may catch at their edges.

    A node within dhat of a rim that it has just passed, or will reach, feels the edge sideways.
    """
    speed, dt, apart = 0.5, 2e-3, 1e-6
    floor = box_mesh((20e-3, 30e-3, 5e-3))
    half = 10e-3 + apart / 2
    floors = [KinematicBody(floor, 0.0, name=f"floor {k}") for k in range(2)]
    poses = everywhere(1, pose(-half, 0, -2.5e-3), pose(half, 0, -2.5e-3))
    dhat = 5e-5
    # About at rest on the layer that carries it.
    mesh = free_block((3, 3, 2), 8e-3) if soft else box_mesh((8e-3, 8e-3, 8e-3))
    start = pose(-8e-3, 0, (8e-3 if soft else 4e-3) + 0.9 * dhat)
    body = falling(mesh, "block", start, initial_velocity_m_s=(speed, 0, 0))
    run = Watched(in_time(dt, kinematic_bodies=floors, **body), poses, dhat_m=dhat, kappa_pa=1e4)
    mass = 1000 * 8e-3**3
    places = [run.positions("block")[:, 0].mean()]
    for _ in range(16):
        run.step()
        places.append(run.positions("block")[:, 0].mean())
        assert abs(run.force("block")[0]) < 2e-2 * mass * G
    speeds = np.diff(places) / dt
    assert places[0] < -7e-3 and places[-1] > 7e-3
    np.testing.assert_allclose(speeds, speed, rtol=2e-3)


# Mat on knives ----------------------------------------------------------------------------------


@pytest.mark.thorough
@pytest.mark.parametrize(
    "cells", [pytest.param(8, id="coarse"), pytest.param(20, id="fine", marks=pytest.mark.slow)]
)
def test_a_mat_falls_on_knives(cells: int) -> None:
    """It hangs over four edges of 10 degrees between their nodes, and its weight rests on them."""
    side, height = 40e-3, 1e-3
    mat = mapped_block(
        (cells, cells, 1),
        lambda nodes: nodes * [side / 2, side / 2, height / 2] + [0, 0, height / 2],
    )
    shape = roof(0.9e-3, 10e-3, 1.5 * side)
    places = [-15e-3, -5e-3, 5e-3, 15e-3]
    knives = [KinematicBody(shape, 0.3, name=f"knife {k}") for k in range(4)]
    body = SoftBody(
        mat,
        Material(1e4, 0.4, 1000.0, branches=(MaxwellBranch(1.0, 2e-2),)),
        FREE,
        name="mat",
        friction_coefficient=0.3,
        initial_pose=pose(0.3e-3, 0.2e-3, 0.5e-3, (0, 0, 1), 7),
        initial_velocity_m_s=(0, 0, -0.2),
        element=Element.LINEAR,
    )
    run = Watched(
        in_time(5e-3, soft_bodies=body, kinematic_bodies=knives),
        everywhere(1, *(pose(x, 0, 0, deg=90) for x in places)),
        dhat_m=1e-4,
    )
    for _ in range(40 if cells < 10 else 100):
        run.step()
    weight = 1000 * side**2 * height * G
    forces = [-run.force(f"knife {k}")[2] for k in range(4)]
    rubs = -run.solver.friction_gradient.numpy()[0, run.model.bodies[0].node_slice].sum(axis=0)
    assert min(forces) > 0.1 * weight
    assert sum(forces) + rubs[2] == pytest.approx(weight, rel=0.05)
    # It sags between the edges, and below them beside the outer ones.
    low = run.positions("mat")[:, 2]
    assert low.min() < -1e-4


# Roller ball ------------------------------------------------------------------------------------


@pytest.mark.thorough
@pytest.mark.parametrize(
    "cells", [pytest.param(4, id="coarse"), pytest.param(8, id="fine", marks=pytest.mark.slow)]
)
def test_a_ball_is_drawn_through_two_rollers(cells: int) -> None:
    """Rollers of 12 mm, 3 mm nearer than the ball is wide, turn against each other and draw a soft
    ball through their gap by friction."""
    radius, roller, gap = 5e-3, 12e-3, 7e-3
    ball = ball_tets(radius, cells)
    half = roller + gap / 2
    # Where the ball rests on both rollers.
    rest = np.sqrt((roller + radius) ** 2 - half**2)
    body = SoftBody(
        ball,
        SOFT,
        FREE,
        name="ball",
        friction_coefficient=1.0,
        initial_pose=pose(0, 0, rest + 2e-4),
        element=Element.LINEAR,
    )
    cylinder = cylinder_mesh(roller, 14e-3, 48)
    rollers = [KinematicBody(cylinder, 1.0, name=name) for name in ("left", "right")]
    lying = np.array([np.sqrt(0.5), 0, 0, np.sqrt(0.5)])

    def turned(deg: float) -> np.ndarray:
        """Both axes along y; the upper sides move inwards."""
        poses = []
        for x, sign in ((-half, 1), (half, -1)):
            half_angle = np.radians(deg) * sign / 2
            # The turn about y in the world after the cylinder was laid down about x.
            about = np.array([0, np.sin(half_angle), 0, np.cos(half_angle)])
            v1, w1, v2, w2 = about[:3], about[3], lying[:3], lying[3]
            product = np.append(w1 * v2 + w2 * v1 + np.cross(v1, v2), w1 * w2 - v1 @ v2)
            poses.append(np.array([x, 0, 0, *product]))
        return everywhere(1, *poses)

    run = Watched(in_time(1e-2, soft_bodies=body, kinematic_bodies=rollers), turned(0), dhat_m=1e-4)
    heights, narrow = [], 1.0
    for step in range(1, 41):
        run.step(turned(2.0 * step))
        nodes = run.positions("ball")
        heights.append(nodes[:, 2].mean())
        narrow = min(narrow, np.ptp(nodes[:, 0]) / (2 * radius))
    assert heights[-1] < -radius
    assert narrow < 0.8
