# SPDX-License-Identifier: Apache-2.0
"""No body passes through a gel, another body or a sheet, whatever its label, way or speed.

Every face of a gel is an obstacle: free ones whose label says glued, and the glued ones themselves.
Targets whose way leads through a body are pushed ahead or flagged.
"""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.bodies.material import MaterialModel
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.geometry.block import block_mesh
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
    sphere_mesh,
)
from taccel_lab.solvers.config import SolverConfig
from taccel_lab.solvers.solver_ipc import SolverIPC
from taccel_lab.solvers.step_report import StepReport
from taccel_lab.state import State, initial_state
from tests.support.blocks import everywhere, pose
from tests.support.intersection import find_intersections
from tests.support.variants import variants

MESH = block_mesh((3, 3, 2), (6e-3, 6e-3, 2e-3), jitter=0.1)
SOFT = Material(1e5, 0.4)
BACK = -2e-3
"""Height of the faces that the mesh calls glued."""
DYNAMIC = TimeStepping(quasi_static=False, dt_s=1e-3)
HASTY = SolverConfig(max_newton_iterations=60, max_substep_halvings=2)
BODIES = {"ball": Ball(1e-3), "mesh": sphere_mesh(1e-3, 0.4e-3)}


def with_back(region: Region) -> TetMesh:
    regions = np.where(MESH.face_regions == Region.BOND, int(region), MESH.face_regions)
    return TetMesh(MESH.nodes_m, MESH.tets, MESH.faces, regions)


def step(solver: SolverIPC, state: State, *target: np.ndarray) -> StepReport:
    """One step, after which no two surfaces may cross; it is there exactly when it says so."""
    report = solver.step(state, everywhere(1, *target) if target else None)
    assert find_intersections(solver.model, state) == [[]]
    if target:
        reached = np.abs(state.poses.numpy().reshape(-1, 7) - np.stack(target)).max() < 1e-12
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
def test_a_free_face_is_pressed_whatever_its_label_says(
    element: Element, region: Region, shape: str
) -> None:
    """The block hangs by its upper face; a body comes up against the face called glued."""
    mesh = with_back(region)
    held = mesh.region_nodes(Region.CONTACT)
    soft = SoftBody(mesh, SOFT, bonded_nodes=held, element=element)
    model = Scene(soft, KinematicBody(BODIES[shape])).finalize()
    start = BACK - 1e-3 - 5e-5
    solver, state = SolverIPC(model), initial_state(model, everywhere(1, pose(2e-4, 1e-4, start)))
    for depth in (1e-4, 3e-4):
        report = step(solver, state, pose(2e-4, 1e-4, BACK - 1e-3 + depth))
        assert report.converged[0], report.summary()
    up = -solver.contact_gradient.numpy()[0, : model.soft_count].sum(axis=0)[2]
    assert up > 0.01
    assert state.positions.numpy()[0, : mesh.node_count, 2].min() > BACK - 1e-4


@pytest.mark.parametrize("element", variants([Element.QUADRATIC], Element))
def test_a_free_face_is_not_left_open_where_some_of_its_nodes_are_held(element: Element) -> None:
    """Only the rim of the back is glued: its middle is a membrane that a body lies on."""
    back = MESH.region_nodes(Region.BOND)
    rim = back[np.abs(MESH.nodes_m[back, :2]).max(axis=1) > 2.9e-3]
    soft = SoftBody(MESH, SOFT, bonded_nodes=rim, element=element)
    model = Scene(soft, KinematicBody(Ball(1e-3))).finalize()
    start = everywhere(1, pose(0, 0, BACK - 1e-3 - 5e-5))
    solver, state = SolverIPC(model), initial_state(model, start)
    report = step(solver, state, pose(0, 0, BACK - 1e-3 + 2e-4))
    assert report.converged[0], report.summary()
    middle = back[np.linalg.norm(MESH.nodes_m[back, :2], axis=1) < 2e-3]
    assert (state.positions.numpy()[0, middle, 2] - MESH.nodes_m[middle, 2]).max() > 5e-5


