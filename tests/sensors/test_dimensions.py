# SPDX-License-Identifier: Apache-2.0
"""The catalogue's nominal sensors against the figures of their sources, written out here."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from taccel_lab.cad.parts.pad_solid import labelled_solid
from taccel_lab.errors import InputError
from taccel_lab.sensors import FamilyParameters, sensor_families, sensor_family
from taccel_lab.sensors.derived import lens_difference
from taccel_lab.sensors.families.gelsight import FAMILY
from taccel_lab.sensors.parameter_groups.camera import CameraParameters


class Stated(NamedTuple):
    """What a source says about a sensor; lengths in mm."""

    source: str
    plan: tuple[float, float]
    height: float
    """Of the gel's box."""
    apex: float
    """Gel under the apex."""
    volume: float | None
    volume_percent: float
    image: tuple[int, int]
    mm_per_px: float


STATED = {
    "gelsight": Stated(
        "taxim 1.4.1 gelmap.npy and sensorParams.py; plan assumed",
        (24.0, 20.0), 5.0, 5.0, None, 0, (640, 480), 0.0295,
    ),
    "gelsight_mini": Stated(
        "FEATS gelsight_mini.step, measured; gsrobotics README",
        (25.25, 20.75), 4.0, 4.0, 1898.81, 0.1, (320, 240), 0.0634,
    ),
    "gelsight_40": Stated(
        "Taccel single_sensor VTK, measured; VBTSConfig",
        (40.0, 40.0), 5.925, 5.925, 8795.8, 0.01, (400, 400), 0.079375,
    ),
    "gelsight_r15": Stated(
        "TacSL tacsl_gelsight_r15.yaml; thickness assumed",
        (23.977, 32.0), 4.0, 4.0, None, 0, (240, 320), 0.0877,
    ),
    "gelsight_wedge": Stated(
        "EstimateModulus: 35 x 25.5 x 5.5, 11 to 12.5 px/mm",
        (35.0, 25.5), 5.5, 5.5, None, 0, (390, 280), 0.085,
    ),
    "digit": Stated(
        "digit-design gel STEP, measured; CANFNet calibration 17.62 mm / 328.57 px",
        (18.4, 25.0), 4.07, 4.07, 1303.75, 0.1, (240, 320), 0.05363,
    ),
    "digit_360": Stated(
        "digit360 fingertip STEP, measured; 26.0 mm in all, pocket apex about 3.3 mm deep",
        (25.0, 25.0), 26.0, 22.7, 10534.8, 0.01, (640, 640), 0.04,
    ),
    "9dtact": Stated(
        "9DTact mould DXF, measured, 31.1 x 24.1 x 2.8 less four corners of R 1.8; 0.0510, 0.0500",
        (31.1, 24.1), 2.8, 2.8, 31.1 * 24.1 * 2.8 - (4 - np.pi) * 1.8**2 * 2.8, 0.5,
        (460, 345), 0.0505,
    ),
    "rtac": Stated(
        "PP-Tac shell, measured: half of the shell between R 15.0 and R 13.5",
        (30.0, 30.0), 15.0, 1.5, 2 / 3 * np.pi * (15.0**3 - 13.5**3), 0.5, (640, 480), 0.069,
    ),
}  # fmt: skip


def nominal(name: str, **values: object) -> FamilyParameters:
    return sensor_family(name).parameters(values)


@pytest.mark.parametrize("name", STATED)
def test_pad_and_image_have_the_stated_size(name: str) -> None:
    # The others stand for no sensor in particular: their figures are made to measure.
    assert set(STATED) == set(sensor_families()) - {"flat_pad", "stereo_pad"}
    stated, parameters = STATED[name], nominal(name)
    pad, grid = parameters.pad(), parameters.grid()
    size = np.ptp(pad.bounds_mm(), axis=0)
    assert size[:2] == pytest.approx(stated.plan, abs=0.005)
    assert size[2] == pytest.approx(stated.height, abs=0.02)
    assert pad.thickness_mm == pytest.approx(stated.apex, abs=0.05)
    assert pad.top_mm(np.zeros(2)) == pytest.approx(0.0, abs=0.02)
    assert (grid.width_px, grid.height_px) == stated.image
    assert (grid.mm_per_px_x, grid.mm_per_px_y) == pytest.approx(2 * (stated.mm_per_px,), rel=2e-3)
    # The fisheye of the DIGIT 360 has no single scale: its image is made, not taken.
    if name != "digit_360":
        assert isinstance(parameters, CameraParameters)
        assert abs(lens_difference(parameters)) < 0.02
        from_lens = nominal(name, scale_from="focal_px").grid()
        assert from_lens.mm_per_px_x == pytest.approx(grid.mm_per_px_x, rel=0.02)


