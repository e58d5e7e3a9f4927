# SPDX-License-Identifier: Apache-2.0
"""Markers are carried along by the nodes of their face, and so are the dots of a colour model."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import RBFInterpolator
from scipy.ndimage import gaussian_filter

from taccel_lab.calibration.markers.tracking import track_markers
from taccel_lab.errors import InputError
from taccel_lab.files.images import read_image
from taccel_lab.geometry import PixelGrid, quadratic_mesh
from taccel_lab.geometry.block import block_mesh
from taccel_lab.profile import MarkersBlock
from taccel_lab.reading.dots.marker_picture import find_markers
from taccel_lab.scene import Element, Material, Scene, SoftBody
from taccel_lab.signals import MarkerLayout, SignalTactile
from taccel_lab.signals.dots import DotPainter, PaintedDots
from taccel_lab.solvers import SolverIPC
from tests.signals.pressed_surface import extrude, flat_pad
from tests.signals.tactile_cases import on_device
from tests.support.dotted_profiles import with_painted_dots
from tests.support.real_data import real_data
from tests.support.sample_blocks import ASSUMED, bare_profile

GRID = PixelGrid(96, 72, 0.05, 0.04, 40.0, 30.0)
MESH = flat_pad(0.4, (3.0, 2.4), seed=3)
POINTS_MM = np.random.default_rng(0).uniform(-1.9, 1.9, (25, 2))


def markers_px(mesh, positions: np.ndarray, points_mm: np.ndarray = POINTS_MM) -> np.ndarray:
    layout = MarkerLayout.from_points(mesh, points_mm)
    signal = SignalTactile(mesh, GRID, env_count=len(positions), markers=layout)
    signal.update(on_device(positions))
    return signal.markers_px.numpy()


@settings(max_examples=20)
@given(st.lists(st.floats(-0.5, 0.5), min_size=6, max_size=6), st.integers(0, 100), st.booleans())
def test_markers_follow_linear_deformations_exactly(entries, seed, quadratic):
    mesh = quadratic_mesh(MESH) if quadratic else MESH
    turn, shift = np.eye(2) + np.array(entries[:4]).reshape(2, 2), np.array(entries[4:])
    points = np.random.default_rng(seed).uniform(-1.9, 1.9, (5, 2))
    positions = mesh.nodes_m[None].repeat(2, axis=0)
    positions[1, :, :2] = positions[1, :, :2] @ turn.T + shift * 1e-3
    found = markers_px(mesh, positions, points)
    assert np.abs(found[0] - GRID.pixel_from_gel(points)).max() < 1e-5
    assert np.abs(found[1] - GRID.pixel_from_gel(points @ turn.T + shift)).max() < 1e-4


def test_a_marker_moves_with_its_face_only():
    layout = MarkerLayout.from_points(MESH, POINTS_MM)
    positions, node = MESH.nodes_m[None].copy(), layout.nodes[4, 1]
    positions[0, node, 0] += 1e-3
    moved = markers_px(MESH, positions)[0] - markers_px(MESH, MESH.nodes_m[None])[0]
    share = np.where(layout.nodes == node, layout.weights, 0.0).sum(axis=1)
    assert share[4] > 0.01 and (share == 0).any()
    assert np.abs(moved - share[:, None] * [1 / GRID.mm_per_px_x, 0.0]).max() < 1e-4


def test_of_two_layers_the_lower_carries_the_marker():
    xy = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * 3e-3
    mesh = extrude(np.concatenate([xy, xy]), np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]))
    nodes = mesh.nodes_m.copy()
    nodes[:4, 2] += 5e-4
    upper = type(mesh)(nodes, mesh.tets, mesh.faces, mesh.face_regions)
    assert (MarkerLayout.from_points(upper, np.array([[0.5, 0.2]])).nodes >= 4).all()


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda:0", marks=pytest.mark.gpu)])
def test_gels_of_other_shapes_have_their_markers_in_the_same_places(device):
    """The same cells, graded otherwise in the second and third environments. On a GPU squares about
    neighbouring dots, which overlap, are painted at the same time."""
    if device != "cpu" and not wp.is_cuda_available():
        pytest.skip("no CUDA device")
    graded = MESH.nodes_m.copy()
    half = np.abs(graded[:, :2]).max(axis=0)
    graded[:, :2] += [0.1, -0.08] * half * np.sin(np.pi * graded[:, :2] / half)
    rests = np.stack([MESH.nodes_m, graded, graded])
    markers = MarkersBlock(
        rows=4, columns=5, pitch_x_mm=0.8, pitch_y_mm=0.7, radius_mm=0.15, provenance=ASSUMED
    )
    points = markers.grid().points_mm()
    bare = bare_profile(MESH, GRID, "dotted")
    profile = with_painted_dots(bare, GRID.pixel_from_gel(points), 3.0).with_block(markers)
    for element in (Element.LINEAR, Element.QUADRATIC):
        soft = SoftBody(MESH, Material(1e5, 0.45), rest_positions_m=rests, element=element)
        model = Scene(soft_bodies=[soft], env_count=3).finalize(device=device)
        signal = SignalTactile.from_profile(profile, solver=SolverIPC(model))
        positions = model.rest_positions.numpy()

        def shown(positions, signal=signal):
            signal.update(on_device(positions, device))
            return (array.numpy() for array in signal.read("markers_px", "rgb_levels"))

        found, image = shown(positions)
        assert np.abs(found - GRID.pixel_from_gel(points)).max() < 1e-4
        assert np.abs(image - profile.background_rgb).max() < 0.6
        # Any motion of the gel that keeps it plane moves them alike, whatever its cells are.
        turn = np.array([[1.03, 0.05], [-0.02, 0.96]])
        positions[..., :2] = positions[..., :2] @ turn.T
        found, image = shown(positions)
        assert np.abs(found - GRID.pixel_from_gel(points @ turn.T)).max() < 1e-4
        assert np.abs(image[1:] - image[0]).max() < 1e-2


VIEW = PixelGrid(120, 90, 0.1, 0.1)
DOTTED = block_mesh((12, 9, 2), (14e-3, 11e-3, 3e-3), jitter=0.2, seed=2)
RADIUS_PX = 3.0
PLACES_MM = np.stack(np.meshgrid([-3.5, -1.2, 1.1, 3.4], [-2.4, 0.1, 2.5]), axis=-1).reshape(-1, 2)
PLACES = VIEW.pixel_from_gel(PLACES_MM)
LAYOUT = MarkerLayout.from_points(DOTTED, PLACES_MM)


def drawn(places_px: np.ndarray, stretch: tuple[float, float] = (1.0, 1.0)) -> np.ndarray:
    """Uneven light with soft dark dots, one pixel from dark to bright."""
    v, u = np.mgrid[: VIEW.height_px, : VIEW.width_px]
    light = np.stack([150 + 0.3 * u, 120 + 0.4 * v, 140 + 0.2 * u - 0.1 * v], axis=-1)
    for place in places_px:
        distance = np.hypot((u - place[0]) / stretch[0], (v - place[1]) / stretch[1])
        light = light * (1 - 0.7 * np.clip(RADIUS_PX - distance + 0.5, 0, 1))[..., None]
    return light


def moved_dots(positions_m: np.ndarray) -> np.ndarray:
    """An image of the dots, of the gel's nodes where they are."""
    dots = PaintedDots.cut_out(drawn(PLACES), PLACES, RADIUS_PX)
    return DotPainter(dots, LAYOUT, DOTTED, VIEW).painted(dots.clean_rgb, positions_m)


