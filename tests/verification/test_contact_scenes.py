# SPDX-License-Identifier: Apache-2.0
"""Soft bodies against themselves and others, edges on edges: nothing ever intersects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from taccel_lab.bodies.crossings import self_crossings
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.ipc.contact.collision_lists import EDGE_EDGE
from taccel_lab.scene import AffineBody, KinematicBody, Material, Plane, Scene, box_mesh
from tests.support.blocks import block_mesh, everywhere, pose
from tests.support.scene_steps import Watched, in_time, linear
from tests.support.variants import variants
from tests.verification.shapes import roof

GEL = Material(1e5, 0.4, 1000.0)
FREE = np.zeros(0, dtype=np.int64)


def free(mesh: TetMesh) -> TetMesh:
    return replace(mesh, face_regions=np.full(len(mesh.faces), int(Region.SIDE)))


def upside_down(x: float, z: float, deg: float = 0.0) -> np.ndarray:
    turn = np.deg2rad(deg) / 2
    # Half a turn about x, then ``deg`` about z.
    return everywhere(1, np.array([x, 0, z, np.cos(turn), np.sin(turn), 0, 0]))


@pytest.mark.thorough
@pytest.mark.parametrize("cells", variants([(6, 8)], [(6, 8), (8, 6), (7, 7)]))
def test_a_gel_pressed_and_dragged_over_another(cells: tuple[int, int]) -> None:
    lower, upper = (
        block_mesh((n, n, 3), (4e-3, 4e-3, 2e-3), jitter=0.2, seed=k + 1)
        for k, n in enumerate(cells)
    )
    gels = [linear(lower, GEL, name="lower"), linear(upper, GEL, name="upper", mount="hand")]
    run = Watched(Scene(gels, KinematicBody(None, name="hand")), upside_down(0, 3e-5))
    for x, z, deg in ((0, -1e-4, 0), (0, -3e-4, 0), (1e-4, -3e-4, 0), (3e-4, -4e-4, 3)):
        run.step(upside_down(x, z, deg))
        below, above = run.force(0), run.force(1)
        np.testing.assert_allclose(below, -above, atol=1e-12 * np.abs(below).max())
        assert below[2] < 0
    # Two gels as springs in series: half the strain in each, with the sides free to bulge.
    assert 0.15 < -run.force(0)[2] < 0.3


def hairpin(self_contact: bool) -> Scene:
    """A strip bent to a U on its side, its lower arm held, under a tilted plate."""
    radius, length = 0.5e-3, 7e-3
    straight = block_mesh((14, 2, 1), (length, 1e-3, 0.4e-3))
    along, depth = straight.nodes_m[:, 0] + length / 2, straight.nodes_m[:, 2]
    arc = np.pi * radius
    arm = (length - arc) / 2
    angle = np.clip((along - arm) / radius, 0, np.pi)
    away = radius - depth
    x = -away * np.sin(angle) + np.where(along < arm, arm - along, 0)
    x += np.where(along > arm + arc, along - arm - arc, 0)
    nodes = np.column_stack([x, -straight.nodes_m[:, 1], -away * np.cos(angle)])
    mesh = free(replace(straight, nodes_m=nodes))
    held = np.flatnonzero(along < 0.3 * arm)
    strip = linear(mesh, GEL, bonded_nodes=held, self_contact=self_contact)
    return Scene(strip, KinematicBody(box_mesh((4e-3, 3e-3, 0.5e-3)), name="plate"))


@pytest.mark.thorough
def test_a_folding_strip_meets_itself_unless_it_may_not() -> None:
    for self_contact in (True, False):
        made = hairpin(self_contact)
        top = made.soft_bodies[0].mesh.nodes_m[:, 2].max() + 0.4e-3
        path = [pose(1.5e-3, 0, top - d, (0, 1, 0), 3) for d in np.linspace(0, 1.4e-3, 15)]
        run = Watched(made, path[0])
        forces = []
        for poses in path[1:]:
            run.step(poses)
            forces.append(-run.force(0)[2])
        if not self_contact:
            assert len(self_crossings(run.x(0), made.soft_bodies[0].mesh.faces)[0]) > 0
            continue
        assert run.self_contacts() > 0
        # In the end they slip past each other sideways, a step sooner or later.
        assert max(forces[9:]) > 4 * forces[8], "the arms support each other"
        total = run.contact()
        np.testing.assert_allclose(total.sum(axis=0), 0, atol=1e-12 * np.abs(total).sum())


@pytest.mark.slow
def test_a_mat_twisted_by_two_turns() -> None:
    """One end held, the other gripped by friction between two jaws that turn about the mat."""
    length, width, height = 8e-3, 4e-3, 0.3e-3
    mesh = free(block_mesh((16, 8, 1), (length, width, height)))
    mesh = replace(mesh, nodes_m=mesh.nodes_m + [0, 0, height / 2])
    held = np.flatnonzero(mesh.nodes_m[:, 0] < -length / 2 + 1e-9)
    jaw = box_mesh((1.2e-3, 1.2 * width, 0.5e-3))
    jaws = [KinematicBody(jaw, 5.0, name=name) for name in ("upper jaw", "lower jaw")]
    made = Scene(linear(mesh, GEL, bonded_nodes=held, self_contact=True), jaws)

    def gripped(gap: float, deg: float) -> np.ndarray:
        angle = np.deg2rad(deg)
        normal = np.array([0, -np.sin(angle), np.cos(angle)]) * (0.25e-3 + height / 2 + gap)
        middle = np.array([length / 2 - 0.6e-3, 0, 0])
        turned = [pose(*(middle + side * normal), (1, 0, 0), deg) for side in (1, -1)]
        return everywhere(1, *turned)

    run = Watched(made, gripped(3e-5, 0))
    run.walk(gripped(gap, 0) for gap in (-1e-5, -4e-5, -6e-5))
    run.walk(gripped(-6e-5, deg) for deg in np.arange(12, 721, 12))
    assert run.self_contacts() > 20
    # The gripped end has turned with the jaws.
    end = run.x(0)[mesh.nodes_m[:, 0] > length / 2 - 1e-9]
    across = end[:, 1].max() - end[:, 1].min()
    assert across > 0.9 * width


@pytest.mark.parametrize(
    ("friction", "lowest"), [pytest.param(0.0, 0.5e-3, marks=pytest.mark.slow), (0.5, 0.4e-3)]
)
def test_a_cube_squeezed_to_a_fifth_of_its_height(friction: float, lowest: float) -> None:
    side = 2e-3
    mesh = free(block_mesh((5, 5, 5), (side, side, side), jitter=0.1))
    place = pose(0, 0, side + 3e-5)
    made = Scene(
        linear(mesh, GEL, bonded_nodes=FREE, self_contact=True, initial_pose=place),
        KinematicBody(box_mesh((8e-3, 8e-3, 0.5e-3)), friction, name="plate"),
        planes=Plane(friction_coefficient=friction),
        time=in_time(0.02, 0.0),
    )
    heights = [*np.arange(2.0e-3, 0.55e-3, -0.2e-3), 0.5e-3, lowest]
    run = Watched(made, pose(0, 0, 2.1e-3 + 0.25e-3))
    run.walk(pose(0, 0, h + 0.25e-3) for h in heights)
    size = np.ptp(run.x(0), axis=0)
    assert size[2] < lowest
    assert size[:2].min() > 1.6 * side
    plate, plane = run.force(1), run.force(2)
    assert plate[2] > 0.1
    assert plate[2] == pytest.approx(-plane[2], rel=1e-2), "all of it goes into the plane"


@pytest.mark.parametrize("turn", variants([20.0], [90.0, 20.0, 2.0]))
def test_a_ridge_dropped_on_a_ridge(turn: float) -> None:
    """Only two edges face each other: the guard alone has to stop them."""
    shape = roof(1e-3, 1e-3, 4e-3)
    # Half a turn about x, then ``turn`` about z.
    start = upside_down(0, 2e-4, turn)[0, 0]
    velocity = (0.0, 0.0, -0.1)
    upper = AffineBody(shape, initial_pose=start, initial_velocity_m_s=velocity)
    lower = KinematicBody(shape)
    run = Watched(Scene((), lower, time=in_time(1e-3), affine_bodies=upper))
    seen = False
    for _ in range(8):
        report = run.step()
        seen |= bool((run.solver.collisions.snapshot(0)["kinds"] == EDGE_EDGE).any())
        assert report.newton_iterations[0] < 60
    assert seen
    speed = run.state.velocities.numpy()[0, run.model.affine.first_control, 2]
    assert speed > -0.05, "it was stopped"


def test_a_knife_between_the_nodes_of_a_gel() -> None:
    """Its edge crosses edges of the gel and its ends lie outside: no node of either is near."""
    mesh = block_mesh((5, 5, 3), (4e-3, 4e-3, 2e-3), jitter=0.1, seed=3)
    knife = KinematicBody(roof(0.3e-3, 2e-3, 6e-3), friction_coefficient=0.3)

    def placed(z: float, x: float = 0.0) -> np.ndarray:
        return pose(x, 0, z, (1, 0.1, 0), 180)

    run = Watched(Scene(linear(mesh, GEL), knife), placed(3e-5 + 4e-4))
    forces = []
    for z in (1e-4, -1e-4, -3e-4, -5e-4):
        run.step(placed(z))
        forces.append(run.force(1)[2])
    assert np.all(np.diff(forces) > 0)
    assert forces[-1] > 0.02
    run.step(placed(-5e-4, 2e-4))
    assert (run.solver.collisions.snapshot(0)["kinds"] == EDGE_EDGE).any()
