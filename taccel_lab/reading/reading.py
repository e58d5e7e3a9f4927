# SPDX-License-Identifier: Apache-2.0
"""All that one image tells of a touch: one depth, one area, one force, whoever shows them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import write_by, write_json
from taccel_lab.files.output_folder import atomic_directory
from taccel_lab.geometry import PixelGrid
from taccel_lab.geometry.height_surface import points_of_heights, write_ply
from taccel_lab.reading.contact_pressure import ContactPressure
from taccel_lab.reading.directions import Directions
from taccel_lab.reading.reading_picture import draw_maps
from taccel_lab.reading.touch import Touch, least_logs
from taccel_lab.report.style import save_figure
from taccel_lab.summary import Summary
from taccel_lab.with_error import NORMAL_95, with_error

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STEEP_SHARE = 0.02
"""Share of pixels that the calibration says nothing of, from which on a user is warned."""
SigmaOf = Literal["absolute depth", "reading alone"]
NO_SIGMA = (
    "the profile does not say how uncertain its depths are: it was calibrated by an earlier "
    "version or without synthetic presses; calibrate again"
)
READING_ALONE = (
    "the profile was calibrated by an earlier version: its +- is that of the reading alone, and "
    "absolute depths are off by more; calibrate again to have it whole"
)


ARRAYS = (
    "height_m",
    "depth_m",
    "height_sigma_m",
    "reading_sigma_m",
    "normals",
    "sigma_deg",
    "radius95_deg",
    "beyond_balls",
    "saturated",
)
"""Arrays of a reading, as they are stored; those that its method does not give are left out."""


@dataclass(frozen=True, repr=False, kw_only=True)
class Reading(Summary):
    """What one image shows: the surface, and the pressure and force that hold it so.

    Shear is not read: one image does not show it, and the layer has no tangential load.
    """

    grid: PixelGrid
    """Grid of all maps."""
    image: np.ndarray
    """What was read, RGB levels, [height_px, width_px, 3]."""
    name: str = "image"
    """File of the image, or what errors call it."""

    height_m: np.ndarray
    """z of the contact face [m], gel frame, shape [height_px, width_px]: where nothing touches, z
    of the resting face, which is curved on some sensors."""
    depth_m: np.ndarray
    """How far the face lies below where it rests [m], positive in a dent, negative where the gel
    bulges; 0 where nothing touches, also on a curved gel."""
    height_sigma_m: np.ndarray | None
    """Standard deviation of height and depth [m]. None of models that were fitted without synthetic
    presses, and of curves of earlier versions."""
    reading_sigma_m: np.ndarray | None
    """Standard deviation of a place if nothing touches [m], by the reading and the image's light:
    what is off along with a depth, such as the calibration's circles or scale, is not in it."""
    directions: Callable[[], Directions]
    """Finds normals, their deviations, and steep places: not all who want a depth want these."""
    saturated: np.ndarray | None = None
    """Pixels darker than any that was calibrated, bool; None of a colour sensor."""
    method: Literal["normals", "depth"]
    touch: Touch
    """Where the gel is touched: the one decision that area, pressure and force follow."""
    sigma_of: SigmaOf | None = None
    """What ``height_sigma_m`` is that of: the absolute depth, or, with profiles of earlier versions
    that know no more, the reading alone; None where the profile tells none."""
    remarks: tuple[str, ...] = ()
    """What the profile says of itself, such as that it is of another unit."""
    press: ContactPressure | None = None
    """Pressure, force and contact; None where no flat layer stands for the gel."""
    no_press: str = ""
    """Why there is none, a sentence."""

    @property
    def normals(self) -> np.ndarray:
        """Outward unit normals, shape [height_px, width_px, 3]."""
        return self._directions.normals

    @property
    def sigma_deg(self) -> np.ndarray | None:
        """Standard deviation of each component of the tilt [degrees]; None of a grey sensor."""
        return self._directions.sigma_deg

    @property
    def radius95_deg(self) -> np.ndarray | None:
        """Angle within which 95 % of the true normals lie [degrees]; None of a grey sensor."""
        return self._directions.radius95_deg

    @property
    def beyond_balls(self) -> np.ndarray | None:
        """Pixels that read steeper than any captured ball was, bool; None of a grey sensor."""
        return self._directions.beyond_balls

    @property
    def depth_mm(self) -> float:
        """Depth of the deepest place that is touched [mm]; 0 where nothing touches."""
        return 1e3 * float(self.depth_m[self.deepest_px]) if self.touch.any else 0.0

    @property
    def depth_error_mm(self) -> float | None:
        """Standard deviation of ``depth_mm``; None where the profile states none."""
        sigma_m = self.height_sigma_m
        return None if sigma_m is None else 1e3 * float(sigma_m[self.deepest_px])

    @property
    def depth_interval_mm(self) -> tuple[float, float] | None:
        """95 % interval of ``depth_mm``, from 0 where nothing touches; None where the profile
        states no deviation."""
        error = self.depth_error_mm
        if error is None:
            return None
        if not self.touch.any:
            return 0.0, self.touch.unseen_mm
        depth, off = self.depth_mm, NORMAL_95 * error
        assert self.reading_sigma_m is not None
        alone = 1e3 * float(self.reading_sigma_m[self.deepest_px])
        return depth * math.exp(-math.hypot(*least_logs(depth, error, alone))), depth + off

    @property
    def force_n(self) -> float:
        """Normal force that presses the gel [N]."""
        return self._press.force_n

    @property
    def force_interval_n(self) -> tuple[float, float] | None:
        """95 % interval of the force [N]; None where the profile states no deviation of heights."""
        return self._press.force_interval_n

    @property
    def area_mm2(self) -> float:
        """Area in contact [mm2]."""
        return self._press.area_mm2

    @property
    def area_interval_mm2(self) -> tuple[float, float] | None:
        """95 % interval of the area [mm2]; None as of the force."""
        return self._press.area_interval_mm2

    @property
    def center_mm(self) -> tuple[float, float] | None:
        """Centre of pressure in the gel frame [mm]; None without contact."""
        return self._press.center_mm

    @property
    def pressure_pa(self) -> np.ndarray:
        """Contact pressure [Pa], at least 0, shape [height_px, width_px]."""
        return self._press.pressure_pa

    @property
    def pressure_kpa(self) -> np.ndarray:
        """The same [kPa]."""
        return 1e-3 * self.pressure_pa

    @property
    def points_m(self) -> np.ndarray:
        """Point cloud of the contact face [m], gel frame, [height_px, width_px, 3]."""
        return points_of_heights(self.height_m, self.grid)

    @property
    def points_mm(self) -> np.ndarray:
        """The same [mm]."""
        return 1e3 * self.points_m

    @cached_property
    def _directions(self) -> Directions:
        return self.directions()

    @property
    def _press(self) -> ContactPressure:
        if self.press is None:
            raise InputError(self.no_press)
        return self.press

    @property
    def depth_words(self) -> str:
        """Depth, its standard deviation and its place, or that nothing touches."""
        if not self.touch.any:
            return f"no contact deeper than {self.touch.unseen_mm:.2g} mm"
        row, column = self.deepest_px
        return f"{with_error(self.depth_mm, self.depth_error_mm)} mm deep at ({column}, {row}) px"

    @property
    def words(self) -> tuple[str, ...]:
        """Depth, force and area with their errors, a line each, as pages and commands show them."""
        if self.press is None:
            return (self.depth_words,)
        force = f"{self.press.force_words}, by the contact of an elastic layer"
        return self.depth_words, force, self.press.area_words

    @property
    def notes(self) -> tuple[str, ...]:
        """What a user should know before trusting it, a sentence each."""
        figures = self.figures()
        return (*figures["warnings"], *figures["force_remarks"])

    def summary(self) -> tuple[str, list[tuple[str, str]]]:
        """Depth, force and contact, by which model, and what the force rests on."""
        height, width = self.depth_m.shape
        title, press = f"surface read from {self.method}", self.press
        named = zip(("depth", "force", "area"), self.words, strict=False)
        rows: list[tuple[str, str]] = [*named, ("pixels", f"{width} x {height}")]
        notes = self.remarks
        if press is None:
            rows.append(("force", self.no_press))
        else:
            if press.center_mm is not None:
                at = "({:.2f}, {:.2f}) mm in the gel frame".format(*press.center_mm)
                rows.append(("centre", at))
            notes = (
                *notes,
                *press.remarks,
            )
        return title, [*rows, *(("note", text) for text in notes)]

    @cached_property
    def deepest_px(self) -> tuple[int, int]:
        """Row and column of the deepest place that is touched; of the image where nothing is."""
        depth = self.depth_m
        if self.touch.any:
            depth = np.where(self.touch.pixels, depth, -np.inf)
        row, column = np.unravel_index(int(np.argmax(depth)), depth.shape)
        return int(row), int(column)

    def figures(self) -> dict[str, Any]:
        """All numbers, ready for JSON."""
        row, column = self.deepest_px
        touched = self.touch.pixels
        pixel_mm2 = self.grid.mm_per_px_x * self.grid.mm_per_px_y
        at_mm = self.grid.gel_from_pixel(np.array([column, row], dtype=float))
        found: dict[str, Any] = {
            "method": self.method,
            "touched": self.touch.any,
            "words": list(self.words),
            "depth_mm": self.depth_mm,
            "depth_error_mm": self.depth_error_mm,
            "depth_interval_mm": self.depth_interval_mm and list(self.depth_interval_mm),
            "sigma_of": self.sigma_of,
            "deepest_px": [int(column), int(row)],
            "deepest_mm": [float(at_mm[0]), float(at_mm[1])],
            "dent_mm2": float(touched.sum() * pixel_mm2),
            "dent_deeper_than_mm": self.touch.least_mm,
            "dent_mm3": 1e3 * float(self.depth_m[touched].sum() * pixel_mm2),
        }
        inside = touched if touched.any() else np.ones_like(touched)
        if self.sigma_deg is not None:
            found["sigma_deg"] = float(self.sigma_deg[inside].mean())
        if self.radius95_deg is not None:
            found["radius95_deg"] = float(self.radius95_deg[inside].mean())
        if self.height_sigma_m is not None:
            found["mean_depth_error_mm"] = float(1e3 * self.height_sigma_m[inside].mean())
        if self.beyond_balls is not None:
            found["beyond_balls_share"] = float(self.beyond_balls[inside].mean())
        if self.saturated is not None:
            found["saturated_share"] = float(self.saturated.mean())
        found["warnings"] = self._warnings(found)
        if self.press is None:
            return {**found, "force_remarks": [self.no_press]}
        return {**found, **self.press.figures()}

    def _warnings(self, figures: dict[str, Any]) -> list[str]:
        """What a user should know before trusting the heights, one sentence each."""
        said = list(self.remarks)
        if self.sigma_of != "absolute depth":
            said.append(NO_SIGMA if self.sigma_of is None else READING_ALONE)
        steep = figures.get("beyond_balls_share", 0.0)
        if steep > STEEP_SHARE:
            said.append(
                f"{steep:.0%} of what is touched is steeper than any ball that was captured; its "
                "slopes are a guess from the colour model (beyond_balls marks them)"
            )
        if figures.get("saturated_share", 0.0) > STEEP_SHARE:
            said.append(
                f"{figures['saturated_share']:.0%} of the image is darker than any press that was "
                "captured; it is at least as deep as it reads"
            )
        return said

    def save(self, folder: Path | str) -> None:
        """Write arrays, picture, figures and surface as the folder, whole or not at all.

        Raises:
            InputError: The folder holds files that taccel-lab did not write.
        """
        with atomic_directory(folder) as staging:
            self.write_into(staging, ply=True)

    def write_into(self, folder: Path, stem: str = "", *, ply: bool = False) -> dict[str, Any]:
        """Write ``NAME.npz``, ``NAME.png``, ``NAME.json`` and with ``ply`` ``NAME.ply`` into a
        folder that is there; returns the figures. NAME is that of the image where there is no
        ``stem``."""
        stem = stem or Path(self.name).stem
        stored: dict[str, Any] = {}
        for key in ARRAYS:
            value = getattr(self, key)
            if value is not None:
                stored[key] = value if value.dtype == bool else value.astype(np.float32)
        if self.press is not None:
            stored["pressure_pa"] = self.pressure_pa.astype(np.float32)
        write_by(folder / f"{stem}.npz", partial(np.savez_compressed, **stored))
        save_figure(self._drawn(stem), folder / f"{stem}.png")
        if ply:
            self.save_ply(folder / f"{stem}.ply")
        figures = {"image": self.name, **self.figures()}
        write_json(folder / f"{stem}.json", figures)
        return figures

    def save_ply(self, path: Path | str) -> None:
        """Write the contact face as PLY: vertices in metres with their normals, and triangles."""
        write_ply(path, self.points_m, self.normals)

    def plot(self) -> Figure:
        """Image, depth, pressure and a section, with their units."""
        return self._drawn(self.summary()[0])

    def _drawn(self, title: str) -> Figure:
        press = self.press
        pressure_pa, words = (None, "") if press is None else (press.pressure_pa, press.force_words)
        titles = title, self.depth_words, words
        maps = self.image, self.depth_m, self.height_sigma_m, pressure_pa
        return draw_maps(*maps, self.grid, self.deepest_px, titles)