@pytest.mark.parametrize("move_px", [(0.0, 0.0), (3.0, -2.0), (0.4, 1.7), (-5.5, 5.5), (40.0, 0.0)])
def test_dots_go_with_the_gel(move_px):
    """The last motion takes some of them out of the image."""
    found = moved_dots(DOTTED.nodes_m + 1e-3 * np.array([*move_px, 0.0]) * VIEW.mm_per_px_x)
    expected = drawn(PLACES + move_px)
    if not any(move_px):
        np.testing.assert_allclose(found, expected, atol=1e-3)
        return
    # Edges one pixel wide are interpolated: the mean is over the whole image, a tenth of it dots.
    error, still = (np.abs(image - expected).mean() for image in (found, drawn(PLACES)))
    assert error < (0.3 if move_px[0] == 40.0 else 0.6) and error < 0.2 * still


def test_dots_stretch_as_their_face_does():
    stretch = (1.3, 0.8)
    found = moved_dots(DOTTED.nodes_m * [*stretch, 1.0])
    places = VIEW.pixel_from_gel(PLACES_MM * stretch)
    expected = drawn(places, stretch)
    assert np.abs(found - expected).mean() < 0.6
    assert np.abs(drawn(places) - expected).mean() > 2 * np.abs(found - expected).mean()


