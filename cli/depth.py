# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab depth``: tactile images in, height maps out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tyro.conf import Positional

from taccel_lab.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from matplotlib.figure import Figure

    from taccel_lab.calibration.normals.read_surface import SurfaceReading
    from taccel_lab.geometry import PixelGrid


@dataclass(frozen=True)
class Depth:
    """Read height maps from tactile images with a calibrated profile.

    A profile with a normals block (colour sensors) gives normals, which are integrated; one with a
    depth_response block (grey sensors) gives depths. For every image, `<name>.npz` holds the
    height and its uncertainty, `<name>.png` shows it and `<name>.json` says how deep, where and
    how large. Heights are metres in the gel frame, zero on untouched gel, negative in a dent.
    """

    profile: Positional[Path]
    """Profile folder, from `taccel-lab calibrate normals` or `calibrate depth`."""
    images: Positional[tuple[Path, ...]]
    """Tactile images (PNG or JPEG) of the profile's size, or raw ones with --maps."""
    out: Path
    """Folder to write: three files per image."""
    background: Path | None = None
    """Image of the untouched sensor, where it is newer than the profile's own."""
    mask: Path | None = None
    """Grey image; pixels that are 0 are not read, and the surface goes on smoothly under them."""
    maps: Path | None = None
    """Rectification maps (.npz) of `taccel-lab calibrate camera --maps`, for raw images."""
    method: Literal["auto", "normals", "depth"] = "auto"
    """Model to read with; auto takes normals where the profile has both."""
    drift: Literal["auto", "on", "off"] = "auto"
    """Bring the light of each image to the background's first; auto does as the calibration did."""
    json: bool = False
    """Print the figures as JSON instead of a line per image."""

    def run(self) -> None:
        import cv2
        import numpy as np
        from rich.console import Console

        from taccel_lab.calibration.camera.rectification import RectificationMaps
        from taccel_lab.calibration.capture.images import decode, read_image
        from taccel_lab.calibration.normals.read_surface import SurfaceReader
        from taccel_lab.cli.console import print_json
        from taccel_lab.output import atomic_directory, require_replaceable, write_json
        from taccel_lab.profile import load_profile
        from taccel_lab.report.style import save_figure

        require_replaceable(self.out)
        self._check_names()
        profile = load_profile(self.profile)
        maps = None if self.maps is None else RectificationMaps.load(self.maps)

        def image_of(path: Path) -> np.ndarray:
            image = read_image(path)
            return image if maps is None else maps.apply(image)

        mask = None
        if self.mask is not None:
            mask = decode(self.mask, cv2.IMREAD_GRAYSCALE) > 0
            expected = (profile.camera.height_px, profile.camera.width_px)
            if mask.shape != expected or not mask.any():
                raise InputError(
                    f"{self.mask} is {mask.shape[1]}x{mask.shape[0]} px with {int(mask.sum())} "
                    f"usable pixels; {expected[1]}x{expected[0]} px and some non-zero ones needed"
                )
        reader = SurfaceReader(
            profile,
            background=None if self.background is None else image_of(self.background),
            mask=mask,
            method=self.method,
            drift=self.drift,
        )
        console, figures = Console(), {}
        with atomic_directory(self.out) as folder:
            for path in self.images:
                image = image_of(path)
                found = reader.read(image, str(path))
                arrays = {"height_m": found.height_m, "rise_m": found.rise_m}
                arrays["normals"] = found.normals
                if found.sigma_deg is not None:
                    arrays["sigma_deg"] = found.sigma_deg
                if found.radius95_deg is not None:
                    arrays["radius95_deg"] = found.radius95_deg
                if found.saturated is not None:
                    arrays["saturated"] = found.saturated
                stored: dict[str, Any] = {
                    key: value if value.dtype == bool else value.astype(np.float32)
                    for key, value in arrays.items()
                }
                np.savez_compressed(folder / f"{path.stem}.npz", **stored)
                save_figure(
                    draw_reading(image, found, profile.grid(), path.stem),
                    folder / f"{path.stem}.png",
                )
                figures[path.stem] = {"image": str(path), **found.figures(profile)}
                write_json(folder / f"{path.stem}.json", figures[path.stem])
                if not self.json:
                    about = figures[path.stem]
                    console.print(
                        f"{path.name}: {about['max_depth_mm']:.3f} mm deep at "
                        f"({about['deepest_px'][0]}, {about['deepest_px'][1]}) px, "
                        f"{about['touched_mm2']:.2f} mm2 touched",
                        highlight=False,
                    )
        if self.json:
            print_json({"out": str(self.out), "images": figures})
        else:
            console.print(f"wrote {self.out}", highlight=False)

    def _check_names(self) -> None:
        if not self.images:
            raise InputError("no image was given; name at least one PNG or JPEG")
        for path in self.images:
            if not path.is_file():
                raise InputError(f"{path} does not exist or is no file; an image is needed")
        stems = [path.stem for path in self.images]
        twice = sorted({stem for stem in stems if stems.count(stem) > 1})
        if twice:
            raise InputError(
                f"images named alike would overwrite each other's files: {', '.join(twice)}"
            )


def draw_reading(image: np.ndarray, found: SurfaceReading, grid: PixelGrid, title: str) -> Figure:
    """Image, depth map, and the section through the deepest pixel."""
    import numpy as np

    from taccel_lab.report.style import BLUE, LIGHT, ORANGE, in_report_style, new_figure

    @in_report_style
    def draw() -> Figure:
        depth_mm = -1e3 * found.rise_m
        extent = (0.0, grid.width_px * grid.mm_per_px_x, grid.height_px * grid.mm_per_px_y, 0.0)
        figure, axes = new_figure(11.0, 3.3, 1, 3)
        axes[0].imshow(np.clip(image, 0, 255).astype(np.uint8), extent=extent)
        axes[0].set_title(title)
        shown = axes[1].imshow(depth_mm, extent=extent, cmap="viridis")
        figure.colorbar(shown, ax=axes[1], shrink=0.8).set_label("depth [mm]")
        for ax in axes[:2]:
            ax.set_xlabel("x [mm]")
        axes[0].set_ylabel("y [mm]")
        row, column = np.unravel_index(int(np.argmax(depth_mm)), depth_mm.shape)
        x = np.arange(grid.width_px) * grid.mm_per_px_x
        y = np.arange(grid.height_px) * grid.mm_per_px_y
        axes[2].axhline(0, color=LIGHT, lw=0.8)
        axes[2].plot(x - x[column], depth_mm[row], color=BLUE, label="along x")
        axes[2].plot(y - y[row], depth_mm[:, column], color=ORANGE, label="along y")
        axes[2].invert_yaxis()
        axes[2].set_xlabel("from the deepest point [mm]")
        axes[2].set_ylabel("depth [mm]")
        axes[2].legend(loc="lower right")
        return figure

    return draw()
