# SPDX-License-Identifier: Apache-2.0
"""From pixels to the gel: through a grid, through a refracting camera."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from taccel_lab.calibration.capture import CaptureFolder
from taccel_lab.calibration.dots.lattice import lattice_index
from taccel_lab.calibration.dots.layout import fit_layout
from taccel_lab.calibration.dots.marker_picture import find_markers
from taccel_lab.calibration.markers.choose_view import choose_view
from taccel_lab.calibration.markers.fit import layout_on_gel
from taccel_lab.calibration.markers.flow import marker_flow_mm
from taccel_lab.calibration.markers.gel_view import (
    CameraView,
    GridView,
    camera_view,
    pixel_jacobian,
)
from taccel_lab.calibration.markers.tracks import MarkerTracks
from taccel_lab.camera.camera_model import CameraModel
from taccel_lab.camera.media import media_between
from taccel_lab.geometry import PixelGrid
from taccel_lab.optics import Camera, Coating, Light, MarkerGrid, OpticalDesign, Window
from taccel_lab.optics.render import OpticalModel
from taccel_lab.profile import Provenance
from taccel_lab.sensors.profile import catalogue_profile
from tests.calibration.drawn.dot_grids import grid_points

GRID_VIEW = GridView(PixelGrid(320, 240, 0.06, 0.05), "a test")


def tracks_of(uv: np.ndarray, sigma: float = 0.02) -> MarkerTracks:
    frames, count = uv.shape[:2]
    return MarkerTracks(
        uv_px=uv,
        sigma_px=np.full(uv.shape, sigma),
        status=np.full((frames, count), 2, dtype=np.uint8),
        rest_px=uv[0],
        rest_sigma_px=np.full((count, 2), sigma),
        row=np.arange(count),
        column=np.zeros(count, dtype=int),
        size_px=(320, 240),
    )


def test_flow_through_a_grid_is_pixels_times_scale() -> None:
    rest = np.array([[100.0, 80.0], [200.0, 150.0], [40.0, 60.0]])
    uv = np.stack([rest, rest + (10.0, -4.0)])
    flow = marker_flow_mm(tracks_of(uv), GRID_VIEW, fps=25.0)
    np.testing.assert_allclose(flow.displacement_mm[1], [[0.6, -0.2]] * 3, atol=1e-12)
    np.testing.assert_allclose(flow.points_mm, GRID_VIEW.grid.gel_from_pixel(rest))
    np.testing.assert_allclose(flow.sigma_mm[1, 0], np.sqrt(2) * 0.02 * np.array([0.06, 0.05]))
    assert flow.time_s is not None
    np.testing.assert_allclose(flow.time_s, [0.0, 0.04])


def design(camera: Camera) -> OpticalDesign:
    light = Light((3.0, -2.0, -25.0), (0.0, 0.0, 1.0), (1.0, 1.0, 1.0))
    return OpticalDesign(
        camera, (light,), Coating((0.6, 0.6, 0.6)), Window(2.0, (40.0, 40.0), 1.49)
    )


def looking_at(
    position_mm: tuple[float, float, float], target_mm: tuple[float, float, float]
) -> tuple[float, float, float, float]:
    """gel_from_camera of a camera whose columns run along the gel's x as nearly as can be."""
    z = np.subtract(target_mm, position_mm)
    x = np.array([1.0, 0.0, 0.0]) - z[0] * z / (z @ z)
    axes = np.stack([x, np.cross(z, x), z])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    q = Rotation.from_matrix(axes.T).as_quat(canonical=True)
    return float(q[0]), float(q[1]), float(q[2]), float(q[3])


