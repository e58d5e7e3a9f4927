# SPDX-License-Identifier: Apache-2.0
"""Options of a fit of grey levels to depths."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from taccel_lab.guards import require_seed


@dataclass(frozen=True, kw_only=True)
class DepthOptions:
    """Settings of ``calibrate_depth``."""

    maps: Path | None = None
    """Rectification maps (.npz) that `taccel-lab calibrate camera --maps` wrote: background and
    presses are rectified first, and the scale is that of the maps."""
    channel: Literal["grey", "red", "green", "blue"] = "grey"
    """Channel whose drop is read; grey is the luma of red, green and blue."""
    zero: Literal["auto", "travel", "untouched", "rim"] = "auto"
    """Zero of the depths. By travel, the untouched face by the depth_mm of presses (auto, if
    there is one). By untouched, where the grey is that of untouched gel (auto otherwise). By
    rim, the rim of the contact."""
    circles: Literal["auto", "detected"] = "auto"
    """Contact circles: those given, and found where none is given; or all of them found."""
    seed: int = 0
    """Seed of the resampling that gives the curve's uncertainty."""

    def __post_init__(self) -> None:
        require_seed(self.seed)
