# SPDX-License-Identifier: Apache-2.0
"""Markers: a place on the face at rest, carried along by its nodes."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid, quadratic_mesh
from taccel_lab.profile import (
    BackgroundBlock,
    ColorBlock,
    MarkersBlock,
    SensorProfile,
)
from taccel_lab.scene import Element, Material, Scene, SoftBody
from taccel_lab.signals import MarkerLayout, SignalTactile
from taccel_lab.signals.color_model import ColorModelConfig, expected_shapes
from taccel_lab.solvers import SolverIPC
from tests.signals.pressed_surface import extrude, flat_pad
from tests.support.sample_blocks import ASSUMED, bare_profile

GRID = PixelGrid(96, 72, 0.05, 0.04, 40.0, 30.0)
MESH = flat_pad(0.4, (3.0, 2.4), seed=3)
POINTS_MM = np.random.default_rng(0).uniform(-1.9, 1.9, (25, 2))


def markers_px(mesh, positions: np.ndarray, points_mm: np.ndarray = POINTS_MM) -> np.ndarray:
    layout = MarkerLayout.from_points(mesh, points_mm)
    signal = SignalTactile(mesh, GRID, env_count=len(positions), markers=layout)
    signal.update(wp.array(positions, dtype=wp.vec3d, device="cpu"))
    return signal.markers_px.numpy()


def dotted_profile() -> SensorProfile:
    """``MESH`` with 5 x 4 dark dots and colours that no press changes."""
    markers = MarkersBlock(
        rows=4, columns=5, pitch_x_mm=0.8, pitch_y_mm=0.7, radius_mm=0.15, provenance=ASSUMED
    )
    v, u = np.mgrid[: GRID.height_px, : GRID.width_px]
    image = np.full((*u.shape, 3), 150.0, np.float32)
    for place in GRID.pixel_from_gel(markers.grid().points_mm()):
        image[np.hypot(u - place[0], v - place[1]) <= 3.0] = 30.0
    config = ColorModelConfig(GRID.width_px, GRID.height_px, hidden=(8, 8))
    still = {name: np.zeros(shape, np.float32) for name, shape in expected_shapes(config).items()}
    profile = bare_profile(MESH, GRID, "dotted")
    profile = profile.with_block(BackgroundBlock(provenance=ASSUMED), image)
    profile = profile.with_block(
        ColorBlock(architecture=config.to_dict(), provenance=ASSUMED), still
    )
    return profile.with_block(markers)


def test_markers_at_rest_are_where_they_were_put():
    expected = GRID.pixel_from_gel(POINTS_MM)
    for mesh in (MESH, quadratic_mesh(MESH)):
        found = markers_px(mesh, mesh.nodes_m[None])
        assert found.shape == (1, 25, 2)
        assert np.abs(found - expected).max() < 1e-5


@settings(max_examples=20)
@given(st.lists(st.floats(-0.5, 0.5), min_size=6, max_size=6), st.integers(0, 100))
def test_markers_follow_linear_deformations_exactly(entries, seed):
    turn = np.eye(2) + np.array(entries[:4]).reshape(2, 2)
    shift = np.array(entries[4:])
    points = np.random.default_rng(seed).uniform(-1.9, 1.9, (5, 2))
    positions = MESH.nodes_m[None].repeat(2, axis=0)
    positions[1, :, :2] = positions[1, :, :2] @ turn.T + shift * 1e-3
    found = markers_px(MESH, positions, points)
    assert np.abs(found[0] - GRID.pixel_from_gel(points)).max() < 1e-4
    assert np.abs(found[1] - GRID.pixel_from_gel(points @ turn.T + shift)).max() < 1e-4


def test_a_marker_moves_with_its_face_only():
    layout = MarkerLayout.from_points(MESH, POINTS_MM)
    positions = MESH.nodes_m[None].copy()
    node = layout.nodes[4, 1]
    positions[0, node, 0] += 1e-3
    moved = markers_px(MESH, positions)[0] - markers_px(MESH, MESH.nodes_m[None])[0]
    share = np.where(layout.nodes == node, layout.weights, 0.0).sum(axis=1)
    assert share[4] > 0.01 and (share == 0).any()
    assert np.abs(moved[:, 0] - share / GRID.mm_per_px_x).max() < 1e-4
    assert np.abs(moved[:, 1]).max() < 1e-4


def test_of_two_layers_the_lower_carries_the_marker():
    xy = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * 3e-3
    mesh = extrude(np.concatenate([xy, xy]), np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]))
    nodes = mesh.nodes_m.copy()
    nodes[:4, 2] += 5e-4
    upper = type(mesh)(nodes, mesh.tets, mesh.faces, mesh.face_regions)
    assert (MarkerLayout.from_points(upper, np.array([[0.5, 0.2]])).nodes >= 4).all()


def test_markers_beside_the_face_are_refused():
    with pytest.raises(InputError, match=r"marker 1 .* beside"):
        MarkerLayout.from_points(MESH, np.array([[0.0, 0.0], [9.0, 0.0]]))
    with pytest.raises(InputError, match="xy_mm"):
        MarkerLayout.from_points(MESH, np.array([0.0, 0.0]))
    with pytest.raises(InputError, match="xy_mm"):
        MarkerLayout.from_points(MESH, np.array([[np.nan, 0.0]]))


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda:0", marks=pytest.mark.gpu)])
def test_gels_of_other_shapes_have_their_markers_in_the_same_places(device: str):
    """The same cells, graded otherwise in the second and third environments. On a GPU squares about
    neighbouring dots, which overlap, are painted at the same time."""
    if device != "cpu" and not wp.is_cuda_available():
        pytest.skip("no CUDA device")
    graded = MESH.nodes_m.copy()
    half = np.abs(graded[:, :2]).max(axis=0)
    graded[:, :2] += [0.1, -0.08] * half * np.sin(np.pi * graded[:, :2] / half)
    rests = np.stack([MESH.nodes_m, graded, graded])
    profile = dotted_profile()
    assert profile.markers is not None
    points = profile.markers.grid().points_mm()
    for element in (Element.LINEAR, Element.QUADRATIC):
        soft = SoftBody(MESH, Material(1e5, 0.45), rest_positions_m=rests, element=element)
        model = Scene(soft_bodies=[soft], env_count=3).finalize(device=device)
        solver = SolverIPC(model)
        signal = SignalTactile.from_profile(profile, solver=solver)
        positions = model.rest_positions.numpy()
        signal.update(wp.array(positions, dtype=wp.vec3d, device=device))
        found, image = (array.numpy() for array in signal.read("markers_px", "rgb_levels"))
        assert np.abs(found - GRID.pixel_from_gel(points)).max() < 1e-4
        assert np.abs(image - profile.background_rgb).max() < 0.6
        # Any motion of the gel that keeps it plane moves them alike, whatever its cells are.
        turn = np.array([[1.03, 0.05], [-0.02, 0.96]])
        positions[..., :2] = positions[..., :2] @ turn.T
        signal.update(wp.array(positions, dtype=wp.vec3d, device=device))
        found, image = (array.numpy() for array in signal.read("markers_px", "rgb_levels"))
        assert np.abs(found - GRID.pixel_from_gel(points @ turn.T)).max() < 1e-4
        assert np.abs(image[1:] - image[0]).max() < 1e-2


def test_markers_of_another_number_of_gels_are_refused():
    rests = np.stack([MESH.nodes_m, MESH.nodes_m * [1.01, 1.0, 1.0]])
    layout = MarkerLayout.from_points(MESH, POINTS_MM, rests)
    signal = SignalTactile(MESH, GRID, env_count=3, markers=layout)
    signal.update(wp.array(MESH.nodes_m[None].repeat(3, 0), dtype=wp.vec3d, device="cpu"))
    with pytest.raises(InputError, match="markers of 2 gels, but there are 3"):
        _ = signal.markers_px