@pytest.mark.parametrize(
    ("turn_deg", "stagger", "missing"),
    [(0.0, 0.0, ()), (7.0, 0.0, ((1, 2), (4, 5))), (-5.0, 0.5, ((2, 3),))],
)
def test_a_rendered_grid_comes_back_through_the_camera(
    turn_deg: float, stagger: float, missing: tuple[tuple[int, int], ...]
) -> None:
    """Our own renderer: perspective from aside, lens distortion, refraction by window and gel."""
    position = (1.5, -1.0, -24.0)
    camera = Camera(
        320, 240, 400.0, 404.0, 161.0, 118.0, position, looking_at(position, (0.0, 0.2, 0.0)),
        distortion=(-0.12, 0.03, 0.001, -0.001),
    )  # fmt: skip
    truth = MarkerGrid(
        6, 7, 2.0, 2.0 * (np.sqrt(0.75) if stagger else 0.95), 0.35, (0.3, -0.2),
        turn_deg, stagger, missing,
    )  # fmt: skip
    optics = design(camera)
    model = OpticalModel.from_formula(
        optics, lambda xy: np.zeros(xy.shape[:-1]), half_size_mm=(14.0, 14.0), back_z_mm=-4.0,
        step_mm=0.5, markers=truth,
    )  # fmt: skip
    image = np.nan_to_num(model.render().linear)
    picture = find_markers(255.0 * image / image.max())
    back = np.array([[x, y, -4.0] for x in (-14, 14) for y in (-14, 14)], dtype=float)
    view = CameraView(
        CameraModel(camera), media_between(optics, back), lambda xy: np.zeros(len(xy)), "a test"
    )
    layout = layout_on_gel(picture, view)
    assert (layout.rows, layout.columns) == (truth.rows, truth.columns)
    np.testing.assert_allclose(layout.pitch, (truth.pitch_x_mm, truth.pitch_y_mm), rtol=1e-3)
    np.testing.assert_allclose(layout.centre, truth.offset_mm, atol=0.01)
    assert layout.rotation_deg == pytest.approx(turn_deg, abs=0.05)
    assert set(layout.missing) == set(missing)
    assert layout.residual_rms < 0.005
    # The same dots by a plain scale are bent by lens, tilt and refraction.
    plain = layout_on_gel(picture, GridView(PixelGrid(320, 240, 0.055, 0.055), "a test"))
    assert plain.residual_rms > 5 * layout.residual_rms
    assert picture.layout_px is not None


def test_a_camera_view_undoes_projection_on_a_dome() -> None:
    camera = Camera(320, 240, 400.0, 400.0, 159.5, 119.5, (0.0, 0.0, -24.0))
    back = np.array([[x, y, -4.0] for x in (-14, 14) for y in (-14, 14)], dtype=float)
    media = media_between(design(camera), back)

    def dome(xy: np.ndarray) -> np.ndarray:
        return np.sqrt(40.0**2 - (xy**2).sum(axis=1)) - 40.0

    view = CameraView(CameraModel(camera), media, dome, "a test")
    xy = np.random.default_rng(2).uniform(-4, 4, (30, 2))
    points = np.column_stack([xy, dome(xy)])
    sight = media.sight(np.array(camera.position_mm), points)
    uv = view.model.pixels_from_directions(sight @ view.model.gel_from_camera)
    np.testing.assert_allclose(view.gel_from_pixel(uv), xy, atol=1e-6)
    jacobian = pixel_jacobian(view, uv)
    assert (np.linalg.det(jacobian) > 0).all()


def calibrated(kind: str, spread: dict[str, float]) -> Provenance:
    evidence = {"x": (0.0, 1.0)}
    return Provenance(
        kind=kind,  # type: ignore[arg-type]
        method="a test",
        source="none",
        inputs={"a": "0" * 64},
        residuals={"r": 0.0},
        valid_region=evidence,
        spread=spread,
    )


@pytest.mark.parametrize("bent", [True, False])
def test_a_calibrated_pose_is_looked_through_as_it_was_fitted(bent: bool) -> None:
    """Whether its sight lines are bent shows in the pixel grid that was calibrated with it."""
    profile = catalogue_profile("gelsight_mini")
    assert profile.optics is not None
    grid = profile.camera
    size = (grid.width_px, grid.height_px)
    view = camera_view(profile, size, refraction=bent)
    middle = np.array([(size[0] - 1) / 2, (size[1] - 1) / 2])
    scale = np.diag(pixel_jacobian(view, middle))
    other = np.diag(pixel_jacobian(camera_view(profile, size, refraction=not bent), middle))
    assert np.abs(scale / other - 1).min() > 0.1
    posed = profile.optics.replace(
        provenance=calibrated("calibrated", {"position_z_mm": 0.1, "fx_px": 1.0})
    )
    scaled = grid.replace(
        mm_per_px_x=float(scale[0]),
        mm_per_px_y=float(scale[1]),
        provenance=calibrated("calibrated", {"mm_per_px_x": 1e-4}),
    )
    lattice = lattice_index(grid_points())
    layout = fit_layout(grid_points(), lattice)
    folder = CaptureFolder("a test", Path(), "gelsight_mini", None, None, (), None, None, None, ())
    chosen = choose_view(folder, profile.with_block(posed).with_block(scaled), layout, size).view
    assert isinstance(chosen, CameraView)
    np.testing.assert_allclose(np.diag(pixel_jacobian(chosen, middle)), scale, rtol=1e-9)
    # A lens without a pose says nothing of millimetres; the calibrated grid does.
    lens = profile.optics.replace(provenance=calibrated("calibrated", {"fx_px": 1.0}))
    chosen = choose_view(folder, profile.with_block(lens).with_block(scaled), layout, size).view
    assert isinstance(chosen, GridView)
    # And where nothing was measured, that is said.
    assumed = choose_view(folder, profile, layout, size)
    assert [remark.code for remark in assumed.remarks] == ["scale_not_measured"]
