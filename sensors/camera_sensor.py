# SPDX-License-Identifier: Apache-2.0
"""The usual sensor: gel on a window, LEDs around it, a camera or several behind.

Each part (material, lights, coating, window, markers, housing) is a set of parameters by itself;
the sensor has them all, and the cameras look through them. A family derives from
``CameraSensorParameters``, adds the dimensions of its gel, restates the shared parameters whose
figures it knows.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from taccel_lab.cad.parameters import restated
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.cad.parts.housing_shape import HousingShape
from taccel_lab.cad.parts.pad import Pad
from taccel_lab.errors import InputError
from taccel_lab.profile.optical_design import Light, MarkerGrid, OpticalDesign, Window
from taccel_lab.sensors.base import NO_FIGURE, FamilyParameters, GelMaterial
from taccel_lab.sensors.parameter_groups.camera import CameraParameters
from taccel_lab.sensors.parameter_groups.lights import LightParameters
from taccel_lab.sensors.parameter_groups.material import MaterialParameters
from taccel_lab.sensors.parameter_groups.parts import (
    CoatingParameters,
    HousingParameters,
    MarkerParameters,
    WindowParameters,
)

MIN_SEEN_SHARE = 0.45
"""Least extent of the face that is marked as seen through, in units of the gel's."""


@dataclass(frozen=True)
class CameraSensorParameters(CameraParameters, FamilyParameters):
    """Parameters of a sensor with cameras behind its gel: theirs, and those of its parts."""

    groups: ClassVar = (
        MaterialParameters,
        LightParameters,
        CoatingParameters,
        WindowParameters,
        MarkerParameters,
        HousingParameters,
    )
    parameter_group: ClassVar[str] = "camera"
    housing_offset_mm: ClassVar[tuple[float, float]] = (0.0, 0.0)
    """Centre of the housing in gel xy."""

    def lights(self) -> tuple[Light, ...]:
        """LEDs and exits of light guides."""
        return self.group(LightParameters).lights()

    @cached_property
    def _built_pad(self) -> Pad:
        # Made once for all that asks for its extents; a pad is checked when it is made.
        return self.pad()

    def material(self) -> GelMaterial:
        """The gel's material."""
        return self.group(MaterialParameters).material()

    def housing(self) -> HousingShape | None:
        """The box that holds window, lights and camera."""
        held, window = self._built_pad.bounds_mm().copy(), self.window()
        if window is not None and window.shape == "plate":
            held[0, 2] -= window.thickness_mm
        return self.group(HousingParameters).housing(
            self.housing_offset_mm, held, self.parameters()
        )

    def gel_depth_mm(self) -> float:
        """Gel on the optical axis between the apex and what lies behind it [mm]."""
        return getattr(self, "thickness_mm")  # noqa: B009  # a parameter of most families

    def apparent_distance_mm(self) -> float:
        """Distance at which the camera sees the apex through window and gel [mm].

        By paraxial refraction: a plate of thickness t looks t / n thick.
        """
        gel, window = self.gel_depth_mm(), self.group(WindowParameters)
        plate = window.window_thickness_mm
        behind = self.camera_distance_mm - gel - plate
        return behind + gel / window.gel_index + plate / window.window_index

    def window(self) -> Window | None:
        """The window: a plate as large as the gel."""
        (x0, y0, _), (x1, y1, _) = self._built_pad.bounds_mm()
        return Window(
            thickness_mm=self.group(WindowParameters).window_thickness_mm,
            size_mm=(float(x1 - x0), float(y1 - y0)),
            refractive_index=self.group(WindowParameters).window_index,
        )

    def optics(self) -> OpticalDesign:
        """Camera, lights, coating and window; raises InputError for a camera inside the window."""
        window = self.window()
        if window is not None:
            self._check_camera(window)
        self._check_axis()
        media, ambient = self.group(WindowParameters), self.group(LightParameters).ambient
        return OpticalDesign(
            camera=self.camera(),
            lights=self.lights(),
            coating=self.group(CoatingParameters).coating(),
            window=window,
            gel_refractive_index=media.gel_index,
            ambient_rgb=(ambient, ambient, ambient),
            gel_scattering_per_mm=media.gel_scattering_per_mm,
        )

    def _check_camera(self, window: Window) -> None:
        solid = self.gel_depth_mm() + window.thickness_mm
        if self.camera_distance_mm <= solid:
            raise InputError(
                f"camera_distance_mm = {self.camera_distance_mm:g} puts the camera inside the gel "
                f"or the window (window_thickness_mm = {window.thickness_mm:g}); allowed: "
                f"above {solid:g} mm"
            )

    def _check_axis(self) -> None:
        """The optical axis meets the gel."""
        bounds = self._built_pad.bounds_mm()
        for axis, met in zip("xy", self.axis_meets_mm(), strict=True):
            low, high = bounds[:, "xy".index(axis)].tolist()
            if not low <= met <= high:
                raise InputError(
                    f"camera_{axis}_mm and camera_tilt_{axis}_deg let the optical axis meet the "
                    f"face at {axis} = {met:.4g} mm; the gel reaches from {low:.4g} to {high:.4g} "
                    "mm"
                )

    def views(self) -> dict[str, CameraSensorParameters]:
        """The sensor through its second camera, third camera and so on."""
        return {f"camera_{k + 1}": self.seen_by(k) for k in range(1, self.camera_count())}

    def markers(self) -> MarkerGrid | None:
        """The dots, as far as there is gel for them."""
        pad = self._built_pad
        return self.group(MarkerParameters).marker_grid(lambda xy: np.isfinite(pad.top_mm(xy)))

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
        """The pad with this sensor's parameters of those names, and with ``features`` of
        ``GelPad`` that follow from others.

        ``inset_mm`` is how far the seen face keeps away from the outline besides, as from a skin.
        """
        window_x, window_y = self.seen_mm(
            self.length_x_mm - 2 * inset_mm,
            self.length_y_mm - 2 * inset_mm,
            self._window_margin_mm(),
        )
        return self.part(GelPad, window_x_mm=window_x, window_y_mm=window_y, **features)

    def _window_margin_mm(self) -> float:
        """How far inside the outline the corners of the seen rectangle stay, rounding included."""
        # A square corner m inside a rounded one of radius r is r - sqrt(2) (r - m) away from it.
        return max(1.0, 0.3 * self.corner_radius_mm + 0.25)
