# SPDX-License-Identifier: Apache-2.0
"""Intervals by their size: each cause that a press or a reading states is doubled, and widens the
interval by its own half width, computed beside the product, as independent causes do."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import taccel_lab as tl
from taccel_lab.networks.normal_settings import NormalModelConfig
from taccel_lab.presses import parse_indenter
from taccel_lab.presses.bonded_layer import layer_force_n
from taccel_lab.presses.options import PressOptions
from taccel_lab.presses.plan import PressPlan
from taccel_lab.presses.press import Press
from taccel_lab.profile import NormalsBlock, PerturbationBlock
from taccel_lab.reading.reader import Reader
from tests.networks.weights import random_weights
from tests.presses.formula_presses import DEFAULT, Resolution, outcome
from tests.support.dotted_profiles import LIGHT, with_painted_dots
from tests.support.oblong_grey import (
    BALL_MM,
    DEPTH_MM,
    GRID,
    KNOWN,
    LEVELS_PER_MM,
    NU,
    PA,
    THICK_MM,
    ball_image,
    grey_profile,
)

NORMAL_95 = 1.959964
Ends = tuple[float, float]


@dataclass(frozen=True)
class Row:
    """A cause of a size, once and twice as large."""

    changes: Callable[[int], dict[str, Any]]
    """Of the sensor, or of the press."""
    own: Callable[[int], Ends]
    """Half widths below and above of this cause alone."""
    within: float = 1e-6
    """Relative, of the growth."""
    sizes: tuple[int, ...] = (1, 2)
    """1 alone of what the product takes where nobody measured."""


def logs(low: float, high: float) -> Ends:
    """Half widths of factors."""
    return -math.log(low), math.log(high)


def same(half: float) -> Ends:
    return half, half


def of_a_factor(sigma_mm: float) -> Ends:
    """Half widths [mm] of what makes no touch of none: below, a factor."""
    off = NORMAL_95 * sigma_mm
    return DEPTH_MM * (1 - math.exp(-off / DEPTH_MM)), off


def layer_n(thickness_mm: float = THICK_MM, nu: float = NU) -> float:
    """Force of the ball on another layer."""
    return float(layer_force_n("sphere", np.array(DEPTH_MM), BALL_MM, thickness_mm, nu, PA))


def material(**said: Any) -> dict[str, Any]:
    spread = {"young_modulus_pa": 10.0, "poisson_ratio": 1e-7, **said.pop("spread", {})}
    return {"material": {"spread": spread, **said}}


def ratio(size: int) -> dict[str, Any]:
    """Poisson's ratio to a hundredth, with 95 %."""
    return material(spread={"poisson_ratio": 0.005 * size})


def camera(**said: Any) -> dict[str, Any]:
    return {"camera": {"spread": {}, **said}}


MODULUS = {
    "interval": Row(
        lambda k: material(
            interval={"young_modulus_pa": (PA * math.exp(-0.1 * k), PA * math.exp(0.15 * k))}
        ),
        lambda k: (0.1 * k, 0.15 * k),
    ),
    "two standard deviations": Row(
        lambda k: material(spread={"young_modulus_pa": 0.06 * k * PA}),
        lambda k: logs(1 - 0.12 * k, 1 + 0.12 * k),
    ),
    "nobody tested it": Row(
        lambda k: {"material": {"kind": "assumed", "spread": {}}},
        lambda k: same(math.log(2)),
        sizes=(1,),
    ),
}
THICKNESS: dict[str, tuple[dict[str, Any], Ends]] = {
    "interval": ({"interval": {"thickness_mm": (3.6, 4.6)}}, (3.6, 4.6)),
    "two standard deviations": ({"spread": {"thickness_mm": 0.2}}, (3.6, 4.4)),
    "nobody measured it": ({"spread": {}}, (3.8, 4.2)),
}
"""What a profile says, and between what the gel then lies [mm]."""
SCALE = {
    "two axes": Row(
        lambda k: camera(spread={"mm_per_px_x": 0.02 * k * 0.2, "mm_per_px_y": 0.01 * k * 0.1}),
        lambda k: same(NORMAL_95 * 2 * 0.02 * k * math.sqrt((1 + 0.25) / 2)),
    ),
    "interval": Row(
        lambda k: camera(interval={"mm_per_px_y": (0.1 - 0.004 * k, 0.1 + 0.004 * k)}),
        lambda k: same(NORMAL_95 * 2 * 0.02 * k),
    ),
    "measured, good to 2 %": Row(
        lambda k: camera(), lambda k: same(NORMAL_95 * 0.02), sizes=(1,)
    ),
    "published, good to 5 %": Row(
        lambda k: camera(kind="published"), lambda k: same(NORMAL_95 * 0.05), sizes=(1,)
    ),
}  # fmt: skip


