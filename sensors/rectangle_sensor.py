# SPDX-License-Identifier: Apache-2.0
"""The usual sensor with a gel on a rounded rectangle; families add crown, rim or skin."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from taccel_lab.cad.parameters import restated
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.sensors.base import NO_FIGURE
from taccel_lab.sensors.camera_sensor import CameraSensorParameters


@dataclass(frozen=True)
class RectangleSensorParameters(CameraSensorParameters):
    """Parameters of a sensor whose gel is a flat pad, unless ``pad`` says more."""

    parameter_group: ClassVar[str] = "gel"

    length_x_mm: float = restated(24.0, of=GelPad, minimum=10, maximum=60, source=NO_FIGURE)
    length_y_mm: float = restated(20.0, of=GelPad, minimum=10, maximum=60, source=NO_FIGURE)
    corner_radius_mm: float = restated(2.0, of=GelPad, maximum=10, source=NO_FIGURE)
    thickness_mm: float = restated(4.0, of=GelPad, minimum=0.8, maximum=12, source=NO_FIGURE)

    def pad(self) -> GelPad:
        """The flat gel pad."""
        return self.gel_pad()

    def gel_pad(self, *, inset_mm: float = 0.0, **features: Any) -> GelPad:
        """The pad with further ``features`` of ``GelPad``, such as a rim.

        ``inset_mm`` is how far the seen face keeps away from the outline besides, as from a skin.
        """
        window_x, window_y = self.seen_mm(
            self.length_x_mm - 2 * inset_mm,
            self.length_y_mm - 2 * inset_mm,
            self._window_margin_mm(),
        )
        return GelPad(
            length_x_mm=self.length_x_mm,
            length_y_mm=self.length_y_mm,
            corner_radius_mm=self.corner_radius_mm,
            thickness_mm=self.thickness_mm,
            window_x_mm=window_x,
            window_y_mm=window_y,
            **features,
        )

    def _window_margin_mm(self) -> float:
        """How far inside the outline the corners of the seen rectangle stay, rounding included."""
        # A square corner m inside a rounded one of radius r is r - sqrt(2) (r - m) away from it.
        return max(1.0, 0.3 * self.corner_radius_mm + 0.25)
