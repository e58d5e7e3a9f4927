# SPDX-License-Identifier: Apache-2.0
"""TACTO: places, the bent gel, joined lights, and the keys of a shipped configuration."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator

from taccel_lab.exporters.export import export_profile
from taccel_lab.exporters.tacto import MOST_LIGHTS, merged_lights
from taccel_lab.geometry import Region
from taccel_lab.profile.optical_design import Light
from taccel_lab.sensors.profile import catalogue_profile
from tests.exporters.conftest import Exported
from tests.exporters.consumers import LINK
from tests.support.real_data import real_data


def config(out: Path) -> dict:
    return yaml.safe_load((out / "config.yml").read_text())["sensor"]


def test_the_keys_are_those_of_a_shipped_file(exported: Exported) -> None:
    shipped = real_data("sensor_geometry/configs/config_digit.yml")

    def keys(value: object, path: str = "") -> set[str]:
        if isinstance(value, dict):
            return {path} | set().union(*(keys(v, f"{path}.{k}") for k, v in value.items()))
        if isinstance(value, list) and value and isinstance(value[0], dict):
            return keys(value[0], path + "[]")
        return {path}

    theirs = yaml.safe_load(shipped.read_text())["sensor"]
    assert keys(config(exported("tacto")[0])) == keys(theirs)


@pytest.mark.parametrize(
    ("name", "most_mm"), [("gelsight_mini", 0.1), ("digit", 0.6), ("rtac", 0.02)]
)
def test_the_curved_gel_is_near_the_mesh(name: str, most_mm: float, tmp_path: Path) -> None:
    """As Renderer._generate_gel_trimesh bends it: a piece of a sphere."""
    profile = catalogue_profile(name)
    stated = export_profile(profile, "tacto", tmp_path / "out")["approximations"]
    gel = config(tmp_path / "out")["gel"]
    assert gel["curvature"] is True
    if name == "gelsight_mini":
        assert (gel["width"], gel["height"]) == pytest.approx((0.02525, 0.02075), rel=0.01)
    if name == "rtac":
        assert gel["R"] == pytest.approx(0.015, rel=1e-3)
        assert stated["gel_surface_max_mm"] < 0.01
        return
    (x0, y0, z0), radius = gel["origin"], gel["R"]
    y, z = (
        np.linspace(at - size / 2, at + size / 2, 101)
        for at, size in ((y0, gel["width"]), (z0, gel["height"]))
    )
    across = (y[None] - y0) ** 2 + (z[:, None] - z0) ** 2
    h = radius - np.maximum(0, radius**2 - across) ** 0.5
    xx = x0 - gel["curvatureMax"] * h / h.max()
    nodes = profile.mesh.nodes_m[profile.mesh.region_nodes(Region.CONTACT)] @ LINK.T
    grid = profile.grid()
    uv = grid.pixel_from_gel(-nodes[:, 1:] * 1e3)
    seen = ((uv > 0) & (uv < [grid.width_px - 1, grid.height_px - 1])).all(axis=1)
    surface = RegularGridInterpolator((z, y), xx)(nodes[seen][:, [2, 1]])
    off_mm = np.abs(surface - nodes[seen, 0]).max() * 1e3
    # A gel that is bent more along one axis than the other is no piece of a sphere; the export
    # says by how much.
    assert off_mm == pytest.approx(stated["gel_surface_max_mm"], abs=0.02)
    assert off_mm < most_mm


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
