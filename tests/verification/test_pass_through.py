# SPDX-License-Identifier: Apache-2.0
"""No body passes through a gel, another body or a sheet, whatever its label, way or speed.

Every face of a gel is an obstacle: free ones whose label says glued, and the glued ones themselves.
Targets whose way leads through a body are pushed ahead or flagged.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from taccel_lab.bodies.material import MaterialModel
from taccel_lab.geometry import Region
from taccel_lab.scene import (
    AffineBody,
    Ball,
    Element,
    KinematicBody,
    Material,
    Plane,
    Scene,
    SoftBody,
    TriangleMesh,
    box_mesh,
    sphere_mesh,
)
from taccel_lab.solvers import StepReport
from tests.support.blocks import block_mesh, pose
from tests.support.scene_steps import Stepped, in_time, linear
from tests.support.variants import variants

MESH = block_mesh((3, 3, 2), (6e-3, 6e-3, 2e-3), jitter=0.1)
SOFT = Material(1e5, 0.4)
BACK = -2e-3
"""Height of the faces that the mesh calls glued."""
HASTY = {"max_newton_iterations": 60, "max_substep_halvings": 2}
BODIES = {"ball": Ball(1e-3), "mesh": sphere_mesh(1e-3, 0.4e-3)}
CUBE = box_mesh((1e-3, 1e-3, 1e-3))
SHEET = TriangleMesh(CUBE.vertices_m[:4], CUBE.faces[:2])
"""The lower face of the cube alone, without volume."""


class Way(Stepped):
    """After a step no two surfaces may cross; it is there exactly when it says so."""

    def attempt(self, *target: Any, **who: Any) -> StepReport:
        report = super().attempt(*target, **who)
        assert self.crossings() == []
        if target:
            found = self.state.poses.numpy().reshape(-1, 7)
            reached = np.abs(found - np.stack(target)).max() < 1e-12
            assert reached == bool(report.converged[0])
        return report


@pytest.mark.parametrize(
    ("element", "region", "shape"),
    variants(
        [(Element.LINEAR, Region.BOND, "ball"), (Element.QUADRATIC, Region.WINDOW, "mesh")],
        Element,
        [Region.BOND, Region.WINDOW],
        BODIES,
    ),
)
def test_labels_open_no_free_face(element: Element, region: Region, shape: str) -> None:
    """The block hangs by its upper face; a body comes up against the face called glued."""
    regions = np.where(MESH.face_regions == Region.BOND, int(region), MESH.face_regions)
    mesh = replace(MESH, face_regions=regions)
    soft = SoftBody(mesh, SOFT, mesh.region_nodes(Region.CONTACT), element=element)
    below = BACK - 1e-3
    way = Way(Scene(soft, KinematicBody(BODIES[shape])), pose(2e-4, 1e-4, below - 5e-5))
    for depth in (1e-4, 3e-4):
        way.step(pose(2e-4, 1e-4, below + depth))
    assert way.force(0)[2] > 0.01
    assert way.x()[: mesh.node_count, 2].min() > BACK - 1e-4


@pytest.mark.parametrize("element", variants([Element.QUADRATIC], Element))
def test_a_free_face_is_not_left_open_where_some_of_its_nodes_are_held(element: Element) -> None:
    back = MESH.region_nodes(Region.BOND)
    rim = back[np.abs(MESH.nodes_m[back, :2]).max(axis=1) > 2.9e-3]
    soft = SoftBody(MESH, SOFT, rim, element=element)
    way = Way(Scene(soft, KinematicBody(Ball(1e-3))), pose(0, 0, BACK - 1e-3 - 5e-5))
    way.step(pose(0, 0, BACK - 1e-3 + 2e-4))
    middle = back[np.linalg.norm(MESH.nodes_m[back, :2], axis=1) < 2e-3]
    assert (way.x()[middle, 2] - MESH.nodes_m[middle, 2]).max() > 5e-5


@pytest.mark.parametrize(
    ("element", "mounted"),
    variants([(Element.LINEAR, True), (Element.QUADRATIC, False)], Element, [False, True]),
)
def test_a_free_body_that_comes_from_behind_bounces_off(element: Element, mounted: bool) -> None:
    frames = [KinematicBody(None, name="mount")] if mounted else []
    soft = SoftBody(MESH, SOFT, element=element, mount="mount" if mounted else None)
    place = pose(3e-4, 2e-4, BACK - 1.2e-3)
    bullet = AffineBody(CUBE, initial_pose=place, initial_velocity_m_s=(0.0, 0.0, 0.5))
    way = Way(Scene(soft, frames, time=in_time(1e-3, 0.0), affine_bodies=bullet))
    highest = -np.inf
    for _ in range(8):
        way.step()
        highest = max(highest, float(way.x()[way.model.affine.first_control, 2]))
    assert highest < BACK - 0.5e-3
    # The glued nodes give no way, so the gel is not bent.
    np.testing.assert_allclose(way.x(0), soft.nodal_mesh.nodes_m, atol=1e-9)


@pytest.mark.thorough(cases=("quadratic-neo_hookean",))
@pytest.mark.parametrize(
    ("element", "law"),
    variants(
        [
            (Element.QUADRATIC, MaterialModel.NEO_HOOKEAN),
            (Element.LINEAR, MaterialModel.ST_VENANT_KIRCHHOFF),
        ],
        Element,
        [MaterialModel.ST_VENANT_KIRCHHOFF, MaterialModel.NEO_HOOKEAN],
    ),
)
def test_a_needle_stops_at_a_glued_back(element: Element, law: MaterialModel) -> None:
    """Step by step down, until the target lies beyond the back: never there, and it says so."""
    soft = SoftBody(MESH, Material(1e5, 0.3, model=law), element=element)
    needle = TriangleMesh(
        np.array([[0, 0, 0], [3e-4, 0, 4e-3], [-2e-4, 3e-4, 4e-3], [-2e-4, -3e-4, 4e-3]]),
        np.array([[0, 2, 1], [0, 3, 2], [0, 1, 3], [1, 2, 3]]),
    )
    way = Way(Scene(soft, KinematicBody(needle)), pose(4e-4, 3e-4, 1e-4), **HASTY)
    heights = np.linspace(0, BACK - 4e-4, 9)
    assert not all(way.attempt(pose(4e-4, 3e-4, float(z))).converged[0] for z in heights)
    assert way.x(1)[:, 2].min() > BACK


def test_the_mount_of_a_gel_may_coincide_with_its_glued_back() -> None:
    """A plate that the gel is mounted on, its face in that of the glued back."""
    plate = box_mesh((4e-3, 4e-3, 1e-3))
    plate = TriangleMesh(plate.vertices_m + [0, 0, BACK - 0.5e-3], plate.faces)
    bodies = [KinematicBody(plate, name="plate"), KinematicBody(Ball(2e-3), name="ball")]
    scene = Scene(linear(MESH, SOFT, mount="plate"), bodies)
    way = Way(scene, pose(0, 0, 0), pose(0, 0, 2e-3 + 5e-5))
    assert way.step(pose(0, 0, 1e-4), pose(0, 0, 2e-3 - 2e-4)).contact_force_n[0] > 0.01


def test_a_glued_back_is_stopped_by_a_plane() -> None:
    mount, floor = KinematicBody(None, name="mount"), Plane((0, 0, BACK - 1e-4))
    way = Way(Scene(linear(MESH, SOFT, mount="mount"), mount, planes=floor), **HASTY)
    assert not way.attempt(pose(0, 0, -1e-3)).converged[0]


GEL = linear(block_mesh((4, 4, 2), (4e-3, 4e-3, 2e-3), jitter=0.15), SOFT)


@pytest.mark.parametrize("shape", [Ball(1e-3), CUBE, SHEET])
def test_through_a_gel_on_its_back(shape: TriangleMesh | Ball) -> None:
    """From above the gel to beyond its glued back, where nothing would overlap."""
    way = Way(Scene(GEL, KinematicBody(shape)), pose(1e-4, 2e-4, 1.2e-3), **HASTY)
    assert not way.attempt(pose(1e-4, 2e-4, -8e-3)).converged[0]
    assert way.state.poses.numpy()[0, 0, 2] == 1.2e-3


def test_a_bar_that_turns_through_the_gel() -> None:
    """Along its chord the bar would pass above, along its arc it goes through."""
    bar = box_mesh((7e-3, 1e-3, 1e-3))
    arm = KinematicBody(TriangleMesh(bar.vertices_m + [4.5e-3, 0, 0], bar.faces))
    way = Way(Scene(GEL, arm), pose(0, 0, 3e-3), **HASTY)
    assert not way.attempt(pose(0, 0, 3e-3, (0, 1, 0), 175.0)).converged[0]


@pytest.mark.parametrize("floor", [False, True])
def test_a_pusher_drives_a_free_body_ahead_or_stops(floor: bool) -> None:
    """A cube that cannot give way on a floor stops the pusher, which says so."""
    pusher = KinematicBody(box_mesh((1.4e-3, 1.4e-3, 1e-3)))
    planes = [Plane((0, 0, -1e-3))] if floor else []
    cube = AffineBody(CUBE, 2000)
    scene = Scene((), pusher, time=in_time(5e-3, 0.0), affine_bodies=cube, planes=planes)
    way = Way(scene, pose(0, 0, 1.3e-3), **HASTY)
    assert way.attempt(pose(0, 0, -5e-3)).converged[0] != floor
    first = way.x()[0, 2]
    assert first > -1e-3 if floor else first < -5.9e-3


def test_a_free_body_that_flies_at_a_thin_sheet() -> None:
    sheet = KinematicBody(TriangleMesh(SHEET.vertices_m * [8, 8, 1], SHEET.faces))
    place = pose(0.3e-3, 0.2e-3, 3e-3)
    bullet = AffineBody(CUBE, 2000, initial_pose=place, initial_velocity_m_s=(0.0, 0.0, -4.0))
    scene = Scene((), sheet, time=in_time(5e-3, 0.0), affine_bodies=bullet)
    way = Way(scene, pose(0, 0, 0), **HASTY)
    way.attempt(pose(0, 0, 0))
    assert way.x()[0, 2] > -0.5e-3