@pytest.mark.parametrize(
    ("element", "mounted"),
    variants([(Element.LINEAR, True), (Element.QUADRATIC, False)], Element, [False, True]),
)
def test_a_free_body_that_comes_from_behind_bounces_off(element: Element, mounted: bool) -> None:
    frames = [KinematicBody(None, name="mount")] if mounted else []
    soft = SoftBody(MESH, SOFT, element=element, mount="mount" if mounted else None)
    start = BACK - 1.2e-3
    bullet = AffineBody(
        box_mesh((1e-3, 1e-3, 1e-3)),
        initial_pose=pose(3e-4, 2e-4, start),
        initial_velocity_m_s=(0.0, 0.0, 0.5),
    )
    scene = Scene(soft, frames, time=DYNAMIC, affine_bodies=bullet)
    model = scene.finalize()
    poses = everywhere(1, pose(0, 0, 0)) if mounted else np.zeros((1, 0, 7))
    solver, state = SolverIPC(model), initial_state(model, poses)
    centre = model.affine.first_control
    highest = -np.inf
    for _ in range(8):
        report = step(solver, state)
        assert report.converged[0], report.summary()
        highest = max(highest, float(state.positions.numpy()[0, centre, 2]))
    assert highest < BACK - 0.5e-3
    # The glued nodes give no way, so the gel is not bent.
    x = state.positions.numpy()[0, : model.soft_count]
    np.testing.assert_allclose(x, soft.nodal_mesh.nodes_m, atol=1e-9)


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
def test_a_body_pressed_through_a_gel_stops_at_its_glued_back(
    element: Element, law: MaterialModel
) -> None:
    """Step by step down, until the target lies beyond the back: never there, and it says so."""
    soft = SoftBody(MESH, Material(1e5, 0.3, model=law), element=element)
    needle = TriangleMesh(
        np.array([[0, 0, 0], [3e-4, 0, 4e-3], [-2e-4, 3e-4, 4e-3], [-2e-4, -3e-4, 4e-3]]),
        np.array([[0, 2, 1], [0, 3, 2], [0, 1, 3], [1, 2, 3]]),
    )
    model = Scene(soft, KinematicBody(needle)).finalize()
    solver = SolverIPC(model, HASTY)
    state = initial_state(model, everywhere(1, pose(4e-4, 3e-4, 1e-4)))
    reports = []
    for z in np.linspace(0, BACK - 4e-4, 9):
        reports.append(step(solver, state, pose(4e-4, 3e-4, float(z))))
        if not reports[-1].converged[0]:
            break
    assert not reports[-1].converged[0]
    assert state.positions.numpy()[0, model.bodies[1].node_slice, 2].min() > BACK


def test_the_mount_of_a_gel_may_coincide_with_its_glued_back() -> None:
    """A plate that the gel is mounted on, its face in that of the glued back."""
    plate = box_mesh((4e-3, 4e-3, 1e-3))
    plate = TriangleMesh(plate.vertices_m + [0, 0, BACK - 0.5e-3], plate.faces)
    bodies = [KinematicBody(plate, name="plate"), KinematicBody(Ball(2e-3), name="ball")]
    model = Scene(SoftBody(MESH, SOFT, mount="plate", element=Element.LINEAR), bodies).finalize()
    start = [pose(0, 0, 0), pose(0, 0, 2e-3 + 5e-5)]
    solver, state = SolverIPC(model), initial_state(model, everywhere(1, *start))
    report = step(solver, state, pose(0, 0, 1e-4), pose(0, 0, 2e-3 - 2e-4))
    assert report.converged[0], report.summary()
    assert report.contact_force_n[0] > 0.01


def test_a_glued_back_is_stopped_by_a_plane() -> None:
    """The mount is driven into the floor, back first."""
    soft = SoftBody(MESH, SOFT, mount="mount", element=Element.LINEAR)
    scene = Scene(soft, KinematicBody(None, name="mount"), planes=Plane((0, 0, BACK - 1e-4)))
    model = scene.finalize()
    solver, state = SolverIPC(model, HASTY), initial_state(model, everywhere(1, pose(0, 0, 0)))
    assert not step(solver, state, pose(0, 0, -1e-3)).converged[0]


