# SPDX-License-Identifier: Apache-2.0
"""Several cameras behind one gel: what they see by Snell's law, CAD, profiles and presses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from taccel_lab.api.press import press
from taccel_lab.cad.assembly import require_no_overlap
from taccel_lab.camera.gel_camera import GelCamera, camera_of
from taccel_lab.errors import InputError
from taccel_lab.presses.press import Press
from taccel_lab.profile import SensorProfile
from taccel_lab.sensors.camera_sensor import CameraSensorParameters
from taccel_lab.sensors.derived import derived_figures, describe_sensor
from taccel_lab.sensors.profile import catalogue_profile
from taccel_lab.sensors.registry import profile_sensor, sensor_family
from taccel_lab.sensors.workshop import sensor_parts
from taccel_lab.studies.report.preview import preview_design, write_preview
from tests.support.sensor_refusals import refuses

BASELINE_MM = 9.0
PAIR: dict[str, Any] = {"camera_x_mm": [-BASELINE_MM / 2, BASELINE_MM / 2], "marker_pitch_mm": 2.5}
"""Two parallel eyes."""
DISTANCE_MM, GEL_MM, WINDOW_MM, GEL_INDEX, WINDOW_INDEX = 24.0, 4.0, 6.0, 1.41, 1.49
"""Of ``flat_pad``."""
AIR_MM = DISTANCE_MM - GEL_MM - WINDOW_MM
FLAT = sensor_family("flat_pad")


@pytest.fixture(scope="module")
def stereo() -> SensorProfile:
    return catalogue_profile("flat_pad", PAIR)


def eye(profile: SensorProfile, name: str) -> GelCamera:
    camera = camera_of(profile.seen_by(name))
    assert isinstance(camera, GelCamera)
    return camera


def tangent_in_air(aside_mm: float, depth_mm: float) -> float:
    """Slope at which an eye sees a point ``aside_mm`` off its axis and ``depth_mm`` in the gel."""

    def missed_mm(sine: float) -> float:
        slopes = np.tan(np.arcsin(sine / np.array([1.0, WINDOW_INDEX, GEL_INDEX])))
        return float(slopes @ [AIR_MM, WINDOW_MM, GEL_MM - depth_mm] - aside_mm)

    sine = float(brentq(missed_mm, 0.0, 0.99, xtol=1e-14))  # type: ignore[arg-type]
    return float(np.tan(np.arcsin(sine)))


@pytest.mark.parametrize("depth_mm", [0.0, 0.5, 1.5])
def test_disparities_of_heights_follow_snells_law(stereo: SensorProfile, depth_mm: float) -> None:
    left, right = (eye(stereo, name) for name in ("main", "camera_2"))
    seen = [camera.pixel_from_gel(np.array([0.0, 0.0, -depth_mm])) for camera in (left, right)]
    focal = left.camera.fx_px
    expected = 2 * focal * tangent_in_air(BASELINE_MM / 2, depth_mm)
    assert seen[0][0] - seen[1][0] == pytest.approx(expected, abs=1e-6)
    assert seen[0][1] == pytest.approx(seen[1][1], abs=1e-9)
    # Near the axis it is the pinhole's f b / d, of the distance at which the gel is seen.
    apparent = AIR_MM + (GEL_MM - depth_mm) / GEL_INDEX + WINDOW_MM / WINDOW_INDEX
    assert expected == pytest.approx(focal * BASELINE_MM / apparent, rel=0.02)


def test_eyes_that_squint_see_the_middle_in_their_middle() -> None:
    """In air the axis meets the gel at x + d tan(tilt), whatever the other axis does."""
    tilt_x, tilt_y = np.degrees(np.arctan(np.array([5, 2]) / DISTANCE_MM)).tolist()
    common = {"camera_x_mm": [-5, 5], "gel_index": 1.3, "window_index": 1.3}
    straight = FLAT.parameters(common)
    tilts = {"camera_tilt_x_deg": [tilt_x, -tilt_x], "camera_tilt_y_deg": -tilt_y}
    squint = FLAT.parameters({**common, **tilts, "camera_y_mm": 2})
    for side, view in zip((1, -1), [squint, *squint.views().values()], strict=True):
        design = view.optics()
        assert design is not None
        axis = design.camera.gel_from_camera()[:, 2]
        met = np.array(design.camera.position_mm) + DISTANCE_MM / axis[2] * axis
        assert met == pytest.approx([0, 0, 0], abs=1e-9) and np.sign(axis[0]) == side
    # Their pixel grids meet at the gel's origin where those of straight eyes lie apart.
    shift, toed = (
        view.grid().center_u_px - view.views()["camera_2"].grid().center_u_px
        for view in (straight, squint)
    )
    assert abs(toed) < 0.25 * abs(shift)


def test_the_catalogues_stereo_sensor_looks_at_its_middle() -> None:
    parameters = sensor_family("stereo_pad").parameters()
    (other,) = parameters.views().values()
    for view in (parameters, other):
        assert isinstance(view, CameraSensorParameters)
        assert view.axis_meets_mm() == pytest.approx((0, 0), abs=0.02)
    figures = {name: value for name, (value, _) in derived_figures(parameters).items()}
    assert figures["cameras"] == 2
    assert 50 < float(figures["gel in all images"]) < float(figures["gel in the image"])
    # Each camera has its values.
    assert not FLAT.parameters().views()
    three = FLAT.parameters({"camera_x_mm": [0, -5, 5], "camera_y_mm": [4, -3, -3]})
    assert list(three.views()) == ["camera_2", "camera_3"]
    assert three.views()["camera_3"].values()["camera_x_mm"] == 5.0


test_numbers_of_cameras_agree_and_all_of_them_see_the_gel = refuses(
    FLAT.parameters,
    ({"camera_x_mm": [0, 1], "camera_y_mm": [0, 1, 2]}, "camera_x_mm has 2, camera_y_mm has 3"),
    ({"camera_x_mm": [0, 20]}, "camera_x_mm and camera_tilt_x_deg let .* x = 20 mm"),
    ({"camera_x_mm": [0, 31]}, "camera_x_mm = 31 is above its bound"),
    ({"camera_x_mm": [0] * 65}, "camera_x_mm has 65 values; allowed: 1 to 64"),
)


def test_a_profile_keeps_its_cameras_and_is_a_sensor_by_them(stereo: SensorProfile) -> None:
    assert stereo.view_names() == ("main", "camera_2")
    right = stereo.seen_by("camera_2")
    assert right.optics is not None and right.optics.position_mm[0] == BASELINE_MM / 2
    again, alone = (profile_sensor(profile).parameters() for profile in (stereo, right))
    assert list(again.views()) == ["camera_2"] and again.values()["camera_x_mm"] == [-4.5, 4.5]
    assert not alone.views() and alone.grid() == right.grid()


@pytest.mark.thorough
def test_cad_and_figures_have_all_cameras() -> None:
    tilted = {**PAIR, "camera_tilt_x_deg": [10, -10], "camera_x_mm": [-6, 6]}
    parameters = FLAT.parameters(tilted)
    assembly = sensor_parts("flat_pad", parameters)
    names = [part.name for part in assembly.parts if part.name.startswith("camera")]
    assert names == ["camera", "camera_2"]
    require_no_overlap(assembly.clearances())
    places = [assembly.part(name).solid.center().X for name in names]
    assert places[0] == pytest.approx(-places[1]) and places[0] < -6
    found = describe_sensor(parameters)
    assert found["derived"]["cameras"]["value"] == 2
    assert found["views"]["camera_2"]["camera"]["position_mm"][0] == 6.0
    # An image beside the gel is refused in names that can be set.
    with pytest.raises(InputError, match=r"principal_x_px, camera_x_mm .* at x = -60 mm"):
        catalogue_profile("flat_pad", {"principal_x_px": 200, "mm_per_px": 0.3})


@pytest.fixture(scope="module")
def pressed(stereo: SensorProfile) -> Press:
    return press(stereo, "sphere:4", depth_mm=0.3, accuracy="fast", element="linear")


@pytest.mark.thorough
def test_dots_in_both_images_give_their_places(stereo: SensorProfile, pressed: Press) -> None:
    """Sight lines of a dot's two pixels meet where the gel's own nodes have the dot."""
    assert list(pressed.views) == ["camera_2"]
    left, right = (pressed.seen_by(name).markers for name in stereo.view_names())
    assert left is not None and right is not None
    # Dots at the border lie in one of the images only; a number for each, from where it is painted.
    one, other = (np.round(100 * dots.rest_mm[:, :2]) @ [1, 100_000] for dots in (left, right))
    both, here, there = np.intersect1d(one, other, return_indices=True)
    places = left.places_mm[-1][here]
    assert len(both) >= 9 and places[:, 2].min() < -0.1
    a, u = eye(stereo, "main").sight_lines(left.places_px[-1][here])
    b, v = eye(stereo, "camera_2").sight_lines(right.places_px[-1][there])
    for k, place in enumerate(places):
        # Least squares of a + s u = b + t v.
        s, _ = np.linalg.lstsq(np.stack([u[k], -v[k]], axis=1), b[k] - a[k], rcond=None)[0]
        assert a[k] + s * u[k] == pytest.approx(place, abs=1e-5)


@pytest.mark.thorough
def test_cameras_are_saved(pressed: Press, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("taccel_lab.presses.files.PREDICTED_PX", 64)
    main, right = (pressed.seen_by(name) for name in ("main", "camera_2"))
    assert main.image is not None and right.image is not None
    assert main.image.shape == right.image.shape
    assert not np.array_equal(main.image, right.image)
    assert np.nanmin(main.height_m) == pytest.approx(np.nanmin(right.height_m), abs=1e-5)
    pressed.save(tmp_path / "out")
    folder = tmp_path / "out" / "views" / "camera_2"
    written = {path.name for path in folder.iterdir()}
    assert {"signals.npz", "predicted.png", "height_map.png", "markers.csv"} <= written
    with np.load(folder / "signals.npz") as arrays:
        np.testing.assert_array_equal(arrays["height_m"], right.height_m)


@pytest.mark.thorough
def test_a_preview_draws_what_each_camera_sees(tmp_path: Path) -> None:
    preview = preview_design(FLAT, PAIR, presses=(), size_px=64)
    files = write_preview(preview, tmp_path)
    assert files["rest_camera_2"].name == "rest_camera_2.png"
    # The pad is symmetric, its lights are not: mirrored eyes see mirrored dots.
    left, right = preview.rest.points_mm[..., 0], preview.further["rest_camera_2"].points_mm[..., 0]
    np.testing.assert_allclose(left, -right[:, ::-1], atol=1e-3)
