# SPDX-License-Identifier: Apache-2.0
"""Dots of a colour model's images lie where the gel has taken them."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from scipy.interpolate import RBFInterpolator
from scipy.ndimage import gaussian_filter

from taccel_lab.calibration.dots.marker_picture import find_markers
from taccel_lab.calibration.markers.tracking import track_markers
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.geometry.block import block_mesh
from taccel_lab.reading.images import read_image
from taccel_lab.signals.dots import DotPainter, PaintedDots
from taccel_lab.signals.markers import MarkerLayout
from tests.support.real_data import real_data

GRID = PixelGrid(120, 90, 0.1, 0.1)
MESH = block_mesh((12, 9, 2), (14e-3, 11e-3, 3e-3), jitter=0.2, seed=2)
RADIUS_PX = 3.0
PLACES_MM = np.stack(np.meshgrid([-3.5, -1.2, 1.1, 3.4], [-2.4, 0.1, 2.5]), axis=-1).reshape(-1, 2)


def drawn(places_px: np.ndarray, stretch: tuple[float, float] = (1.0, 1.0)) -> np.ndarray:
    """Uneven light with soft dark dots, one pixel from dark to bright."""
    v, u = np.mgrid[: GRID.height_px, : GRID.width_px]
    light = np.stack([150 + 0.3 * u, 120 + 0.4 * v, 140 + 0.2 * u - 0.1 * v], axis=-1)
    for place in places_px:
        distance = np.hypot((u - place[0]) / stretch[0], (v - place[1]) / stretch[1])
        light = light * (1 - 0.7 * np.clip(RADIUS_PX - distance + 0.5, 0, 1))[..., None]
    return light


def moved_dots(positions_m: np.ndarray) -> np.ndarray:
    """An image of the dots, of the gel's nodes where they are."""
    background = drawn(GRID.pixel_from_gel(PLACES_MM))
    dots = PaintedDots.cut_out(background, GRID.pixel_from_gel(PLACES_MM), RADIUS_PX)
    layout = MarkerLayout.from_points(MESH, PLACES_MM)
    return DotPainter(dots, layout, MESH, GRID).painted(dots.clean_rgb, positions_m)


def normalized_blur(values: np.ndarray, known: np.ndarray, sigma_px: float = 6.0) -> np.ndarray:
    """Mean of the known values nearby."""
    return gaussian_filter(values * known, sigma_px) / gaussian_filter(1.0 * known, sigma_px)


def test_an_untouched_gel_shows_the_background() -> None:
    expected = drawn(GRID.pixel_from_gel(PLACES_MM))
    np.testing.assert_allclose(moved_dots(MESH.nodes_m), expected, atol=1e-3)


@pytest.mark.parametrize("move_px", [(3.0, -2.0), (0.4, 1.7), (-5.5, 5.5)])
def test_dots_go_with_the_gel(move_px: tuple[float, float]) -> None:
    move_m = 1e-3 * np.array([*move_px, 0.0]) * GRID.mm_per_px_x
    found = moved_dots(MESH.nodes_m + move_m)
    expected = drawn(GRID.pixel_from_gel(PLACES_MM) + move_px)
    # Edges one pixel wide are interpolated: the mean is over the whole image, a tenth of it dots.
    error, still = (
        np.abs(image - expected).mean() for image in (found, drawn(GRID.pixel_from_gel(PLACES_MM)))
    )
    assert error < 0.6 and error < 0.2 * still


def test_dots_stretch_as_their_face_does() -> None:
    stretch = (1.3, 0.8)
    found = moved_dots(MESH.nodes_m * [*stretch, 1.0])
    places = GRID.pixel_from_gel(PLACES_MM * stretch)
    expected = drawn(places, stretch)
    assert np.abs(found - expected).mean() < 0.6
    assert np.abs(drawn(places) - expected).mean() > 2 * np.abs(found - expected).mean()


