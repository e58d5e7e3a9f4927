# SPDX-License-Identifier: Apache-2.0
"""What gels show and feel, and scenes in newton's viewers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.geometry.block import block_mesh
from taccel_lab.newton_bridge.show import SceneView
from taccel_lab.profile import BackgroundBlock, ColorBlock, SensorProfile
from taccel_lab.scene import Ball, KinematicBody, Plane, Scene, SoftBody
from tests.newton_bridge.squeezed_cube import (
    PAD,
    BodyGel,
    Simulation,
    SolverGel,
    cube_model,
    newton,
)
from tests.signals.tactile_cases import background, color_model
from tests.support.sample_blocks import ASSUMED, bare_profile
from tests.support.scene_steps import Stepped

SensorTactile = pytest.importorskip("taccel_lab.newton_bridge.sensor_tactile").SensorTactile


@pytest.fixture(scope="module")
def held() -> Simulation:
    run = Simulation(cube_model())
    run.solver.reset(run.state)
    run.squeeze(10)
    return run


def untouched() -> SolverGel:
    return Simulation(cube_model(), [BodyGel("left", PAD, name="pad")], []).solver


@pytest.mark.thorough
def test_a_gel_feels_the_cube_at_its_nodes(held: Simulation) -> None:
    sensor = SensorTactile(held.solver, "left pad", size_px=(64, 48)).update()
    forces, points = sensor.forces, sensor.points
    assert forces.shape == points.shape == (36, 3)
    # The force on the pad's face is what its jaw feels, into the gel: along -z of its frame.
    total = forces.sum(axis=0)
    assert total[2] == pytest.approx(-np.linalg.norm(held.solver.wrenches[0, :3]), rel=1e-4)
    assert sensor.wrench[:3] == pytest.approx(total, abs=1e-6)
    torque = np.cross(points, forces).sum(axis=0)
    assert sensor.wrench[3:] == pytest.approx(torque, abs=1e-7)
    # The cube's middle is that of the pad; a node of the pad's edge has its share of the cube's.
    middle = points[:, :2].T @ forces[:, 2] / total[2]
    assert np.abs(middle).max() < 1e-4
    assert (forces[:, 2] <= 0).all()
    height = sensor.height_m
    assert height.shape == (48, 64)
    # Jaws are 0.24 mm closer than would touch, and the cube stays off by up to dhat.
    assert height[24, 32] == pytest.approx(-0.24e-3 - 2.5e-5, abs=2.5e-5)
    assert height[24, 32] + 5e-5 < height[0, 0] < 0
    with pytest.raises(InputError, match="color_model"):
        _ = sensor.image


def colored_profile() -> SensorProfile:
    mesh, grid = PAD.mesh, PixelGrid(64, 48, 0.12, 0.16, 31.5, 23.5)
    colors = color_model(grid)
    color = ColorBlock(architecture=colors.config.to_dict(), provenance=ASSUMED)
    bare = bare_profile(mesh, grid, "pad", thickness_mm=3.0)
    shown = bare.with_block(BackgroundBlock(provenance=ASSUMED), background(grid))
    return shown.with_block(color, colors.weights)


@pytest.mark.thorough
@pytest.mark.parametrize("own", [False, True], ids=["linear gel", "the profile's gel"])
def test_a_gel_of_a_profile_has_images(own: bool) -> None:
    profile = colored_profile()
    gels = [BodyGel(side, profile if own else PAD, name=side) for side in ("left", "right")]
    run = Simulation(cube_model(), gels)
    run.solver.reset(run.state)
    sensor = SensorTactile(run.solver, "left", profile=profile).update()
    rest = sensor.image
    assert rest.shape == (48, 64, 3) and rest.dtype == np.uint8
    assert np.abs(rest.astype(int) - profile.background_rgb).max() <= 1  # type: ignore[operator]
    run.squeeze(5)
    changed = np.abs(sensor.update().image.astype(int) - rest).max(axis=2)
    assert changed.max() > 5
    other = SoftBody(block_mesh((4, 4, 2), (8e-3, 8e-3, 3e-3)), PAD.material)
    wrong = Simulation(cube_model(), [BodyGel("left", other, name="pad")], []).solver
    with pytest.raises(InputError, match="nodes, that of the profile 108"):
        SensorTactile(wrong, "pad", profile=profile)


def test_markers_move_with_the_face(held: Simulation) -> None:
    face = SensorTactile(held.solver, "right pad").face_nodes
    inner = np.abs(PAD.mesh.nodes_m[face, :2]).max(axis=1) < 3.9e-3
    at_mm = 1e3 * PAD.mesh.nodes_m[face[inner], :2]
    sensor = SensorTactile(held.solver, "right pad", markers_mm=at_mm).update()
    now = sensor.grid.pixel_from_gel(1e3 * sensor.points[inner, :2])
    np.testing.assert_allclose(sensor.markers_px, now, atol=1e-4)
    assert np.abs(now - sensor.grid.pixel_from_gel(at_mm)).max() > 0.1
    with pytest.raises(InputError, match="marker 1 lies beside the face of gel 'right pad'"):
        SensorTactile(held.solver, "right pad", markers_mm=[[0, 0], [9, 0]])


def test_bad_sensors_are_refused(held: Simulation) -> None:
    with pytest.raises(InputError, match=r"no gel 'pad' .*known: left pad, right pad"):
        SensorTactile(held.solver, "pad")
    with pytest.raises(InputError, match=r"call SolverGel\.reset or step before"):
        SensorTactile(untouched(), "pad").update()


def test_a_recording_of_newtons_has_where_the_bodies_were(held: Simulation, tmp_path: Path) -> None:
    solver = held.solver
    path = tmp_path / "cube.json"
    viewer = newton.viewer.ViewerFile(str(path), auto_save=False)
    view = SceneView(viewer, solver.gel_model)
    assert solver.gel_state is not None
    forces = solver.outputs.update(solver.gel_state).normal_forces.numpy()[0]
    view.log(solver.gel_state, 0.01, forces=forces)
    viewer.close()

    reader = newton.viewer.ViewerFile(str(path))
    reader.load_recording()
    assert reader.get_frame_count() == 1
    found = view.newton_model.state()
    reader.load_state(found, 0)
    count = 2 * PAD.mesh.node_count
    positions = solver.gel_state.positions.numpy()[0]
    np.testing.assert_allclose(found.particle_q.numpy(), positions[:count], atol=1e-9)
    labels = list(view.newton_model.body_label)
    shown = found.body_q.numpy()[labels.index("cube")]
    np.testing.assert_allclose(shown, held.poses()[2], atol=1e-7)


@pytest.mark.parametrize("env", [0, 1])
def test_any_scene_goes_into_any_viewer(env: int) -> None:
    gel, ball = SoftBody(PAD.mesh, PAD.material), KinematicBody(Ball(2e-3), name="ball")
    poses = np.array([[[0, 0, 2.1e-3, 0, 0, 0, 1.0]], [[1e-3, 0, 3e-3, 0, 0, 0, 1.0]]])
    run = Stepped(Scene(gel, ball, planes=Plane((0, 0, -0.1)), env_count=2), poses)
    run.step(poses)
    viewer = newton.viewer.ViewerNull(num_frames=2)
    view = SceneView(viewer, run.model)
    for frame in range(2):
        assert viewer.is_running()
        view.log(run.state, 0.1 * frame, env)
    assert not viewer.is_running()
    assert view.newton_state.body_q.numpy()[0] == pytest.approx(poses[env, 0], abs=1e-9)
    assert len(view.newton_state.particle_q) == PAD.mesh.node_count
