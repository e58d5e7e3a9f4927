# SPDX-License-Identifier: Apache-2.0
"""All that one image tells of a touch: the surface, and what presses it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.calibration.normals.read_surface import SurfaceReader, SurfaceReading
from taccel_lab.calibration.pressure.contact_pressure import ContactPressure, PressureReader
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, repr=False, kw_only=True)
class TouchReading(SurfaceReading):
    """A surface, and the pressure and force that hold it so.

    Shear is not read: one image does not show it, and the layer has no tangential load.
    """

    grid: PixelGrid
    """Of all maps."""
    press: ContactPressure | None
    """Pressure, force and contact; None where no flat layer stands for the gel."""
    no_press: str = ""
    """Why there is none, a sentence."""

    @property
    def pressure_pa(self) -> np.ndarray:
        """Contact pressure [Pa], at least 0, shape [height_px, width_px]."""
        return self._press.pressure_pa

    @property
    def force_n(self) -> float:
        """Normal force that presses the gel [N]."""
        return self._press.force_n

    @property
    def force_interval_n(self) -> tuple[float, float] | None:
        """95 % interval of the force [N]; None where the profile states no deviation of heights."""
        return self._press.force_interval_n

    @property
    def contact_mm2(self) -> float:
        """Area in contact [mm2]."""
        return self._press.contact_mm2

    @property
    def _press(self) -> ContactPressure:
        if self.press is None:
            raise InputError(self.no_press)
        return self.press

    def summary(self) -> tuple[str, list[tuple[str, str]]]:
        """Depth, force and contact, and what the force rests on."""
        title, rows = super().summary()
        if self.press is None:
            return title, [*rows, ("force", self.no_press)]
        press = self.press
        rows.append(("force", f"{press.force_words}, by the contact of an elastic layer"))
        peak = 1e-3 * float(press.pressure_pa.max())
        rows.append(("contact", f"{press.contact_mm2:.3g} mm2, pressure up to {peak:.3g} kPa"))
        if press.center_mm is not None:
            rows.append(("centre", "({:.2f}, {:.2f}) mm in the gel frame".format(*press.center_mm)))
        return title, [*rows, *(("note", text) for text in press.remarks)]

    def figures(self, grid: PixelGrid | None = None) -> dict[str, Any]:
        """All numbers, ready for JSON; the maps' own ``grid`` when None."""
        found = super().figures(self.grid if grid is None else grid)
        if self.press is None:
            return {**found, "force_remarks": [self.no_press]}
        return {**found, **self.press.figures()}

    def plot(self) -> Figure:
        """Depth, pressure and a section, with their units."""
        from taccel_lab.calibration.pressure.figures import draw_reading

        return draw_reading(None, self, self.press, self.grid, self.summary()[0])


class TouchReader:
    """Reads touches of one sensor, one image after another."""

    def __init__(self, surface: SurfaceReader) -> None:
        """``surface`` reads the heights."""
        self.surface = surface
        self.no_press, self._pressure = "", None
        try:
            self._pressure = PressureReader(surface.profile, surface.grid)
        except InputError as error:
            self.no_press = str(error)

    def read(self, image: np.ndarray, name: str = "image") -> TouchReading:
        """The touch that an image shows; arguments and errors as of ``SurfaceReader.read``."""
        return self.press(self.surface.read(image, name))

    def press(self, found: SurfaceReading) -> TouchReading:
        """What holds a surface that was read."""
        press = None
        if self._pressure is not None:
            press = self._pressure.read(
                found.rise_m, found.touch, found.height_sigma_m, found.reading_sigma_m
            )
        return TouchReading(
            **vars(found), grid=self.surface.grid, press=press, no_press=self.no_press
        )