def test_a_dot_that_leaves_the_image_is_not_seen_and_others_stay() -> None:
    away = moved_dots(MESH.nodes_m + [4e-3, 0.0, 0.0])
    expected = drawn(GRID.pixel_from_gel(PLACES_MM) + [40.0, 0.0])
    assert np.abs(away - expected).mean() < 0.3


def test_bytes_are_levels_rounded() -> None:
    places = GRID.pixel_from_gel(PLACES_MM)
    dots = PaintedDots.cut_out(drawn(places), places, RADIUS_PX)
    painter = DotPainter(dots, MarkerLayout.from_points(MESH, PLACES_MM), MESH, GRID)
    levels = wp.array(np.stack([dots.clean_rgb] * 2), dtype=wp.float32, device="cpu")
    rounded = np.rint(dots.clean_rgb).astype(np.uint8)
    image = wp.array(np.stack([rounded] * 2), dtype=wp.uint8, device="cpu")
    positions = np.stack([MESH.nodes_m, MESH.nodes_m + [2.5e-4, 0.0, 0.0]])
    none = wp.empty(0, dtype=wp.transformd), wp.empty(0, dtype=wp.int32)
    painter.paint(wp.array(positions, dtype=wp.vec3d), *none, image=image, levels=levels)
    assert np.abs(image.numpy().astype(float) - levels.numpy()).max() <= 1.0
    assert np.abs(np.diff(levels.numpy(), axis=0)).max() > 20.0


def test_faults_are_told() -> None:
    places = GRID.pixel_from_gel(PLACES_MM)
    with pytest.raises(InputError, match="radius_px of dots must be above 0"):
        PaintedDots.cut_out(drawn(places), places, 0.0)
    dots = PaintedDots.cut_out(drawn(places), places[:3], RADIUS_PX)
    with pytest.raises(InputError, match="3 dots for 12 markers"):
        DotPainter(dots, MarkerLayout.from_points(MESH, PLACES_MM), MESH, GRID)


def test_a_real_gel_that_was_sheared() -> None:
    """A finger shears a GelSight Mini. Dots of its resting image go where tracking sees them later,
    and hide where they were; judged on pixels of either place, in the light of those between."""
    frames = [read_image(real_data(f"gsmini_markers_video/{n:04d}.png")) for n in (0, 64, 68, 72)]
    found = find_markers(frames[0]).dots
    tracks = track_markers(frames, find_markers(frames[0]))
    height, width = frames[0].shape[:2]
    grid = PixelGrid(width, height, 0.1, 0.1)
    mesh = block_mesh((36, 28, 1), (0.11e-3 * width, 0.12e-3 * height, 2e-3))
    rest = tracks.rest_px
    gel_mm = 0.1 * (rest - [grid.center_u_px, grid.center_v_px])
    dots = PaintedDots.cut_out(frames[0], rest, float(np.median(found.radius_px)))
    painter = DotPainter(dots, MarkerLayout.from_points(mesh, gel_mm), mesh, grid)
    for k, frame in enumerate(frames[1:], start=1):
        seen = tracks.seen[k]
        move = RBFInterpolator(gel_mm[seen], 0.1 * (tracks.uv_px[k] - rest)[seen], neighbors=12)
        nodes = mesh.nodes_m.copy()
        nodes[:, :2] += 1e-3 * move(1e3 * nodes[:, :2])
        image = painter.painted(dots.clean_rgb, nodes)
        now = painter.painted(np.full_like(image, 255.0), nodes) < 250
        then = painter.painted(np.full_like(image, 255.0), mesh.nodes_m) < 250
        judged = (now | then).any(axis=-1)
        # Of the finger's own light: what is neither a dot now nor was one, nearby.
        change = np.stack(
            [normalized_blur(frame[..., c] - dots.clean_rgb[..., c], ~judged) for c in range(3)],
            axis=-1,
        )
        error = np.abs(image + change - frame)[judged].mean()
        still = np.abs(frames[0] + change - frame)[judged].mean()
        assert error < 0.3 * still