def curve(**sigmas: float) -> dict[str, Any]:
    return {"depth_response": sigmas}


READ: dict[tuple[str, str], Row] = {
    ("depth", "reading"): Row(
        lambda k: curve(reading_sigma_mm=0.02 * k), lambda k: same(NORMAL_95 * 0.02 * k), 0.01
    ),
    ("depth", "zero"): Row(
        lambda k: curve(zero_sigma_mm=0.03 * k), lambda k: of_a_factor(0.03 * k), 0.01
    ),
    ("depth", "share"): Row(
        lambda k: curve(depth_share=0.04 * k), lambda k: of_a_factor(0.04 * k * DEPTH_MM), 0.01
    ),
    # Pressures of a layer are in proportion to its face.
    ("force", "depth's share"): Row(
        lambda k: curve(depth_share=0.04 * k),
        lambda k: (NORMAL_95 * 0.04 * k, math.log(1 + NORMAL_95 * 0.04 * k)),
        0.2,
    ),
    ("force", "Poisson's ratio"): Row(
        ratio,
        lambda k: same(0.5 * math.log(layer_n(nu=NU + 0.01 * k) / layer_n(nu=NU - 0.01 * k))),
        0.25,
    ),
    **{("force", f"modulus: {how}"): row for how, row in MODULUS.items()},
    # The face that is seen is not that of another thickness: the closed form is near.
    **{
        ("force", f"thickness: {how}"): Row(
            lambda k, said=said: {"gel": said},
            lambda k, ends=ends: same(0.5 * math.log(layer_n(ends[0]) / layer_n(ends[1]))),
            0.3,
            sizes=(1,),
        )
        for how, (said, ends) in THICKNESS.items()
    },
    **{("force", f"scale: {how}"): row for how, row in SCALE.items()},
    **{("area", f"scale: {how}"): row for how, row in SCALE.items()},
}  # fmt: skip


@lru_cache(maxsize=64)
def _read(key: str) -> Any:
    profile = grey_profile(**_asked[key])
    return tl.read(profile, ball_image(profile))


_asked: dict[str, dict[str, Any]] = {}


def read(changes: dict[str, Any]) -> Any:
    """The ball as this sensor sees it, once for each."""
    key = repr(changes)
    _asked[key] = changes
    return _read(key)


def read_halves(figure: str, changes: dict[str, Any]) -> np.ndarray:
    """Half widths of an interval of a reading, below and above."""
    found = read(changes)
    if figure == "depth":
        return np.abs(np.array(found.depth_interval_mm) - 1e3 * found.depth_m.max())
    value, ends = found.force_n, found.force_interval_n
    if figure == "area":
        value, ends = found.area_mm2, found.press.area_interval_mm2
    return np.abs(np.log(np.array(ends) / value))


def hold(halves: Callable[[dict[str, Any]], np.ndarray], row: Row) -> None:
    """The squares of the half widths grow by those of the cause alone."""
    known = halves({})
    for size in row.sizes:
        grown = np.sqrt(halves(row.changes(size)) ** 2 - known**2)
        np.testing.assert_allclose(grown, row.own(size), rtol=row.within, err_msg=f"x {size}")


