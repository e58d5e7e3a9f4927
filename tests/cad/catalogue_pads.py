# SPDX-License-Identifier: Apache-2.0
"""Pads of the catalogue with a flat back, at their defaults."""

from __future__ import annotations

from taccel_lab.cad.parts.height_pad import HeightPad
from taccel_lab.sensors import sensor_families

PADS: dict[str, HeightPad] = {
    name: pad
    for name, family in sensor_families().items()
    if isinstance(pad := family.parameters().pad(), HeightPad)
}
MINI, BEVELLED, SKINNED, DIGIT = (
    PADS[name] for name in ("gelsight_mini", "gelsight_40", "9dtact", "digit")
)
