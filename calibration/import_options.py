# SPDX-License-Identifier: Apache-2.0
"""What the person who imports captures knows better than the files."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, kw_only=True)
class ImportOptions:
    """What replaces, or adds to, what the layout says."""

    sensor: str | None = None
    """Sensor of the catalogue, or a profile folder. Default: that of the layout; flat_pad if
    unknown."""
    unit: str | None = None
    """Serial number or nickname of this particular sensor."""
    radius_mm: float | None = None
    """Radius of the ball of the presses or of the force record [mm]; replaces the layout's."""
    mm_per_px_x: float | None = None
    """Scale along the image's rows [mm/px], if you measured it."""
    mm_per_px_y: float | None = None
    """Scale along the image's columns [mm/px]. Default: that of the rows."""
    scale: Literal["stated", "catalogue"] = "stated"
    """Source of the scale where neither you nor a file states it: catalogue uses the sensor's usual
    one, noted as assumed."""
    background: str | None = None
    """Image of the untouched sensor, or "median" for the median of the presses."""
    edge_mm: float | None = None
    """Length of the edge of edge presses [mm]."""
    board: str | None = None
    """The board of the layout, or that of all images of a plain folder, such as
    chessboard:6x6:2.5. The numbers are inner corners or dots along a row x rows, and their pitch
    in mm if known. Kinds: chessboard, charuco, dots."""
    origin: str | None = None
    """Origin of the captures, kept as provenance. Default: from a README or MANIFEST in the
    source, else unknown."""
    license: str | None = None
    """Licence of the captures, kept as provenance. Default: that of a licence file or README in
    the source, else unknown."""
