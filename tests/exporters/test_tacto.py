# SPDX-License-Identifier: Apache-2.0
"""The TACTO file through the formulas of its renderer, and against a shipped configuration."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial.transform import Rotation

from taccel_lab.exporters.export import export_profile
from taccel_lab.exporters.frames import LINK_FROM_GEL, effective_camera
from taccel_lab.exporters.tacto import MOST_LIGHTS, merged_lights
from taccel_lab.geometry import Region
from taccel_lab.profile import SensorProfile
from taccel_lab.profile.optical_design import Light
from taccel_lab.sensors.profile import catalogue_profile
from tests.support.real_data import real_data


def exported(profile: SensorProfile, out: Path) -> dict:
    export_profile(profile, "tacto", out)
    return yaml.safe_load((out / "config.yml").read_text())["sensor"]


def pixels(sensor: dict, points_m: np.ndarray, width: int, height: int) -> np.ndarray:
    """Columns and rows of points by pyrender's camera: -z forward, y up, square pixels."""
    camera = sensor["camera"][0]
    turn = Rotation.from_euler("xyz", np.deg2rad(camera["orientation"])).as_matrix()
    x, y, z = ((points_m - np.array(camera["position"])) @ turn).T
    focal = height / (2 * math.tan(math.radians(camera["yfov"]) / 2))
    return np.stack([(width - 1) / 2 - focal * x / z, (height - 1) / 2 + focal * y / z], axis=-1)