def test_markers_and_dots_that_fit_no_gel_are_refused():
    rests = np.stack([MESH.nodes_m, MESH.nodes_m * [1.01, 1.0, 1.0]])
    layout = MarkerLayout.from_points(MESH, POINTS_MM, rests)
    signal = SignalTactile(MESH, GRID, env_count=3, markers=layout)
    signal.update(on_device(MESH.nodes_m[None].repeat(3, 0)))
    dots = PaintedDots.cut_out(drawn(PLACES), PLACES[:3], RADIUS_PX)
    for call, given_, message in (
        (MarkerLayout.from_points, (MESH, [[0.0, 0.0], [9.0, 0.0]]), r"marker 1 .* beside"),
        (MarkerLayout.from_points, (MESH, [0.0, 0.0]), "xy_mm"),
        (MarkerLayout.from_points, (MESH, [[np.nan, 0.0]]), "xy_mm"),
        (signal.read, ("markers_px",), "markers of 2 gels, but there are 3"),
        (PaintedDots.cut_out, (drawn(PLACES), PLACES, 0.0), "radius_px of dots must be above 0"),
        (DotPainter, (dots, LAYOUT, DOTTED, VIEW), "3 dots for 12 markers"),
    ):
        with pytest.raises(InputError, match=message):
            call(*(np.array(each) if isinstance(each, list) else each for each in given_))


@pytest.mark.thorough
def test_a_real_gel_that_was_sheared():
    """A finger shears a GelSight Mini. Dots of its resting image go where tracking sees them later,
    and hide where they were; judged on pixels of either place, in the light of those between."""
    frames = [read_image(real_data(f"gsmini_markers_video/{n:04d}.png")) for n in (0, 64, 68, 72)]
    found = find_markers(frames[0])
    tracks = track_markers(frames, found)
    height, width = frames[0].shape[:2]
    grid, rest = PixelGrid(width, height, 0.1, 0.1), tracks.rest_px
    mesh = block_mesh((36, 28, 1), (0.11e-3 * width, 0.12e-3 * height, 2e-3))
    gel_mm = 0.1 * (rest - [grid.center_u_px, grid.center_v_px])
    dots = PaintedDots.cut_out(frames[0], rest, float(np.median(found.dots.radius_px)))
    painter = DotPainter(dots, MarkerLayout.from_points(mesh, gel_mm), mesh, grid)
    for k, frame in enumerate(frames[1:], start=1):
        seen = tracks.seen[k]
        move = RBFInterpolator(gel_mm[seen], 0.1 * (tracks.uv_px[k] - rest)[seen], neighbors=12)
        nodes = mesh.nodes_m.copy()
        nodes[:, :2] += 1e-3 * move(1e3 * nodes[:, :2])
        image = painter.painted(dots.clean_rgb, nodes)
        white = np.full_like(image, 255.0)
        now, then = (painter.painted(white, at) < 250 for at in (nodes, mesh.nodes_m))
        judged = (now | then).any(axis=-1)
        # Of the finger's own light: what is neither a dot now nor was one, nearby.
        known = (~judged).astype(float)
        light = [
            gaussian_filter((frame[..., c] - dots.clean_rgb[..., c]) * known, 6.0) for c in range(3)
        ]
        change = np.stack(light, axis=-1) / gaussian_filter(known, 6.0)[..., None]
        error, still = (np.abs(base + change - frame)[judged].mean() for base in (image, frames[0]))
        assert error < 0.3 * still


def test_dots_are_as_high_as_on_the_designed_gel():
    mesh = block_mesh((4, 4, 1), (8e-3, 8e-3, 2e-3))
    designed = dataclasses.replace(mesh, nodes_m=mesh.nodes_m + [0, 0, 2e-4])
    xy_mm = np.array([[0.3, 0.1], [1.2, -2.0]])
    layout, there = MarkerLayout.where_on(mesh, xy_mm)
    assert len(there) == 2
    lifts_m = layout.over(designed, xy_mm, mesh).lifts_m
    np.testing.assert_allclose(lifts_m, 2e-4, rtol=1e-9)