@pytest.mark.thorough(cases=("digit",))
@pytest.mark.parametrize("name", [n for n, s in STATED.items() if s.volume is not None])
def test_gel_has_the_stated_volume(name: str) -> None:
    stated, pad = STATED[name], nominal(name).pad()
    error = 100 * (pad.volume_mm3() / (stated.volume or 0.0) - 1)
    assert abs(error) < stated.volume_percent
    assert labelled_solid(pad).solid.volume == pytest.approx(pad.volume_mm3(), rel=2e-3)


FROM_WALL_MM = np.array([0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0, 8.0, 10.0])
"""Distances from the wall along the mid axes, with the heights over the flange measured there."""
MINI_ALONG_X_MM = [
    2.75, 2.8837, 3.0053, 3.1158, 3.2161, 3.3067, 3.4931, 3.6276, 3.7138, 3.7543, 3.8015, 3.8832,
    3.9412, 3.9797,
]  # fmt: skip
MINI_ALONG_Y_MM = [
    2.75, 2.8837, 3.0054, 3.1161, 3.2165, 3.3072, 3.4944, 3.6297, 3.7169, 3.7599, 3.8206, 3.9150,
    3.9729, 3.9975,
]  # fmt: skip


def test_mini_crown_and_rim_are_those_of_the_step_file() -> None:
    pad, thick = (nominal("gelsight_mini", thickness_mm=t).pad() for t in (4.0, 6.0))
    for half, way, measured in (
        (25.25 / 2, [1, 0], MINI_ALONG_X_MM),
        (20.75 / 2, [0, 1], MINI_ALONG_Y_MM),
    ):
        xy = (half - FROM_WALL_MM)[:, None] * way
        found = pad.top_mm(xy)
        assert np.abs(4.0 + found - measured).max() < 0.01  # asked for: 0.1
        assert pad.top_mm(-xy) == pytest.approx(found, abs=1e-9)
        # Its thickness leaves crown and rim alone.
        assert thick.top_mm(xy) == pytest.approx(found)
    assert thick.bounds_mm()[0, 2] == -6.0


def test_markers_are_where_the_sources_have_them() -> None:
    markers, grid = nominal("gelsight_mini").markers(), nominal("gelsight_mini").grid()
    assert markers is not None
    assert (markers.rows, markers.columns) == (7, 9)
    corner = grid.pixel_from_gel(markers.points_mm()[0])
    # gelsight_ansys_sim: margins of 24 px, at its 0.0581 mm/px
    assert corner == pytest.approx([159.5 - 4 * 1.97 / 0.0634, 119.5 - 3 * 1.9 / 0.0634])
    markers = nominal("gelsight_40").markers()
    assert markers is not None
    assert np.abs(markers.points_mm()).max() == pytest.approx(13.3)
    assert len(markers.points_mm()) == 64


def test_digit_mid_section_has_radius_21_4_unless_it_is_set_or_thin() -> None:
    """By the least-squares circle through points of the section (Kasa's linear fit)."""
    x = np.linspace(-7.5, 7.5, 61)
    z = nominal("digit").pad().top_mm(np.stack([x, 0 * x], axis=-1))
    a, b, c = np.linalg.lstsq(np.stack([x, z, 0 * x + 1], axis=-1), x**2 + z**2, rcond=None)[0]
    assert np.sqrt(c + (a**2 + b**2) / 4) == pytest.approx(21.4, abs=0.3)
    assert nominal("digit", mid_radius_mm=30.0).pad().values()["mid_radius_mm"] == 30.0
    # A thin gel is flatter.
    thin = [nominal("digit", thickness_mm=t).pad() for t in (4.07, 3.0, 2.0, 1.0)]
    radii = [pad.values()["mid_radius_mm"] for pad in thin]
    assert nominal("digit").pad().values()["mid_radius_mm"] == radii[0] == 21.4
    assert (np.diff(radii) > 0).all()
    with pytest.raises(InputError, match="thickness_mm must be at least"):
        nominal("digit", thickness_mm=2.0, thin_crown="kept")
    flat = nominal("digit", thickness_mm=1.0, mid_radius_mm=0, roll_off=0).pad()
    assert float(flat.top_mm(np.array([4.0, 4.0]))) == pytest.approx(0.0)