@pytest.mark.parametrize(("figure", "cause"), READ)
def test_a_reading_holds_each_cause_by_its_size(figure: str, cause: str) -> None:
    hold(lambda changes: read_halves(figure, changes), READ[figure, cause])


def test_what_is_left_is_the_layers_own_error() -> None:
    """A standard deviation of 0.35 depths over the thickness."""
    low, _ = read_halves("force", {})
    assert low == pytest.approx(NORMAL_95 * 0.35 * DEPTH_MM / THICK_MM, rel=0.05)


def test_an_untouched_gel_may_be_pressed_as_hard_as_its_causes_hide() -> None:
    """Above the least error of the law, 2 %."""
    profiles = [grey_profile(**row) for row in ({}, MODULUS["interval"].changes(2))]
    assert profiles[0].background_rgb is not None
    known, unknown = (tl.read(each, profiles[0].background_rgb) for each in profiles)
    assert known.force_n == known.force_interval_n[0] == known.depth_interval_mm[0] == 0.0
    law = NORMAL_95 * 0.02
    grown = math.log(unknown.force_interval_n[1] / known.force_interval_n[1])
    assert grown == pytest.approx(math.hypot(law, 0.3) - law, rel=0.01)


@pytest.mark.parametrize("size", [1, 2])
def test_light_that_is_known_to_some_levels_moves_depths_by_them(size: int) -> None:
    reader = Reader(grey_profile(depth_response={"reading_sigma_mm": 0.02}))
    lit = reader.lit(ball_image(reader.profile))
    offset = np.zeros((3, 4, 4))
    offset[:, 1, 1] = (3.0 * size) ** 2
    found = reader.surface(replace(lit, light=replace(lit.light, covariance=offset)))
    grey = math.hypot(0.299, 0.587, 0.114) * 3.0 * size
    assert found.height_sigma_m is not None
    at = found.height_sigma_m[found.deepest_px]
    assert 1e3 * at == pytest.approx(math.hypot(0.02, grey / LEVELS_PER_MM), rel=1e-3)


def test_light_moves_depths_of_a_colour_sensor_by_its_size() -> None:
    """The light of the image as it is, and at rest, each once and twice as uncertain."""
    profile = grey_profile()
    config = NormalModelConfig(72, 96, members=2, hidden=(8,), height_factor=1.0)
    block = NormalsBlock(architecture=config.to_dict(), provenance=KNOWN)
    profile = profile.with_block(block, random_weights(config, spread=0.05))
    reader = Reader(profile, method="normals")
    lit = reader.lit(ball_image(profile))

    def variances(still: float, now: float) -> np.ndarray:
        covariance = [np.eye(4) * [1e-6, level**2, 0.0, 0.0] for level in (still, now)]
        lights = (
            replace(light, covariance=np.tile(each, (3, 1, 1)))
            for light, each in zip((lit.still, lit.light), covariance, strict=True)
        )
        still_light, light = lights
        found = reader.surface(replace(lit, still=still_light, light=light))
        assert found.height_sigma_m is not None and found.reading_sigma_m is not None
        return np.stack([found.height_sigma_m, found.reading_sigma_m]) ** 2

    known = variances(0.0, 0.0)
    for still, now in ((100.0, 0.0), (0.0, 100.0)):
        once, twice = (variances(f * still, f * now) - known for f in (1, 2))
        # Maps are of single precision: four times the difference of two squares rounds by 2e-6.
        np.testing.assert_allclose(twice, 4 * once, rtol=1e-4, atol=2e-6 * known.max())
        assert [each.max() > 0 for each in once] == [now > 0, still > 0]