@pytest.mark.parametrize("name", ["mini", "digit"])
def test_gel_points_fall_on_their_pixels(
    name: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    profile = request.getfixturevalue(name)
    sensor = exported(profile, tmp_path / "out")
    grid = profile.grid()
    uv = np.array([[10.0, 20.0], [grid.width_px - 30.0, 40.0], [60.0, grid.height_px - 25.0]])
    gel_mm = np.concatenate([grid.gel_from_pixel(uv), np.zeros((3, 1))], axis=1)
    found = pixels(sensor, gel_mm * 1e-3 @ LINK_FROM_GEL.T, grid.width_px, grid.height_px)
    np.testing.assert_allclose(found, uv, atol=1e-6)


def test_frames_units_and_the_null_key(mini: SensorProfile, tmp_path: Path) -> None:
    sensor = exported(mini, tmp_path / "out")
    camera = sensor["camera"][0]
    assert camera["cam0"] is None
    # As in TACTO's own files: the camera looks along +x.
    assert camera["orientation"] == pytest.approx([90, 0, -90])
    assert camera["position"][0] == pytest.approx(-0.0197, abs=1e-4)
    gel = sensor["gel"]
    assert gel["width"] == pytest.approx(0.02525, rel=0.01)
    assert gel["height"] == pytest.approx(0.02075, rel=0.01)
    # The lights: red above (-y of the gel is +z), green right (+x is -y), blue below.
    coords = np.array(sensor["lights"]["xyz"]["coords"])
    np.testing.assert_allclose(
        coords, [[-0.012, 0, 0.011], [-0.012, -0.013, 0], [-0.012, 0, -0.011]], atol=1e-9
    )
    assert sensor["lights"]["colors"] == [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
    assert sensor["lights"]["polar"] is False and sensor["lights"]["intensities"] == [1, 1, 1]


def test_the_keys_are_those_of_a_shipped_file(mini: SensorProfile, tmp_path: Path) -> None:
    shipped = real_data("sensor_geometry/configs/config_digit.yml")
    theirs = yaml.safe_load(shipped.read_text())["sensor"]
    ours = exported(mini, tmp_path / "out")

    def keys(value: object, path: str = "") -> set[str]:
        if isinstance(value, dict):
            return {path} | set().union(*(keys(v, f"{path}.{k}") for k, v in value.items()))
        if isinstance(value, list) and value and isinstance(value[0], dict):
            return keys(value[0], path + "[]")
        return {path}

    assert keys(ours) == keys(theirs)


@pytest.mark.parametrize(("name", "most_mm"), [("mini", 0.1), ("digit", 0.6)])
def test_the_curved_gel_is_near_the_mesh(
    name: str, most_mm: float, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    """As Renderer._generate_gel_trimesh bends it."""
    profile = request.getfixturevalue(name)
    stated = export_profile(profile, "tacto", tmp_path / "out")["approximations"]
    gel = yaml.safe_load((tmp_path / "out" / "config.yml").read_text())["sensor"]["gel"]
    assert gel["curvature"] is True
    x0, y0, z0 = gel["origin"]
    y = np.linspace(y0 - gel["width"] / 2, y0 + gel["width"] / 2, 101)
    z = np.linspace(z0 - gel["height"] / 2, z0 + gel["height"] / 2, 101)
    yy, zz = np.meshgrid(y, z)
    root = np.maximum(0, gel["R"] ** 2 - (yy - y0) ** 2 - (zz - z0) ** 2) ** 0.5
    h = gel["R"] - root
    xx = x0 - gel["curvatureMax"] * h / h.max()
    nodes = profile.mesh.nodes_m[profile.mesh.region_nodes(Region.CONTACT)] @ LINK_FROM_GEL.T
    grid = profile.grid()
    uv = grid.pixel_from_gel(-nodes[:, 1:] * 1e3)
    seen = ((uv > 0) & (uv < [grid.width_px - 1, grid.height_px - 1])).all(axis=1)
    surface = RegularGridInterpolator((z, y), xx)(nodes[seen][:, [2, 1]])
    off_mm = np.abs(surface - nodes[seen, 0]).max() * 1e3
    # A gel that is bent more along one axis than the other is no piece of a sphere; the export
    # says by how much.
    assert off_mm == pytest.approx(stated["gel_surface_max_mm"], abs=0.02)
    assert off_mm < most_mm


def test_a_dome_is_a_piece_of_a_sphere(tmp_path: Path) -> None:
    document = export_profile(catalogue_profile("rtac"), "tacto", tmp_path / "out")
    gel = yaml.safe_load((tmp_path / "out" / "config.yml").read_text())["sensor"]["gel"]
    assert gel["R"] == pytest.approx(0.015, rel=1e-3)
    assert document["approximations"]["gel_surface_max_mm"] < 0.01


LIGHT = st.builds(
    lambda position, rgb: Light(position, (0.0, 0.0, 1.0), rgb),
    st.tuples(*[st.floats(-20, 20)] * 3),
    st.tuples(*[st.floats(0.1, 3)] * 3),
)


@settings(max_examples=50)
@given(st.lists(LIGHT, min_size=1, max_size=14))
def test_joined_lights_keep_their_power(lights: list[Light]) -> None:
    joined, moved_mm = merged_lights(lights)
    assert len(joined) == min(len(lights), MOST_LIGHTS)
    for part in (lambda x: x.rgb, lambda x: sum(x.rgb) * np.array(x.position_mm)):
        total, kept = (np.sum([part(x) for x in some], axis=0) for some in (lights, joined))
        np.testing.assert_allclose(kept, total, rtol=1e-9, atol=1e-9)
    assert moved_mm == 0 if len(lights) <= MOST_LIGHTS else moved_mm >= 0


def test_the_angle_of_view_is_that_of_the_rows(mini: SensorProfile) -> None:
    """Of pixels that are not square, across the image as along it."""
    camera = mini.camera.replace(mm_per_px_y=1.2 * mini.camera.mm_per_px_x)
    found = effective_camera(mini.with_block(camera))
    assert found is not None
    distance_mm = 1e3 * found.distance_m
    assert (found.fx_px, found.fy_px) == pytest.approx(
        (distance_mm / camera.mm_per_px_x, distance_mm / camera.mm_per_px_y)
    )
    half_mm = 240 * camera.mm_per_px_y / 2
    assert np.tan(found.fov_y_rad / 2) == pytest.approx(half_mm / distance_mm)


def test_lamps_keep_their_share_of_the_light(mini: SensorProfile, tmp_path: Path) -> None:
    """Colour times intensity, as TACTO's renderer has it, is the lamp's light over the brightest
    channel of all."""
    assert mini.lights is not None
    strengths = (0.25, 1.0, 0.6)
    leds = tuple(
        led.replace(rgb=tuple(np.array(led.rgb) * strength + 0.01))
        for led, strength in zip(mini.lights.led, strengths, strict=True)
    )
    lit = mini.with_block(mini.lights.replace(led=leds))
    lights = exported(lit, tmp_path / "out")["lights"]
    shown = np.array(lights["colors"]) * np.array(lights["intensities"])[:, None]
    given = np.array([led.rgb for led in leds])
    np.testing.assert_allclose(shown, given / given.max(), rtol=1e-9)
    assert np.ptp(lights["intensities"]) > 0.5