JITTERED_GEL = SoftBody(
    block_mesh((4, 4, 2), (4e-3, 4e-3, 2e-3), jitter=0.15),
    Material(1e5, 0.4),
    element=Element.LINEAR,
)


def take(scene: Scene, start: np.ndarray, target: np.ndarray) -> tuple[bool, float, float]:
    """One step from a start without overlaps to a target: whether it is there, the height of the
    kinematic body's origin, and that of the first node."""
    solver = SolverIPC(scene.finalize(), HASTY)
    state = initial_state(solver.model, everywhere(1, start))
    report = step(solver, state, target)
    height, first = state.poses.numpy().reshape(7)[2], state.positions.numpy()[0, 0, 2]
    return bool(report.converged[0]), float(height), float(first)


@pytest.mark.parametrize(
    "shape", [Ball(1e-3), box_mesh((1e-3, 1e-3, 1e-3)), box_mesh((1e-3, 1e-3, 1e-3)).faces]
)
def test_through_a_gel_on_its_back(shape: TriangleMesh | Ball | np.ndarray) -> None:
    """From above the gel to beyond its glued back, where nothing would overlap."""
    if isinstance(shape, np.ndarray):
        # A sheet without volume: the lower face of the box alone.
        shape = TriangleMesh(box_mesh((1e-3, 1e-3, 1e-3)).vertices_m[:4], shape[:2])
    scene = Scene(JITTERED_GEL, KinematicBody(shape))
    there, z, _ = take(scene, pose(1e-4, 2e-4, 1.2e-3), pose(1e-4, 2e-4, -8e-3))
    assert not there and z == 1.2e-3


def test_a_bar_that_turns_through_the_gel() -> None:
    """Along its chord the bar would pass above, along its arc it goes through."""
    bar = box_mesh((7e-3, 1e-3, 1e-3))
    arm = TriangleMesh(bar.vertices_m + [4.5e-3, 0, 0], bar.faces)
    start, end = pose(0, 0, 3e-3, (0, 1, 0), 0.0), pose(0, 0, 3e-3, (0, 1, 0), 175.0)
    assert not take(Scene(JITTERED_GEL, KinematicBody(arm)), start, end)[0]


def cube(z: float) -> AffineBody:
    return AffineBody(box_mesh((1e-3, 1e-3, 1e-3)), 2000, initial_pose=pose(0, 0, z))


LONG_STEPS = TimeStepping(quasi_static=False, dt_s=5e-3)


def test_a_free_body_is_pushed_ahead() -> None:
    """The pusher goes five times its own size through where the cube was."""
    pusher = KinematicBody(box_mesh((1.4e-3, 1.4e-3, 1e-3)), name="pusher")
    scene = Scene((), pusher, time=LONG_STEPS, affine_bodies=cube(0.0))
    there, _, z = take(scene, pose(0, 0, 1.3e-3), pose(0, 0, -5e-3))
    assert there and z < -5.9e-3


def test_a_body_between_a_pusher_and_the_floor() -> None:
    """It cannot give way: the pusher stops, and says so."""
    pusher = KinematicBody(box_mesh((1.4e-3, 1.4e-3, 1e-3)), name="pusher")
    floor = Plane((0, 0, -1e-3))
    scene = Scene((), pusher, time=LONG_STEPS, affine_bodies=cube(0.0), planes=floor)
    there, _, z = take(scene, pose(0, 0, 1.3e-3), pose(0, 0, -5e-3))
    assert not there and z > -1e-3


def test_a_free_body_that_flies_at_a_thin_sheet() -> None:
    """Twenty times its own size a step, at a sheet without volume."""
    corners = box_mesh((8e-3, 8e-3, 1e-3))
    sheet = KinematicBody(TriangleMesh(corners.vertices_m[:4], corners.faces[:2]), name="sheet")
    bullet = AffineBody(
        box_mesh((1e-3, 1e-3, 1e-3)),
        2000,
        initial_pose=pose(0.3e-3, 0.2e-3, 3e-3),
        initial_velocity_m_s=(0.0, 0.0, -4.0),
    )
    scene = Scene((), sheet, time=LONG_STEPS, affine_bodies=bullet)
    assert take(scene, pose(0, 0, 0), pose(0, 0, 0))[2] > -0.5e-3