BALL = f"sphere:{BALL_MM:g}"
X_MM, Y_MM = np.meshgrid(GRID.x_mm(), GRID.y_mm())
MOVED_MM = 0.8 + 0.03 * X_MM - 0.02 * Y_MM + 0.004 * X_MM * Y_MM
"""A face that leans across and down, and twists."""
LEANS = np.sqrt([np.mean((0.03 + 0.004 * Y_MM) ** 2), np.mean((-0.02 + 0.004 * X_MM) ** 2)])
"""Root mean square of its slopes along x and y."""
TINTS = np.array([40.0, -25.0, 10.0])
"""Levels per millimetre that red, green and blue change by."""
TINT = math.sqrt(np.mean(TINTS**2))


def press(changes: dict[str, Any]) -> Press:
    """A press as it was solved, with an image in colours of its depth."""
    asked = {"force_share": 0.01, "height_error_mm": 0.002, "beside": 0.5, **changes}
    sensor = {k: v for k, v in asked.items() if k in ("gel", "material", "camera")}
    profile = grey_profile(**sensor)
    profile = profile.with_block(profile.material.replace(friction_coefficient=0.5))
    profile = with_painted_dots(profile, np.empty((0, 2)), 0.0)
    assert profile.color is not None
    said = KNOWN.model_copy(update={"residuals": asked.get("colours", {})})
    profile = profile.with_block(profile.color.replace(provenance=said), profile.color_weights)
    if "units" in asked:
        profile = profile.with_block(PerturbationBlock(**asked["units"], provenance=KNOWN))
    made = outcome(Resolution.of(0), 2.0)
    made = replace(
        made,
        path=replace(made.path, depth_mm=DEPTH_MM),
        force_error_n=2.0 * asked["force_share"],
        height_error_m=1e-3 * asked["height_error_mm"],
        height_m=-1e-3 * MOVED_MM,
        rest_height_m=0.0 * MOVED_MM,
    )
    photo = None
    if "photo" in asked:
        sigmas = {"at_error_mm": None, "depth_error_mm": None, **asked["photo"]}
        photo = SimpleNamespace(**sigmas)
    aim = {"depth_mm": DEPTH_MM} if "force_n" not in asked else {"force_n": asked["force_n"]}
    options = PressOptions(indenter=BALL, friction=asked.get("friction"), **aim)
    tool = parse_indenter(BALL)
    plan = PressPlan("grey", profile, tool, options, DEFAULT, 0.5, photo)  # type: ignore[arg-type]
    found = Press.of(made, plan, 0.0, below=made, slippery=asked.get("slippery", 1.0))
    rgb = LIGHT + MOVED_MM[..., None] * TINTS
    images = iter([(rgb, None), (rgb - asked["beside"], None)])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("taccel_lab.presses.press.painted_images", lambda *_: next(images))
        assert found.image_error is not None
    return found


def press_halves(figure: str, changes: dict[str, Any]) -> np.ndarray:
    """Half widths of what a press states: of its force by logarithms, else below and above."""
    found = press(changes)
    if figure == "force":
        return np.abs(np.log(np.array(found.force_interval_n) / found.force_n))
    error = found.height_error if figure == "height" else found.image_error
    assert error is not None
    return np.full(2, error.total)


def photo(**sigmas: Any) -> dict[str, Any]:
    return {"photo": sigmas}


