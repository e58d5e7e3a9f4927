# SPDX-License-Identifier: Apache-2.0
"""Measured dimensions of a pad as plain values."""

from __future__ import annotations

from typing import Any

from taccel_lab.cad.parts.labelled_solid import LabelledSolid
from taccel_lab.cad.parts.pad import Pad
from taccel_lab.geometry import Region


def dimensions(part: LabelledSolid, pad: Pad | None = None) -> dict[str, Any]:
    """Measured dimensions of the solid [mm, mm^2, mm^3], for the workshop's drawing."""
    box = part.solid.bounding_box()
    measured = {
        "unit": "mm",
        "frame": "x right and y down in the image, z out of the gel; origin at the apex",
        "bounding_box_min": [box.min.X, box.min.Y, box.min.Z],
        "bounding_box_max": [box.max.X, box.max.Y, box.max.Z],
        "volume_mm3": part.volume_mm3,
        "area_mm2": {region.name.lower(): part.area_mm2(region) for region in Region},
    }
    if pad is None:
        return measured
    return {**measured, **pad.figures(), "pad": pad.values()}
