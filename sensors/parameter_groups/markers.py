# SPDX-License-Identifier: Apache-2.0
"""Dots painted on the contact face."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from cad.parameters import ParameterSet, parameter
from taccel_lab.errors import InputError
from taccel_lab.optics.description import MarkerGrid


@dataclass(frozen=True)
class MarkerParameters(ParameterSet):
    """Dots on the contact face: as many as fit an area at the pitch, centred on the gel."""

    parameter_group: ClassVar[str] = "markers"

    marker_pitch_mm: float = parameter(
        0.0, minimum=0.3, maximum=20, unit="mm", zero_means="no markers",
        source="the sensor has no markers", description="distance of neighbouring dots along x",
    )  # fmt: skip
    marker_pitch_y_mm: float = parameter(
        0.0, minimum=0.3, maximum=20, unit="mm", zero_means="as along x",
        source="assumption: a square grid", description="distance of neighbouring dots along y",
    )  # fmt: skip
    marker_area_x_mm: float = parameter(
        10.0, minimum=0.5, maximum=150, unit="mm", source="without effect while there are no dots",
        description="extent along x within which the centres of the dots lie",
    )  # fmt: skip
    marker_area_y_mm: float = parameter(
        10.0, minimum=0.5, maximum=150, unit="mm", source="without effect while there are no dots",
        description="extent along y within which the centres of the dots lie",
    )  # fmt: skip
    marker_radius_mm: float = parameter(
        0.35, minimum=0.02, maximum=5, unit="mm", source="without effect while there are no dots",
        description="radius of a dot",
    )  # fmt: skip

    def marker_grid(self) -> MarkerGrid | None:
        """The dots, None without."""
        if self.marker_pitch_mm == 0:
            return None
        pitch_y = self.marker_pitch_y_mm or self.marker_pitch_mm
        least = min(self.marker_pitch_mm, pitch_y)
        if self.marker_radius_mm > least / 2:
            raise InputError(
                f"marker_radius_mm = {self.marker_radius_mm:g} makes dots overlap at a pitch of "
                f"{least:g} mm; allowed: up to {least / 2:g} mm"
            )

        def count(area: float, pitch: float) -> int:
            return math.floor(area / pitch * (1 + 1e-9)) + 1

        return MarkerGrid(
            rows=count(self.marker_area_y_mm, pitch_y),
            columns=count(self.marker_area_x_mm, self.marker_pitch_mm),
            pitch_x_mm=self.marker_pitch_mm,
            pitch_y_mm=pitch_y,
            radius_mm=self.marker_radius_mm,
        )
