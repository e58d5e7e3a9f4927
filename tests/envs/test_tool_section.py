# SPDX-License-Identifier: Apache-2.0
"""``Indenter.contact``: about what of a gel is touched, for the mesh of a press."""

from __future__ import annotations

import math

import numpy as np
import pytest

from taccel_lab.envs import parse_indenter
from taccel_lab.errors import InputError
from taccel_lab.geometry.tool_section import ToolSection


@pytest.mark.parametrize(("depth_mm", "radius_mm"), [(0.5, 0.968), (5.0, 2.0)])
def test_the_radius_of_a_ball_is_hertz(depth_mm: float, radius_mm: float) -> None:
    found = parse_indenter("sphere:2.0").contact(depth_mm)
    assert found == pytest.approx(radius_mm, rel=1e-3)


@pytest.mark.parametrize(
    ("text", "depth_mm", "half_mm"),
    [
        ("cylinder:1.5", 0.5, (1.5, 1.5)),
        ("box:6x8", 0.5, (3.0, 4.0)),
        ("roller:2x6", 0.5, (0.968, 3.0)),
        ("edge:90x6", 0.4, (0.2, 3.0)),
        ("edge:60x5", 0.4, (0.2 * math.tan(math.radians(30)), 2.5)),
        ("pair:0.25x0.5", 0.4, (0.25 + 0.25 + math.sqrt(0.25**2 - 0.05**2), 0.245)),
    ],
)
def test_the_outline_of_a_tool(text: str, depth_mm: float, half_mm: tuple[float, float]) -> None:
    section = parse_indenter(text).contact(depth_mm)
    assert isinstance(section, ToolSection)
    outline = section.outline_mm
    assert np.abs(outline).max(axis=0) == pytest.approx(half_mm, rel=0.02)
    ahead = np.roll(outline, -1, axis=0) - outline
    turn = ahead[:, 0] * np.roll(ahead, -1, axis=0)[:, 1]
    turn -= ahead[:, 1] * np.roll(ahead, -1, axis=0)[:, 0]
    assert (turn > 0).all()


@pytest.mark.parametrize(
    ("text", "filled"),
    [
        ("cylinder:1.5", 1.0),
        ("edge:90x6", 1.0),
        ("roller:2x6", 1.0),
        ("grating:2x4x6", 4 / 7),
        ("pair:0.25x0.5", 2 * math.pi * 0.06 / (math.pi * 0.06 + 2 * math.sqrt(0.06))),
    ],
)
def test_how_much_of_its_outline_a_tool_fills(text: str, filled: float) -> None:
    section = parse_indenter(text).contact(0.4)
    assert isinstance(section, ToolSection)
    assert section.filled == pytest.approx(filled, rel=0.02)


@pytest.mark.parametrize(
    ("outline", "filled", "depth_mm", "message"),
    [
        (np.ones(4), 1.0, 0.1, r"finite xy in mm, \[n, 2\]"),
        (np.full((4, 2), math.nan), 1.0, 0.1, "finite"),
        (np.eye(2), 0.0, 0.1, r"a part of its outline in \(0, 1\]"),
        (np.eye(2), 1.0, 0.0, "above 0 mm"),
    ],
)
def test_a_section_is_checked(
    outline: np.ndarray, filled: float, depth_mm: float, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        ToolSection(outline, filled, depth_mm)
