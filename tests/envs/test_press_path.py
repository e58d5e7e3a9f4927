# SPDX-License-Identifier: Apache-2.0
"""Paths of a press: where they end, how long their steps are, what is refused."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.envs import PressPath
from taccel_lab.errors import InputError

lengths = st.floats(-5, 5)


@given(
    depth=st.floats(1e-3, 5),
    shear=st.tuples(lengths, lengths),
    twist=st.floats(-90, 90),
    step_mm=st.floats(0.02, 3),
    step_deg=st.floats(0.1, 30),
)
def test_waypoints(
    depth: float, shear: tuple[float, float], twist: float, step_mm: float, step_deg: float
) -> None:
    path = PressPath(depth, shear, twist, step_mm, step_deg).waypoints()
    assert path[-1] == (depth, shear, twist)
    previous = (0.0, (0.0, 0.0), 0.0)
    for point in path:
        # First straight down, then sideways and round at full depth.
        assert point[0] == depth or (point[1], point[2]) == ((0.0, 0.0), 0.0)
        assert 0 <= point[0] - previous[0] <= step_mm * (1 + 1e-6)
        assert math.dist(point[1], previous[1]) <= step_mm * (1 + 1e-6)
        assert abs(point[2] - previous[2]) <= step_deg * (1 + 1e-6)
        previous = point
    # No step more than needed: one fewer would make them too long.
    down = sum(point[1] == (0.0, 0.0) and point[2] == 0.0 for point in path)
    assert down <= max(1, math.ceil(depth / step_mm))
    side = max(math.hypot(*shear) / step_mm, abs(twist) / step_deg)
    assert len(path) <= max(1, math.ceil(depth / step_mm)) + math.ceil(side)


def test_even_steps_are_not_split_by_rounding() -> None:
    assert len(PressPath(0.6, step_mm=0.2).waypoints()) == 3
    assert len(PressPath(0.2, (0.3, 0.0), step_mm=0.1).waypoints()) == 5


def test_motion_is_even() -> None:
    path = PressPath(0.5, (0.3, -0.4), -6.0, step_mm=0.25, step_deg=2.0).waypoints()
    assert [p[0] for p in path] == [0.25, 0.5, 0.5, 0.5, 0.5]
    assert [p[2] for p in path] == [0.0, 0.0, -2.0, -4.0, -6.0]
    for a, b in itertools.pairwise(path[1:]):
        assert b[1][0] - a[1][0] == pytest.approx(0.1)
        assert b[1][1] - a[1][1] == pytest.approx(-0.4 / 3)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"depth_mm": 0.0}, "depth must be above 0 mm, got 0 mm"),
        ({"depth_mm": -0.5}, "depth must be above 0 mm, got -0.5 mm"),
        ({"depth_mm": 101.0}, "depth must be at most 100 mm, got 101 mm"),
        ({"depth_mm": math.nan}, "must be finite"),
        ({"depth_mm": math.inf}, "must be finite"),
        ({"shear_mm": (math.nan, 0.0)}, "must be finite"),
        ({"shear_mm": (0.0, -21.0)}, r"shear must lie within \+-20 mm"),
        ({"twist_deg": math.inf}, "must be finite"),
        ({"twist_deg": -181.0}, r"twist must lie within \+-180 deg, got -181"),
        ({"step_mm": 0.0}, "step_mm and step_deg must be above 0, got 0 and 2"),
        ({"step_deg": -1.0}, "step_mm and step_deg must be above 0, got 0.2 and -1"),
        ({"step_mm": math.nan}, "must be finite"),
        ({"step_mm": 1e-9}, "step_mm 1e-09 .* more than 10000 steps"),
        ({"twist_deg": 90.0, "step_deg": 1e-4}, "step_deg 0.0001 make more than 10000 steps"),
    ],
)
def test_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        PressPath(**{"depth_mm": 0.5, **changes})  # type: ignore[arg-type]


@given(depth=st.floats(0.1, 2), shear=lengths, twist=st.floats(-20, 20))
def test_the_way_back_is_the_way_there(depth: float, shear: float, twist: float) -> None:
    there = PressPath(depth, (shear, 0.0), twist, 0.3, 5.0).waypoints()
    loop = PressPath(depth, (shear, 0.0), twist, 0.3, 5.0, back=True).waypoints()
    assert loop[: len(there)] == there
    assert loop[len(there) :] == [*reversed(there[:-1]), (0.0, (0.0, 0.0), 0.0)]
