# SPDX-License-Identifier: Apache-2.0
"""Dots painted on the contact face."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from taccel_lab.cad.parameters import ParameterSet, parameter
from taccel_lab.errors import InputError
from taccel_lab.profile.optical_design import MarkerGrid


@dataclass(frozen=True)
class MarkerParameters(ParameterSet):
    """Dots on the contact face: as many as fit an area and the gel at the pitch, centred."""

    parameter_group: ClassVar[str] = "markers"

    marker_pitch_mm: float = parameter(
        0.0, minimum=0.6, maximum=8, unit="mm", zero_means="no markers",
        source="the sensor has no markers", description="distance of neighbouring dots along x",
    )  # fmt: skip
    marker_pitch_y_mm: float = parameter(
        0.0, minimum=0.6, maximum=8, unit="mm", zero_means="as along x",
        source="assumption: a square grid", description="distance of neighbouring dots along y",
    )  # fmt: skip
    marker_area_x_mm: float = parameter(
        10.0, minimum=0.5, maximum=150, unit="mm", source="without effect while there are no dots",
        description="extent along x within which the centres of the dots lie, if there is gel",
    )  # fmt: skip
    marker_area_y_mm: float = parameter(
        10.0, minimum=0.5, maximum=150, unit="mm", source="without effect while there are no dots",
        description="the same along y",
    )  # fmt: skip
    marker_radius_mm: float = parameter(
        0.35, minimum=0.05, maximum=1.5, unit="mm", source="without effect while there are no dots",
        description="radius of a dot",
    )  # fmt: skip

    def marker_grid(self, on_gel: Callable[[np.ndarray], np.ndarray]) -> MarkerGrid | None:
        """The dots, None without; ``on_gel`` tells of gel xy [mm], [n, 2], whether gel is there.

        Where the area reaches beyond the gel, outer rows and columns are left out until all dots
        lie on it.

        Raises:
            InputError: Dots that overlap, or a gel too small for one.
        """
        if self.marker_pitch_mm == 0:
            return None
        pitch = (self.marker_pitch_mm, self.marker_pitch_y_mm or self.marker_pitch_mm)
        if self.marker_radius_mm > min(pitch) / 2:
            raise InputError(
                f"marker_radius_mm = {self.marker_radius_mm:g} makes dots overlap at a pitch of "
                f"{min(pitch):g} mm; allowed: up to {min(pitch) / 2:g} mm"
            )
        areas = (self.marker_area_x_mm, self.marker_area_y_mm)
        columns, rows = (
            math.floor(area / step * (1 + 1e-9)) + 1
            for area, step in zip(areas, pitch, strict=True)
        )
        # The four extreme points of each dot, so that all of its paint lies on the gel.
        reach = self.marker_radius_mm * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
        while True:
            grid = MarkerGrid(rows, columns, *pitch, self.marker_radius_mm)
            points = grid.points_mm()
            inside = on_gel((points[:, None] + reach).reshape(-1, 2)).reshape(rows, columns, -1)
            if inside.all():
                return grid
            if rows == columns == 1:
                raise InputError(f"no dot of {self.marker_radius_mm:g} mm radius fits the gel")
            # Whichever loses fewer dots per dot outside goes: the outer columns, or the outer rows.
            by_columns = (~inside[:, [0, -1]]).mean() if columns > 1 else -1.0
            by_rows = (~inside[[0, -1]]).mean() if rows > 1 else -1.0
            if by_columns >= by_rows:
                columns -= 1
            else:
                rows -= 1
