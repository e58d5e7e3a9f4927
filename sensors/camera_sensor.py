# SPDX-License-Identifier: Apache-2.0
"""The usual sensor: gel on a window, LEDs around it, one camera behind.

A family derives from ``CameraSensorParameters``, adds the dimensions of its gel, restates the
shared parameters whose figures it knows and says which lights stand where.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from taccel_lab.cad.parts.pad import Pad
from taccel_lab.errors import InputError
from taccel_lab.optics.description import Light, MarkerGrid, OpticalDesign, Window
from taccel_lab.sensors.base import FamilyParameters
from taccel_lab.sensors.parameter_groups.camera import CameraParameters
from taccel_lab.sensors.parameter_groups.coating import CoatingParameters
from taccel_lab.sensors.parameter_groups.housing import HousingParameters
from taccel_lab.sensors.parameter_groups.lights import LightParameters
from taccel_lab.sensors.parameter_groups.markers import MarkerParameters
from taccel_lab.sensors.parameter_groups.material import MaterialParameters
from taccel_lab.sensors.parameter_groups.window import WindowParameters

MIN_SEEN_SHARE = 0.45
"""Least extent of the face that is marked as seen through, in units of the gel's."""


@dataclass(frozen=True)
class CameraSensorParameters(
    HousingParameters,
    MarkerParameters,
    WindowParameters,
    CoatingParameters,
    LightParameters,
    CameraParameters,
    MaterialParameters,
    FamilyParameters,
):
    """Parameters of a sensor with one camera; see the groups for the parameters themselves."""

    @abstractmethod
    def lights(self) -> tuple[Light, ...]:
        """The LEDs, made with ``led``."""

    @cached_property
    def _built_pad(self) -> Pad:
        # Made once for all that asks for its extents; a pad is checked when it is made.
        return self.pad()

    def gel_depth_mm(self) -> float:
        """Gel on the optical axis between the apex and what lies behind it [mm]."""
        return getattr(self, "thickness_mm")  # noqa: B009  # a parameter of most families

    def apparent_distance_mm(self) -> float:
        """Distance at which the camera sees the apex through window and gel [mm].

        By paraxial refraction: a plate of thickness t looks t / n thick.
        """
        gel, plate = self.gel_depth_mm(), self.window_thickness_mm
        return (
            self.camera_distance_mm - gel - plate + gel / self.gel_index + plate / self.window_index
        )

    def window(self) -> Window | None:
        """The window: a plate as large as the gel."""
        (x0, y0, _), (x1, y1, _) = self._built_pad.bounds_mm()
        return Window(
            thickness_mm=self.window_thickness_mm,
            size_mm=(float(x1 - x0), float(y1 - y0)),
            refractive_index=self.window_index,
        )

    def optics(self) -> OpticalDesign:
        """Camera, lights, coating and window; raises InputError for a camera inside the window."""
        window = self.window()
        if window is not None:
            self._check_camera(window)
        return OpticalDesign(
            camera=self.camera(),
            lights=self.lights(),
            coating=self.coating(),
            window=window,
            gel_refractive_index=self.gel_index,
            ambient_rgb=(self.ambient, self.ambient, self.ambient),
            gel_scattering_per_mm=self.gel_scattering_per_mm,
        )

    def _check_camera(self, window: Window) -> None:
        solid = self.gel_depth_mm() + window.thickness_mm
        if self.camera_distance_mm <= solid:
            raise InputError(
                f"camera_distance_mm = {self.camera_distance_mm:g} puts the camera inside the gel "
                f"or the window (window_thickness_mm = {self.window_thickness_mm:g}); allowed: "
                f"above {solid:g} mm"
            )

    def markers(self) -> MarkerGrid | None:
        """The dots, as far as there is gel for them."""
        pad = self._built_pad
        return self.marker_grid(lambda xy: np.isfinite(pad.top_mm(xy)))

    def seen_mm(
        self, length_x_mm: float, length_y_mm: float, margin_mm: float
    ) -> tuple[float, float]:
        """Extents of the back that is marked as seen through [mm].

        What the image shows, but at least 0.45 of the gel and cut ``margin_mm`` inside a gel of
        the given size: smaller patches and thinner margins would rule the mesh.
        """
        seen = []
        for view, length in zip(self.view_mm(), (length_x_mm, length_y_mm), strict=True):
            seen.append(min(max(view, MIN_SEEN_SHARE * length), length - 2 * margin_mm))
        return seen[0], seen[1]