SLIPPERY = {"slippery": 0.8}
"""A fifth of the force depends on friction."""
PLACED = {"x": (0.04, 0.0), "y": (0.0, 0.04), "x and y": (0.03, 0.05)}
DEEPER = math.sqrt(np.mean(MOVED_MM**2)) / DEPTH_MM
PRESSED: dict[tuple[str, str], Row] = {
    **{("force", f"modulus: {how}"): row for how, row in MODULUS.items()},
    ("force", "modulus: nobody tested it"): Row(
        MODULUS["nobody tested it"].changes,
        # Nor the ratio, which is 0.4999 at most.
        lambda k: (math.log(2), math.hypot(math.log(2), math.log(layer_n(nu=0.4999) / layer_n()))),
        sizes=(1,),
    ),
    **{
        ("force", f"thickness: {how}"): Row(
            lambda k, said=said: {"gel": said},
            lambda k, ends=ends: logs(*(layer_n(end) / layer_n() for end in reversed(ends))),
            1e-5,
            sizes=(1,),
        )
        for how, (said, ends) in THICKNESS.items()
    },
    ("force", "Poisson's ratio"): Row(
        ratio,
        lambda k: logs(*(layer_n(nu=NU + off * k) / layer_n() for off in (-0.01, 0.01))),
        1e-5,
    ),
    ("force", "friction: nobody measured it"): Row(
        lambda k: {"slippery": None}, lambda k: logs(1 - 0.13, 1 + 0.5 * 0.13), sizes=(1,)
    ),
    ("force", "friction: any, where the gel was pressed without"): Row(
        lambda k: SLIPPERY, lambda k: logs(0.8, 1.1), sizes=(1,)
    ),
    ("force", "friction: interval"): Row(
        lambda k: SLIPPERY
        | material(interval={"friction_coefficient": (0.5 - 0.1 * k, 0.5 + 0.05 * k)}),
        lambda k: logs(1 - 0.2 * 0.2 * k, 1 + 0.1 * 0.1 * k),
    ),
    ("force", "friction: between units"): Row(
        lambda k: SLIPPERY | {"units": {"friction_coefficient": 0.05 * k}},
        lambda k: logs(1 - 0.2 * 0.2 * k, 1 + 0.2 * 0.1 * k),
    ),
    ("force", "depth"): Row(
        lambda k: photo(depth_error_mm=0.02 * k),
        lambda k: logs((1 - 0.04 * k / DEPTH_MM) ** 1.5, (1 + 0.04 * k / DEPTH_MM) ** 1.5),
    ),
    ("height", "depth"): Row(
        lambda k: photo(depth_error_mm=0.02 * k), lambda k: same(0.04 * k * DEEPER)
    ),
    ("image", "depth"): Row(
        lambda k: photo(depth_error_mm=0.02 * k), lambda k: same(0.04 * k * DEEPER * TINT)
    ),
    # As force grows by the power of 1.5, and the other way round.
    **{
        (figure, "modulus, of a press to a force"): Row(
            lambda k: {"force_n": 2.0, **MODULUS["interval"].changes(k)},
            lambda k, unit=unit: same(0.25 * k / 2 / 1.5 * DEEPER * DEPTH_MM * unit),
            1e-3,
        )
        for figure, unit in (("height", 1.0), ("image", TINT))
    },
    **{
        (figure, f"place along {axis}"): Row(
            lambda k, at=at: photo(at_error_mm=(k * at[0], k * at[1])),
            lambda k, at=at, unit=unit: same(2 * k * unit * math.hypot(*(at * LEANS))),
            1e-3,
        )
        for axis, at in PLACED.items()
        for figure, unit in (("height", 1.0), ("image", TINT))
    },
    ("image", "colours"): Row(
        lambda k: {"colours": {"heldout_crop_psnr_db": 30.0 - 20 * math.log10(k)}},
        lambda k: same(k * 255 / 10**1.5),
    ),
}  # fmt: skip


@pytest.mark.parametrize(("figure", "cause"), PRESSED)
def test_a_press_holds_each_cause_by_its_size(figure: str, cause: str) -> None:
    hold(lambda changes: press_halves(figure, changes), PRESSED[figure, cause])


def test_numerical_errors_are_what_is_left() -> None:
    low, high = press_halves("force", {"gel": {"spread": {"thickness_mm": 1e-9}}})
    assert (low, high) == pytest.approx(logs(0.99, 1.01), rel=1e-3)
    assert press_halves("height", {})[0] == pytest.approx(0.002)
    assert press_halves("image", {})[0] == pytest.approx(0.5)
    assert "friction" not in {each.name for each in press({"friction": 0.5}).force_interval.causes}
