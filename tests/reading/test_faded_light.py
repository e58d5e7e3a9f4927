# SPDX-License-Identifier: Apache-2.0
"""Light that fades on a grey sensor is distinguished from a dent by the gel beside it."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

import taccel_lab as tl
from taccel_lab.files.images import read_image
from taccel_lab.reading.bonded_layer import FAR_MM, BondedLayer, press_layer
from taccel_lab.signals.depth_response import DepthResponse
from tests.reading.test_grey import UNIT, noisy
from tests.support.real_data import real_data

Tool = Callable[[np.ndarray, np.ndarray], np.ndarray]


def spot(image: np.ndarray, share: float, at: tuple[float, float], wide: float) -> np.ndarray:
    """An image under a lamp that has become weaker around a place; places are -1..1."""
    v, u = (np.linspace(-1, 1, count) for count in image.shape[:2])
    field = np.exp(-((u - at[0]) ** 2 + (v[:, None] - at[1]) ** 2) / (2 * wide**2))
    return image * (1.0 - share * field[..., None])


def levels(image: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


@cache
def still() -> np.ndarray:
    background = tl.load_sensor("9dtact").background_rgb
    assert background is not None
    return background.astype(float)


@cache
def reader() -> tl.Reader:
    return tl.Reader("9dtact", background=levels(noisy(still(), 0.3)))


def pressed(tool: Tool, depth_mm: float) -> tuple[np.ndarray, float]:
    """An image of a tool by the layer's law, and its force [N]."""
    sensor = tl.load_sensor("9dtact")
    grid, material = sensor.grid(), sensor.material
    layer = BondedLayer(sensor.gel.thickness_mm, material.poisson_ratio)
    x, y = np.meshgrid(grid.x_mm() - grid.x_mm().mean(), grid.y_mm() - grid.y_mm().mean())
    found = press_layer(tool(x, y), depth_mm, (grid.mm_per_px_x, grid.mm_per_px_y), layer)
    pa = material.young_modulus_pa / (2 * (1 - material.poisson_ratio**2))
    force_n = pa * 1e-6 * grid.mm_per_px_x * grid.mm_per_px_y * float(found.pressure.sum())
    response = DepthResponse.from_profile(sensor)
    return levels(noisy(response.render(-found.rise_mm, still()), 0.5)), force_n


def ball(radius_mm: float) -> Tool:
    return lambda x, y: (x**2 + y**2) / (2 * radius_mm)


@pytest.mark.parametrize("share", [0.04, 0.06, 0.08])
@pytest.mark.parametrize(("at", "wide"), [((0.3, -0.2), 0.5), ((0.3, -0.2), 0.35), ((-1, 0), 0.5)])
def test_a_spot_of_weaker_light_is_no_touch(
    share: float, at: tuple[float, float], wide: float
) -> None:
    """Before, such spots read 1.3 to 7 N."""
    found = reader()(levels(noisy(spot(still(), share, at, wide), 0.5)))
    assert not found.touch.any and found.force_interval_n is not None
    assert found.force_interval_n[0] == 0.0 and found.force_interval_n[1] < 0.2
    assert "light has faded" in " ".join(found.notes)


@pytest.mark.parametrize("share", [0.04, 0.08])
@pytest.mark.parametrize("unit", [1, 2])
def test_nor_is_it_on_real_units(unit: int, share: float) -> None:
    rest = read_image(real_data(UNIT.format(unit) + "ref.png"))
    found = tl.read(
        "9dtact", levels(spot(rest.astype(float), share, (0.3, -0.2), 0.5)), background=rest
    )
    assert not found.touch.any and found.force_interval_n is not None
    assert found.force_interval_n[1] < 0.2


@pytest.mark.parametrize("share", [1.0, 0.25, 0.12])
@pytest.mark.parametrize("unit", [1, 2])
def test_a_real_press_is_none_of_it(unit: int, share: float) -> None:
    """Of it, or of as much of its change, the ring beside it is bright."""
    rest, press = (
        read_image(real_data(UNIT.format(unit) + f"{name}.png")).astype(float)
        for name in ("ref", "sample")
    )
    found = tl.read("9dtact", levels(rest + share * (press - rest)), background=levels(rest))
    assert found.touch.any and found.force_interval_n is not None
    assert found.force_interval_n[0] > 0 and "faded" not in " ".join(found.notes)


@pytest.mark.parametrize(
    ("tool", "depth_mm"),
    [
        pytest.param(ball(50.0), 0.2, id="lens"),
        pytest.param(ball(100.0), 0.2, id="flat lens", marks=pytest.mark.thorough),
        pytest.param(ball(25.0), 0.4, id="deep lens", marks=pytest.mark.thorough),
        pytest.param(lambda x, y: x**2 / 60.0, 0.3, id="roller", marks=pytest.mark.thorough),
        pytest.param(lambda x, y: np.where((x > 3) & (y > 2), 0.0, FAR_MM), 0.3, id="corner"),
        pytest.param(lambda x, y: np.where(x > 2.0, 0.0, FAR_MM), 0.3, id="half plane"),
        pytest.param(lambda x, y: ((x - 10) ** 2 + y**2) / 60.0, 0.3, id="lens at the border"),
    ],
)
def test_a_wide_smooth_tool_is_none_of_it(tool: Tool, depth_mm: float) -> None:
    image, force_n = pressed(tool, depth_mm)
    found = reader()(image)
    assert found.touch.any and "faded" not in " ".join(found.notes)
    assert found.force_interval_n is not None
    assert 0.0 < found.force_interval_n[0] < force_n < found.force_interval_n[1]


@pytest.mark.thorough
def test_a_bowl_as_wide_as_the_view_may_be_either() -> None:
    """What would lie beside it is out of view: the interval holds both, and says why."""
    image, force_n = pressed(ball(200.0), 0.2)
    light = reader()(levels(noisy(spot(still(), 0.08, (0.0, 0.0), 0.8), 0.5)))
    for found, true_n in ((reader()(image), force_n), (light, 0.0)):
        assert found.force_interval_n is not None
        assert found.force_interval_n[0] == 0.0 and true_n < found.force_interval_n[1]
        assert found.touch.any and "depth may be 0" in " ".join(found.notes)


@pytest.mark.parametrize(("share", "depth_mm"), [(0.03, 1.0), (0.05, 0.4), (0.08, 0.2)])
def test_a_ball_in_fading_light_is_read_as_without(share: float, depth_mm: float) -> None:
    image, force_n = pressed(ball(4.0), depth_mm)
    fading = spot(still(), share, (0.5, 0.4), 0.5)
    found = reader()(levels(image + fading - still()))
    assert found.touch.any and found.force_interval_n is not None
    assert found.depth_mm == pytest.approx(depth_mm, abs=0.1)
    assert found.force_interval_n[0] < force_n < found.force_interval_n[1]
    assert "light has faded" in " ".join(found.notes)
