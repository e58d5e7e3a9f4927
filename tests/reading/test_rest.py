# SPDX-License-Identifier: Apache-2.0
"""Flat tools that leave no border at rest: half planes, corners and plates."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.pressed_mini import PressedMini, ball, flat, inside

TOOLS = {
    "half plane": lambda x, y: x > 0,
    "a third": lambda x, y: x > 3.0,
    "two thirds": lambda x, y: x > -4.0,
    "corner": lambda x, y: (x > 0) & (y > 0),
    "slanted half plane": lambda x, y: x + 0.5 * y > 1.0,
    "plate": lambda x, y: (np.abs(x) < 7.8) & (np.abs(y) < 5.9),
    "plate to the border": lambda x, y: (np.abs(x) < 9.6) & (np.abs(y) < 7.2),
    "ridge": lambda x, y: np.abs(x) < 1.5,
    "ridge at one side": lambda x, y: np.abs(x - 7.0) < 1.0,
}


@pytest.fixture(scope="module")
def bench() -> PressedMini:
    return PressedMini()


@pytest.mark.parametrize(
    ("tool", "depth_mm"),
    [
        *((tool, 0.1) for tool in TOOLS),
        ("half plane", 0.05),
        ("half plane", 0.2),
        ("plate", 0.05),
        ("two thirds", 0.05),
    ],
)
def test_a_flat_tools_force_and_area_are_in_their_intervals(
    bench: PressedMini, tool: str, depth_mm: float
) -> None:
    """Whatever of the border it presses: before, a half plane 0.05 mm deep read 0 N (0 to 0.06)."""
    found, force_n, area_mm2 = bench.press(flat(TOOLS[tool], depth_mm))
    assert found.touch.any
    assert inside(force_n, found.force_interval_n)
    assert inside(area_mm2, found.area_interval_mm2)
    assert inside(depth_mm, found.depth_interval_mm)
    assert force_n / 2.5 < found.force_n < 2.5 * force_n
    # Whatever hides its zero, some of it is certain. Before, both began at 0.
    for interval in (found.depth_interval_mm, found.force_interval_n):
        assert interval is not None and interval[0] > 0


OUTLINES = {
    "triangle": lambda x, y: (y > -2.0) & (np.abs(x) < 0.577 * (4.0 - y)),
    "oblong": lambda x, y: (np.abs(x) < 2.1) & (np.abs(y) < 3.1),
    "narrow triangle": lambda x, y: (y > -1.5) & (x > -1.0) & (2 * x + y < 1.5),
}


@pytest.mark.parametrize("tool", OUTLINES)
@pytest.mark.parametrize("depth_mm", [0.25, 0.5])
def test_a_flat_faces_area_is_in_its_interval(
    bench: PressedMini, tool: str, depth_mm: float
) -> None:
    """Rims are read too wide, by as much as pixels err together."""
    found, force_n, area_mm2 = bench.press(flat(OUTLINES[tool], depth_mm))
    assert inside(area_mm2, found.area_interval_mm2) and inside(force_n, found.force_interval_n)
    assert found.area_interval_mm2 is not None
    assert found.area_interval_mm2[1] < 4 * area_mm2


def test_a_contact_that_hides_its_zero_says_so(bench: PressedMini) -> None:
    found, _, _ = bench.press(flat(TOOLS["plate to the border"], 0.1))
    assert any("nothing in view is at rest for certain" in note for note in found.notes)
    small, _, _ = bench.press(flat(lambda x, y: np.hypot(x, y) < 2.0, 0.1))
    assert not any("at rest" in note for note in small.notes)


@pytest.mark.parametrize("radius_mm", [4.0, 50.0])
@pytest.mark.parametrize("at", [(0.0, 0.0), (7.0, 4.0)])
def test_a_ball_is_counted_from_the_whole_border(
    bench: PressedMini, radius_mm: float, at: tuple[float, float]
) -> None:
    """It leaves one flat part; its shallow contact may be wider than what surely touches."""
    found, force_n, area_mm2 = bench.press(ball(radius_mm, 0.1, *at))
    assert inside(force_n, found.force_interval_n)
    assert inside(area_mm2, found.area_interval_mm2)


def test_an_untouched_gel_has_one_part(bench: PressedMini) -> None:
    found = bench.reader(bench.seen(bench.still))
    assert not found.touch.any
    assert found.force_interval_n is not None and found.force_interval_n[1] < 0.2
