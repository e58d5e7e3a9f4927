# SPDX-License-Identifier: Apache-2.0
"""The usual sensor with a gel on a rounded rectangle; families add crown, rim or skin."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.sensors.camera_sensor import CameraSensorParameters
from taccel_lab.sensors.parameter_groups import RectangleGelParameters


@dataclass(frozen=True)
class RectangleSensorParameters(RectangleGelParameters, CameraSensorParameters):
    """Parameters of a sensor whose gel is a flat pad, unless ``pad`` says more."""

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
            self.window_margin_mm(),
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