@pytest.mark.parametrize(("end", "height"), [(-1, 2.34), (1, 2.65)])
def test_digit_rolls_off_at_base_and_tip(end: int, height: float) -> None:
    """digit-design: the centreline, 4.07 over the back, comes down to that where the rim begins."""
    inward = np.linspace(0.0, 12.5, 2501)
    xy = np.stack([0 * inward, end * (12.5 - inward)], axis=-1)
    over_back = nominal("digit").pad().top_mm(xy) + 4.07
    assert 0.5 < inward[np.argmax(over_back >= height)] < 1.8
    assert np.abs(over_back[inward > 7.5] - 4.07).max() < 0.25


def test_taccel_pad_is_bevelled_and_9dtact_has_a_core_and_a_skin() -> None:
    pad = nominal("gelsight_40").pad()
    assert pad.top_mm(np.array([16.9, 0.0])) == pytest.approx(0.0)
    assert pad.top_mm(np.array([19.999, 0.0])) == pytest.approx(2.971 - 5.925, abs=2e-3)
    assert pad.values()["bond_sides"] == "yes"
    pad = nominal("9dtact").pad()
    assert pad.layer_names == ("gel", "skin")
    assert len(nominal("9dtact").layer_materials()) == 2
    inside = [[0, 0, -2.79], [0, 0, -0.31], [14.7, 0, -1.5], [0, 11.2, -1.5]]
    outside = [[0, 0, -0.29], [14.8, 0, -1.5], [0, 11.3, -1.5], [15.5, 0, -2.7]]
    assert pad.layer_of(np.array(inside + outside)).tolist() == [0] * 4 + [1] * 4


def test_housings_have_the_stated_size() -> None:
    for name, size in {
        "gelsight_mini": (32.0, 28.0, 24.0),
        "digit": (26.95, 34.01, 28.4),
        "9dtact": (32.5, 25.5, 22.7),
        "rtac": (30.0, 30.0, 21.65),
    }.items():
        housing = nominal(name).housing()
        assert housing is not None and housing.size_mm == size
        assert name != "gelsight_mini" or size[2] - housing.front_z_mm == 28.25


def test_pad_matches_the_gel_map_of_taxim_everywhere() -> None:
    grid, pad = FAMILY.parameters().grid(), FAMILY.parameters().pad()
    corner = np.array([grid.x_mm()[-1], grid.y_mm()[-1]])
    assert -pad.height_mm(corner) == pytest.approx(1.40, abs=0.01)
    # The deepest labelled press of the data: radius 1.976 mm with a 2 mm ball.
    assert pad.thickness_mm > 2 * (2 - np.sqrt(2**2 - 1.976**2))
    spec = importlib.util.find_spec("taxim")
    if spec is None or not spec.submodule_search_locations:
        pytest.skip("the package taxim is not installed")
    folder = Path(next(iter(spec.submodule_search_locations)))
    gelmap_px = np.load(folder / "calib" / "gelsight" / "gelmap.npy").astype(np.float64)
    measured = gelmap_px * grid.mm_per_px_x - pad.thickness_mm
    xy = np.stack(np.meshgrid(grid.x_mm(), grid.y_mm()), axis=-1)
    error = pad.height_mm(xy) - measured
    assert np.sqrt((error**2).mean()) < 0.001
    assert np.abs(error).max() < 0.012


def test_material_is_in_si() -> None:
    material = FAMILY.parameters({"young_modulus_mpa": 0.3}).material()
    assert material.young_modulus_pa == pytest.approx(3e5)
    assert 0 <= material.poisson_ratio < 0.5
    with pytest.raises(InputError, match=r"sensor gelsight: .*poisson_ratio = 0\.5.* 0 to 0\.499"):
        FAMILY.parameters({"poisson_ratio": 0.5})
    with pytest.raises(InputError, match=r"no parameter 'colour' \(did you mean led_colors"):
        FAMILY.parameters({"colour": "red"})
