# SPDX-License-Identifier: Apache-2.0
"""Forces of surfaces that are known, against closed forms and finite elements."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.presses.bonded_layer import ToolKind, layer_force_n
from taccel_lab.profile import SensorProfile
from taccel_lab.reading.bonded_layer import FAR_MM, BondedLayer, press_layer, pressure_under
from taccel_lab.reading.pressure import ContactPressure, PressureReader
from taccel_lab.reading.touch import Touch, touch_of
from taccel_lab.sensors.profile import catalogue_profile

GRID = PixelGrid(160, 120, 0.12, 0.12)
THICK_MM, NU, PA = 4.0, 0.46, 3e5
LAYER = {"thickness_mm": THICK_MM, "poisson_ratio": NU}
SIGMA = np.full((120, 160), 2e-5)


@pytest.fixture(scope="module")
def profile() -> SensorProfile:
    size = {"young_modulus_mpa": 1e-6 * PA, "length_x_mm": 30.0, "length_y_mm": 30.0}
    made = catalogue_profile("flat_pad", LAYER | size)
    spreads = {
        "material": {"young_modulus_pa": 0.01 * PA},
        "camera": {"mm_per_px_x": 1e-4, "mm_per_px_y": 1e-4},
    }
    for key, spread in spreads.items():
        made = with_provenance(made, key, spread=spread)
    return made


def with_provenance(profile: SensorProfile, key: str, **said: object) -> SensorProfile:
    block = profile.blocks()[key]
    told = block.replace(provenance=block.provenance.model_copy(update=said))
    return replace(profile, **{key: told})


def read(
    reader: PressureReader | SensorProfile, rise: np.ndarray, sigma: np.ndarray | None = None
) -> ContactPressure:
    """What presses a face whose height and reading are off by ``sigma`` [m]."""
    if isinstance(reader, SensorProfile):
        reader = PressureReader(reader, GRID)
    return reader.read(rise, touch_of(rise, sigma, GRID), sigma, sigma)


def force_n(kind: ToolKind, radius_mm: float, depth_mm: float) -> float:
    return float(layer_force_n(kind, np.array(depth_mm), radius_mm, THICK_MM, NU, PA))


def rise_m(kind: str, radius_mm: float, depth_mm: float) -> np.ndarray:
    """Face under a tool on the grid of the view, of a finer one [m]."""
    fine = GRID.resized(320, 240)
    x, y = np.meshgrid(fine.x_mm(), fine.y_mm())
    away = np.hypot(x - 1.0, y + 0.5)
    if kind == "sphere":
        inside = np.minimum(away, 0.999 * radius_mm)
        tool = np.where(away < radius_mm, radius_mm - np.sqrt(radius_mm**2 - inside**2), FAR_MM)
    else:
        tool = np.where(away <= radius_mm, 0.0, FAR_MM)
    step = fine.mm_per_px_x, fine.mm_per_px_y
    found = press_layer(tool, depth_mm, step, BondedLayer(THICK_MM, NU), tolerance=3e-4)
    return 1e-3 * found.rise_mm.reshape(120, 2, 160, 2).mean(axis=(1, 3))


@pytest.mark.thorough(cases=("sphere-4.0-0.3-0.03", "sphere-4.0-1.0-0.03"))
@pytest.mark.parametrize(
    ("kind", "radius_mm", "depth_mm", "within"),
    [
        ("sphere", 4.0, 0.3, 0.03),
        ("sphere", 4.0, 1.0, 0.03),
        ("sphere", 2.0, 0.6, 0.03),
        ("cylinder", 2.0, 0.4, 0.05),
        ("cylinder", 3.5, 0.8, 0.05),
    ],
)
def test_forces_of_known_faces_are_those_of_the_closed_form(
    profile: SensorProfile, kind, radius_mm: float, depth_mm: float, within: float
) -> None:
    found = read(profile, rise_m(kind, radius_mm, depth_mm))
    assert found.force_n == pytest.approx(force_n(kind, radius_mm, depth_mm), rel=within)
    assert found.center_mm == pytest.approx((1.0, -0.5), abs=0.05)
    assert (found.pressure_pa >= 0).all()
    pixel_m2 = 1e-6 * GRID.mm_per_px_x * GRID.mm_per_px_y
    assert found.pressure_pa.sum() * pixel_m2 == pytest.approx(found.force_n, rel=0.02)
    if kind == "cylinder":
        assert found.area_mm2 == pytest.approx(np.pi * radius_mm**2, rel=0.15)


def test_an_error_as_large_as_stated_leaves_the_force_within_its_interval(profile) -> None:
    """Rough and smooth errors of 20 um on a dent of 0.6 mm."""
    rise, true = rise_m("sphere", 4.0, 0.6), force_n("sphere", 4.0, 0.6)
    rng, inside = np.random.default_rng(0), []
    for smooth in (0, 0, 2, 2, 6, 6, 15, 15):
        error = gaussian_filter(rng.standard_normal(rise.shape), smooth)
        found = read(profile, rise + error * 2e-5 / error.std(), SIGMA)
        assert found.force_n == pytest.approx(true, rel=0.12)
        assert found.force_interval_n is not None
        low, high = found.force_interval_n
        inside.append(low <= true <= high)
        assert high / low < 1.6
    assert sum(inside) >= 7


def test_unknown_thickness_and_modulus_widen_the_interval(profile: SensorProfile) -> None:
    rise = rise_m("sphere", 4.0, 0.6)

    def width(of: SensorProfile) -> float:
        interval = read(of, rise, 0.5 * SIGMA).force_interval_n
        assert interval is not None
        return float(np.log(interval[1] / interval[0]))

    known = width(profile)
    thickness = with_provenance(profile, "gel", interval={"thickness_mm": (3.2, 5.0)})
    assert width(thickness) > 1.2 * known
    stiffness = {"young_modulus_pa": (0.8 * PA, 1.25 * PA)}
    modulus = with_provenance(profile, "material", interval=stiffness)
    assert width(modulus) == pytest.approx(np.hypot(known, 2 * np.log(1.25)), rel=0.02)
    assert read(modulus, rise).remarks == ()
    assumed = catalogue_profile("flat_pad", LAYER)
    assert width(assumed) == pytest.approx(np.hypot(known, 2 * np.log(2.0)), rel=0.1)
    assert "covers 75 to 300 kPa" in read(assumed, rise).remarks[0]


def test_a_frame_reads_as_it_would_alone_whatever_was_read_before(profile: SensorProfile) -> None:
    """To the bit: near frames, far ones, the same one again, and none that touches."""
    reader, here = PressureReader(profile, GRID), rise_m("sphere", 2.0, 0.6)
    shifted = np.roll(here, (35, 55), axis=(0, 1))
    for frame in (here, 1.1 * here, here, shifted, np.zeros_like(here), here):
        alone, after = read(profile, frame, SIGMA), read(reader, frame, SIGMA)
        assert after.figures() == alone.figures()
        assert np.array_equal(after.pressure_pa, alone.pressure_pa)
        # An untouched gel after a touched one: nothing is left of it.
        assert (after.force_n == 0 and after.center_mm is None) == (not frame.any())
    # Nor does a frame whose deviation is not known take that of another one.
    assert read(reader, here).figures() == read(profile, here).figures()


def test_forces_are_those_of_a_search_that_is_over(profile: SensorProfile, monkeypatch) -> None:
    frames = [rise_m("sphere", 2.0, 0.6), rise_m("cylinder", 2.0, 0.4)]
    found = [read(profile, frame, SIGMA).force_n for frame in frames]
    monkeypatch.setattr("taccel_lab.reading.pressure.TOLERANCE", 1e-5)
    over = [read(profile, frame, SIGMA).force_n for frame in frames]
    assert found == pytest.approx(over, rel=1e-3)


@pytest.mark.parametrize("part", [np.s_[8:40, 16:56], np.s_[0:48, 0:64], np.s_[8:32, 0:72]])
def test_a_part_of_the_grid_is_pressed_as_the_whole_is(part: tuple[slice, slice]) -> None:
    """As long as no tool is beside it, whatever gel is."""
    x, y = np.meshgrid(np.arange(72) - 32.0, np.arange(56) - 18.0)
    gap = np.where(np.hypot(x, 2 * y) < 14, 0.02 * x + 0.01 * y - 0.6, FAR_MM)
    step, layer = (0.12, 0.15), BondedLayer(THICK_MM, NU)
    whole, sunk = pressure_under(gap, step, layer, 1e-5, film_mm=0.1)
    found, below = pressure_under(gap[part], step, layer, 1e-5, film_mm=0.1, whole=gap.shape)
    np.testing.assert_allclose(found, whole[part], atol=1e-3 * float(whole.max()))
    np.testing.assert_allclose(below, sunk[part], atol=2e-5)
    outside = np.ones(gap.shape, dtype=bool)
    outside[part] = False
    assert not whole[outside].any() and whole.any()


def test_what_may_press_unseen_grows_with_the_depth_that_may_hide(profile: SensorProfile) -> None:
    """Evenly, also where the depth lies between those that are solved for."""
    reader, nothing = PressureReader(profile, GRID), np.zeros((GRID.height_px, GRID.width_px))
    depths_mm, ends = np.geomspace(0.1, 0.3, 12), []
    for depth_mm in depths_mm:
        found = reader.read(nothing, Touch(nothing > 0, 0.05, float(depth_mm)), SIGMA)
        assert found.force_interval_n is not None and found.force_interval_n[0] == 0
        ends.append(found.force_interval_n[1])
    powers = np.diff(np.log(ends)) / np.diff(np.log(depths_mm))
    assert powers.min() > 1.4 and powers.max() < 2.2


def test_a_contact_that_leaves_the_image_and_a_deep_one_are_said(profile: SensorProfile) -> None:
    x, y = np.meshgrid(GRID.x_mm(), GRID.y_mm())
    away2 = (x - 9.0) ** 2 + y**2
    tool = np.where(away2 < 9.0, 4.0 - np.sqrt(16.0 - np.minimum(away2, 9.0)), FAR_MM)
    rise = 1e-3 * press_layer(tool, 0.6, (0.12, 0.12), BondedLayer(THICK_MM, NU)).rise_mm
    assert any("border" in text for text in read(profile, rise).remarks)
    deep = read(profile, rise_m("sphere", 4.0, 1.9)).remarks
    assert any("of its thickness" in text for text in deep)


@pytest.mark.thorough
def test_a_dome_is_refused() -> None:
    dome = catalogue_profile("digit_360")
    with pytest.raises(InputError, match="dome"):
        PressureReader(dome, dome.grid())
