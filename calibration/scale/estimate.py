# SPDX-License-Identifier: Apache-2.0
"""A scale of the image that one kind of capture gives."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from taccel_lab.calibration.result import Estimate
from taccel_lab.report.remark import Remark


@dataclass(frozen=True)
class ScaleEstimate:
    """mm/px along x and y by one method; None where it tells nothing of an axis."""

    method: str
    x: Estimate | None = None
    y: Estimate | None = None
    upper_x: float | None = None
    """95 % limit that the scale cannot exceed, where the method gives no more [mm/px]."""
    inputs: dict[str, str] = field(default_factory=dict)
    """SHA-256 of the images that were used, by name."""
    evidence: dict[str, Any] = field(default_factory=dict)
    """What it rests on, ready for JSON."""
    remarks: tuple[Remark, ...] = ()
    refused: tuple[str, ...] = ()
    """Captures that could not be used, with the reason."""

    def along(self, axis: str) -> Estimate | None:
        """The estimate of axis ``x`` or ``y``."""
        return self.x if axis == "x" else self.y

    def figures(self) -> dict[str, Any]:
        """Ready for JSON."""
        found: dict[str, Any] = {"refused": list(self.refused), **self.evidence}
        for axis in ("x", "y"):
            estimate = self.along(axis)
            if estimate is not None:
                found[f"mm_per_px_{axis}"] = estimate.figures()
        if self.upper_x is not None:
            found["mm_per_px_upper95"] = self.upper_x
        return found
