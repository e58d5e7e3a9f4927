# SPDX-License-Identifier: Apache-2.0
"""All that one image tells of a touch: the surface, what presses it, and both as files."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import write_by, write_json
from taccel_lab.files.images import read_grey
from taccel_lab.files.output_folder import atomic_directory
from taccel_lab.geometry import PixelGrid
from taccel_lab.geometry.height_surface import points_of_heights, write_ply
from taccel_lab.profile import SensorProfile
from taccel_lab.reading.heights import BAND_SIGMAS
from taccel_lab.reading.pressure import ContactPressure, PressureReader
from taccel_lab.reading.surface import SurfaceReader
from taccel_lab.reading.touch import SurfaceReading
from taccel_lab.report.style import BLUE, LIGHT, ORANGE, in_report_style, new_figure, save_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEAST_KPA = 0.1
"""Top of the scale of pressures of a gel that nothing touches."""
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
class TouchReading(SurfaceReading):
    """A surface, and the pressure and force that hold it so.

    Shear is not read: one image does not show it, and the layer has no tangential load.
    """

    grid: PixelGrid
    """Grid of all maps."""
    image: np.ndarray
    """What was read, RGB levels, [height_px, width_px, 3]."""
    name: str = "image"
    """File of the image, or what errors call it."""
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

    @property
    def points_m(self) -> np.ndarray:
        """Point cloud of the contact face [m], gel frame, [height_px, width_px, 3]."""
        return points_of_heights(self.height_m, self.grid)

    def save(self, folder: Path | str) -> None:
        """Write arrays, picture, figures and surface as the folder, whole or not at all.

        Raises:
            InputError: The folder holds files that taccel-lab did not write.
        """
        with atomic_directory(folder) as staging:
            write_reading(self, staging, ply=True)

    def save_ply(self, path: Path | str) -> None:
        """Write the contact face as PLY: vertices in metres with their normals, and triangles."""
        write_ply(path, self.points_m, self.normals)

    def plot(self) -> Figure:
        """Image, depth, pressure and a section, with their units."""
        return draw_reading(self, self.summary()[0])


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
        return self.press(self.surface.read(image, name), image, name)

    def press(
        self,
        found: SurfaceReading,
        image: np.ndarray,
        name: str = "image",
        time_s: float | None = None,
    ) -> TouchReading:
        """What holds a surface that was read from ``image``; ``time_s``: when, for a gel that
        relaxes."""
        press = None
        if self._pressure is not None:
            press = self._pressure.read(
                -found.depth_m, found.touch, found.height_sigma_m, found.reading_sigma_m, time_s
            )
        return TouchReading(
            **vars(found),
            grid=self.surface.grid,
            image=image,
            name=name,
            press=press,
            no_press=self.no_press,
        )


@in_report_style
def draw_reading(found: TouchReading, title: str) -> Figure:
    """Image, depth and pressure maps, and the section through the deepest pixel; no pressure where
    there is none."""
    depth_mm, press, grid = 1e3 * found.depth_m, found.press, found.grid
    extent = (0.0, grid.width_px * grid.mm_per_px_x, grid.height_px * grid.mm_per_px_y, 0.0)
    maps = [("depth [mm]", depth_mm, "viridis")]
    if press is not None:
        maps.append(("pressure [kPa]", 1e-3 * press.pressure_pa, "magma"))
    pictures = len(maps) + 1
    figure, axes = new_figure(3.7 * (pictures + 1), 3.3, 1, pictures + 1)
    axes[0].set_title(title, fontsize="medium")
    axes[0].imshow(np.clip(found.image, 0, 255).astype(np.uint8), extent=extent)
    for ax, (label, values, colors) in zip(axes[1:pictures], maps, strict=True):
        most = max(float(values.max()), LEAST_KPA) if colors == "magma" else None
        low = None if most is None else 0.0
        shown = ax.imshow(values, extent=extent, cmap=colors, vmin=low, vmax=most)
        figure.colorbar(shown, ax=ax, shrink=0.8).set_label(label)
    if press is not None:
        axes[pictures - 1].set_title(press.force_words, fontsize="medium")
    for ax in axes[:pictures]:
        ax.set_xlabel("x [mm]")
    axes[0].set_ylabel("y [mm]")
    row, column = np.unravel_index(int(np.argmax(depth_mm)), depth_mm.shape)
    x = np.arange(grid.width_px) * grid.mm_per_px_x
    y = np.arange(grid.height_px) * grid.mm_per_px_y
    axes[-1].axhline(0, color=LIGHT, lw=0.8)
    sections = (
        ("along x", BLUE, x - x[column], np.s_[row, :]),
        ("along y", ORANGE, y - y[row], np.s_[:, column]),
    )
    for label, color, away, section in sections:
        axes[-1].plot(away, depth_mm[section], color=color, label=label)
        if found.height_sigma_m is not None:
            depth = depth_mm[section]
            band = BAND_SIGMAS * 1e3 * found.height_sigma_m[section]
            axes[-1].fill_between(away, depth - band, depth + band, color=color, alpha=0.2, lw=0)
    axes[-1].invert_yaxis()
    axes[-1].set(xlabel="from the deepest point [mm]", ylabel="depth [mm]")
    axes[-1].legend(loc="lower right")
    return figure


def read_mask(path: Path, profile: SensorProfile) -> np.ndarray:
    """Pixels that count, from a grey image of the profile's size, bool, shape [h, w].

    Raises:
        InputError: No image, another size, or no pixel that counts.
    """
    mask = read_grey(path) > 0
    expected = (profile.camera.height_px, profile.camera.width_px)
    if mask.shape != expected or not mask.any():
        raise InputError(
            f"{path} is {mask.shape[1]}x{mask.shape[0]} px with {int(mask.sum())} "
            f"usable pixels; {expected[1]}x{expected[0]} px and some non-zero ones needed"
        )
    return mask


def write_reading(
    found: TouchReading, folder: Path, stem: str = "", *, ply: bool = False
) -> dict[str, Any]:
    """Write ``NAME.npz``, ``NAME.png``, ``NAME.json`` and with ``ply`` ``NAME.ply`` into
    ``folder``; returns the figures. NAME is that of the image where there is no ``stem``."""
    stem = stem or Path(found.name).stem
    stored: dict[str, Any] = {}
    for key in ARRAYS:
        value = getattr(found, key)
        if value is not None:
            stored[key] = value if value.dtype == bool else value.astype(np.float32)
    if found.press is not None:
        stored["pressure_pa"] = found.pressure_pa.astype(np.float32)
    write_by(folder / f"{stem}.npz", partial(np.savez_compressed, **stored))
    save_figure(draw_reading(found, stem), folder / f"{stem}.png")
    if ply:
        found.save_ply(folder / f"{stem}.ply")
    figures = {"image": found.name, **found.figures()}
    write_json(folder / f"{stem}.json", figures)
    return figures
