# SPDX-License-Identifier: Apache-2.0
"""What a gel shows its policy: views and colours."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid, Region
from taccel_lab.learning.catalogue import make_vec
from taccel_lab.learning.gel_colors import default_colors
from taccel_lab.learning.gel_views import GelViews
from taccel_lab.model.embedding import rotate
from taccel_lab.outputs import Outputs
from taccel_lab.profile import SensorProfile
from taccel_lab.scene import Element
from taccel_lab.sensors.profile import catalogue_profile, stock_sensor
from taccel_lab.signals import MarkerLayout
from taccel_lab.signals.gel_faces import face_grid, marker_points_mm
from tests.solvers.driven_grasp import SIDES, START_M, driven_squeeze, face_pose, prescribed_squeeze
from tests.support.scene_steps import Stepped


@pytest.fixture(scope="module")
def pressed() -> tuple:
    """Two environments whose gels hold a peg, turned differently, and what they observe."""
    observe = ("depth_m", "markers_px", "wrench", "traction_pa", "contact")
    env = make_vec("peg-insertion", 2, observe=observe, device="cpu")
    env.reset(seed=4)
    for _ in range(6):
        seen = env.step(torch.tensor([[0.2, 0.0, -0.5, 1.0], [0.0, -0.3, -0.2, 0.0]]))[0]
    return env, {name: part.numpy() for name, part in seen.items()}


def in_gel(env: Any, vectors: np.ndarray, gel: int, origin: bool) -> np.ndarray:
    pose = env.state.poses.numpy()[:, None, gel]
    inverse = pose[..., 3:] * [-1, -1, -1, 1]
    return rotate(inverse, vectors - pose[..., :3] * origin)


def test_markers_are_where_their_faces_are(pressed: tuple) -> None:
    env, seen = pressed
    for gel in range(2):
        mesh = env.model.scene.soft_bodies[gel].nodal_mesh
        points = marker_points_mm(face_grid(mesh, (80, 60)))
        assert len(np.unique(points, axis=0)) == 48
        layout = MarkerLayout.from_points(mesh, points)
        nodes = layout.nodes + env.model.bodies[gel].node_slice.start
        positions = in_gel(env, env.state.positions.numpy(), gel, True)
        now = np.einsum("mk,emkc->emc", layout.weights, positions[:, nodes])
        grid = face_grid(mesh, (80, 60))
        wanted = grid.pixel_from_gel(1e3 * now[..., :2])
        np.testing.assert_allclose(seen["markers_px"][:, gel], wanted, atol=1e-4)
        assert np.abs(1e3 * now[..., :2] - points).max() > 0.1


def test_depth_is_how_far_the_face_has_sunk(pressed: tuple) -> None:
    """At rest nothing; where a node is, the pixel above it says so within what a pixel differs."""
    env, seen = pressed
    mesh = env.model.scene.soft_bodies[1].nodal_mesh
    grid = face_grid(mesh, (80, 60))
    nodes = np.unique(mesh.region_faces(Region.CONTACT))
    positions = in_gel(env, env.state.positions.numpy(), 1, True)
    now = positions[:, env.model.bodies[1].node_slice][:, nodes]
    sunk = 1e3 * (mesh.nodes_m[nodes, 2] - now[..., 2])
    u, v = np.moveaxis(np.round(grid.pixel_from_gel(1e3 * now[..., :2])).astype(int), -1, 0)
    inside = (u > 1) & (u < 78) & (v > 1) & (v < 58)
    e = np.arange(2)[:, None].repeat(len(nodes), axis=1)
    found = 1e3 * seen["depth_m"][e[inside], 1, v[inside], u[inside]]
    assert sunk[inside].max() > 0.3
    np.testing.assert_allclose(found, sunk[inside], atol=0.04)


def test_wrenches_and_tractions_are_those_of_the_nodes(pressed: tuple) -> None:
    env, seen = pressed
    outputs = Outputs(env.solver).update(env.state)
    forces = outputs.normal_forces.numpy() + outputs.friction_forces.numpy()
    for gel in range(2):
        nodes = env.model.bodies[gel].node_slice
        total = in_gel(env, forces[:, nodes].sum(axis=1, keepdims=True), gel, False)[:, 0]
        np.testing.assert_allclose(seen["wrench"][:, gel, :3], total, rtol=1e-5, atol=1e-5)
        grid = env.views.grids[gel]
        area = 1e-6 * grid.mm_per_px_x * grid.mm_per_px_y
        # By area in the image, of a face that stays within a few degrees of flat.
        felt = area * seen["traction_pa"][:, gel].sum(axis=(1, 2))
        np.testing.assert_allclose(felt, total, atol=0.05 * np.abs(total).max())
        touched = np.abs(seen["traction_pa"][:, gel]).max(axis=-1) > 0
        assert touched[seen["contact"][:, gel]].all()
    # Pushed against its face by several newtons.
    assert (seen["wrench"][:, :, 2] < -3).all()


def test_a_gel_on_a_driven_finger_shows_what_one_on_a_frame_does() -> None:
    """Two pads squeezed by drives, and on frames that come to where the fingers are."""
    linear = (Element.LINEAR, Element.LINEAR)
    driven = Stepped(driven_squeeze(linear, 1e11), dhat_m=5e-5)
    driven.steps(60)
    assert driven.solver.joints is not None
    slides = driven.solver.joints.coordinates.numpy()[0]

    def poses(part: float) -> np.ndarray:
        sides = zip(SIDES, slides, strict=True)
        faces = [face_pose(side, START_M - part * slide) for side, slide in sides]
        return np.array([[*faces, [0, 0, 0, 0, 0, 0, 1]]])

    on_frames = Stepped(prescribed_squeeze(linear), poses(0), dhat_m=5e-5)
    on_frames.walk(poses(min((step + 1) / 10, 1.0)) for step in range(60))
    names = ("depth_m", "markers_px", "wrench", "traction_pa")
    views = [(GelViews(run.solver, names), run.state) for run in (driven, on_frames)]
    for name in names:
        found, wanted = (view.read(name, state).numpy() for view, state in views)
        size = np.abs(wanted).max()
        assert size > 1e-5
        np.testing.assert_allclose(found, wanted, atol=2e-3 * size, err_msg=name)


def background(sensor: SensorProfile, height: int, width: int) -> np.ndarray:
    rgb = sensor.background_rgb
    assert rgb is not None
    rows, columns = rgb.shape[0] // height, rgb.shape[1] // width
    return rgb.reshape(height, rows, width, columns, 3).mean(axis=(1, 3))


def test_a_tasks_gels_have_those_of_the_stock_sensor() -> None:
    env = make_vec("peg-insertion", 2, observe=("rgb", "depth_m"), size_px=(40, 30), device="cpu")
    first, _ = env.reset(seed=0)
    assert first["rgb"].shape == (2, 2, 30, 40, 3) and first["rgb"].dtype is torch.uint8
    differs = np.abs(first["rgb"].numpy() - background(stock_sensor("gelsight_mini"), 30, 40))
    assert differs.max() <= 1
    for _ in range(3):
        seen = env.step(torch.tensor([[0.0, 0.0, -1.0, 0.0]] * 2))[0]
    assert (seen["rgb"].int() - first["rgb"].int()).abs().max() > 3


@pytest.mark.thorough
def test_a_calibrated_sensor_has_its_own_and_its_cameras_pixels() -> None:
    sensor = stock_sensor("gelsight_mini")
    env = make_vec("grasp-lift", 1, sensor=sensor, observe=("rgb",), size_px=(64, 48), device="cpu")
    assert env.views.grids[0] == sensor.grid().resized(64, 48)
    first, _ = env.reset(seed=0)
    assert np.abs(first["rgb"][0, 0].numpy() - background(sensor, 48, 64)).max() <= 1


@pytest.mark.thorough
def test_a_changed_design_has_those_of_its_familys_starter() -> None:
    thin = catalogue_profile("gelsight_mini", {"thickness_mm": 3})
    grid = PixelGrid(20, 15, 1.0, 1.0)
    model, image = default_colors(thin)(grid)
    wanted, _ = default_colors(stock_sensor("gelsight_mini"))(grid)
    assert image.shape == (15, 20, 3) and model.config == wanted.config


@pytest.mark.parametrize("name", ["digit", "9dtact"])
def test_a_sensor_without_colours_is_refused_with_what_to_do(name: str) -> None:
    with pytest.raises(InputError, match=f"{name} has no colour model.*calibrate color"):
        default_colors(stock_sensor(name))
