# SPDX-License-Identifier: Apache-2.0
"""``Indenter.contact_half_mm``: how far a contact reaches, for the mesh of a press."""

from __future__ import annotations

import math

import pytest

from taccel_lab.envs import parse_indenter


@pytest.mark.parametrize(
    ("text", "depth_mm", "half_mm"),
    [
        # Hertz: sqrt(R d), here of the section at half of the depth.
        ("sphere:2.0", 0.5, (0.968, 0.968)),
        ("sphere:2.0", 5.0, (2.0, 2.0)),
        ("cylinder:1.5", 0.5, (1.5, 1.5)),
        ("box:6x8", 0.5, (3.0, 4.0)),
        ("roller:2x6", 0.5, (0.968, 3.0)),
        ("edge:90x6", 0.4, (0.2, 3.0)),
        ("edge:60x5", 0.4, (0.2 * math.tan(math.radians(30)), 2.5)),
        ("pair:0.25x0.5", 0.4, (0.25 + 0.25 + math.sqrt(0.25**2 - 0.05**2), 0.245)),
    ],
)
def test_half_widths(text: str, depth_mm: float, half_mm: tuple[float, float]) -> None:
    found = parse_indenter(text).contact_half_mm(depth_mm)
    assert found == pytest.approx(half_mm, rel=0.02)
