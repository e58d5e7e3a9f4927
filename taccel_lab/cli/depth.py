# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab depth``: tactile images in, height maps, pressures and forces out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tyro.conf import Positional

from taccel_lab.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from taccel_lab.calibration.pressure.touch import TouchReading


@dataclass(frozen=True)
class Depth:
    """Read height maps, pressures and forces from tactile images with a calibrated profile.

    A normals block (colour sensors) gives normals, which are integrated; a depth_response block
    (grey sensors) gives depths. For every image, `<name>.npz` holds the height, its standard
    deviation and the pressure, `<name>.png` shows them, and `<name>.json` has depth, position, area
    and force with its 95 % interval, from the contact of an elastic layer. Heights are
    metres in the gel frame, zero on untouched gel, negative in a dent. The +- is one standard
    deviation of the absolute depth, calibration included. The light of each image is brought to the
    profile's, and an untouched gel reads as no contact, 0 N. Images that cannot be a press of this
    sensor are listed with the reason. The others are still read, and the exit code is 2.
    """

    profile: Positional[str]
    """Profile folder, from `taccel-lab calibrate normals` or `calibrate depth`, or a sensor of the
    catalogue with a starter profile, which needs an untouched image."""
    images: Positional[tuple[Path, ...]]
    """Tactile images (PNG or JPEG) of the profile's size, or raw ones with --maps."""
    out: Path
    """Folder to write: three files per image."""
    background: Path | None = None
    """Image of the untouched sensor, if newer than the profile's. With a starter profile it is
    looked for beside the images: background.png, or the still frames of a recording."""
    mask: Path | None = None
    """Grey image; pixels of value 0 are not read, and the surface spans them smoothly."""
    maps: Path | None = None
    """Rectification maps (.npz) of `taccel-lab calibrate camera --maps`, for raw images."""
    method: Literal["auto", "normals", "depth"] = "auto"
    """Model to read with. auto: normals, if the profile has both."""
    json: bool = False
    """Print the figures as JSON instead of a line per image."""

    def run(self) -> None:
        from taccel_lab.calibration.camera.rectification import RectificationMaps
        from taccel_lab.calibration.normals.read_surface import SurfaceReader
        from taccel_lab.calibration.pressure.touch import TouchReader, read_mask, write_reading
        from taccel_lab.calibration.untouched_frame import UntouchedFrame
        from taccel_lab.cli.each_image import each_image, require_images
        from taccel_lab.files.images import image_size, read_image
        from taccel_lab.files.output_folder import require_replaceable
        from taccel_lab.processes.start_warp import start_warp
        from taccel_lab.sensors.profile import stock_sensor

        start_warp()
        require_replaceable(self.out)
        require_images(self.images)
        profile = stock_sensor(self.profile)
        maps = None if self.maps is None else RectificationMaps.load(self.maps)

        def rectified(image: np.ndarray, name: str) -> np.ndarray:
            if maps is None:
                return image
            maps.require_raw_size((image.shape[1], image.shape[0]), name)
            return maps.apply(image)

        mask = None if self.mask is None else read_mask(self.mask, profile)
        if maps is not None:
            width, height = maps.raw_size_px or image_size(self.images[0])
            # What the raw image does not show is black in the rectified one, not a dent.
            shown = maps.inside((height, width))
            camera = profile.camera.width_px, profile.camera.height_px
            if shown.shape != camera[::-1]:
                raise InputError(
                    f"{self.maps} makes images of {shown.shape[1]}x{shown.shape[0]} px, the "
                    f"profile's camera has {camera[0]}x{camera[1]} px; give the maps of the "
                    "profile's calibration"
                )
            mask = shown if mask is None else mask & shown
        untouched = UntouchedFrame.of(profile, self.images, self.background, fit=rectified)
        surfaces = SurfaceReader(
            untouched.profile,
            background=untouched.image,
            mask=mask,
            background_name=untouched.name,
            method=self.method,
        )
        reader = TouchReader(surfaces)

        def read(path: Path) -> tuple[TouchReading, np.ndarray]:
            image = rectified(read_image(path), str(path))
            return reader.read(image, str(path)), image

        def keep(
            found: tuple[TouchReading, np.ndarray], path: Path, folder: Path | None
        ) -> dict[str, Any]:
            assert folder is not None
            return write_reading(*found, path, folder)

        each_image(self.images, self.out, read, keep, as_json=self.json, lines=_lines)


def _lines(path: Path, about: dict[str, Any]) -> list[str]:
    sigma, (column, row) = about["max_depth_sigma_mm"], about["deepest_px"]
    depth = f"{about['max_depth_mm']:.3f} " + ("" if sigma is None else f"+- {sigma:.3f} ")
    said = f"{depth}mm deep at ({column}, {row}) px, {about['touched_mm2']:.2f} mm2 touched"
    return [
        f"{path.name}: {said if about['touched'] else about['depth_words']}",
        *_force_lines(about),
        *(f"  {warning}" for warning in (*about["warnings"], *about["force_remarks"])),
    ]


def _force_lines(about: dict[str, Any]) -> list[str]:
    if "force_n" not in about:
        return []
    interval = about["force_interval95_n"]
    band = "" if interval is None else " (95 %: {:.3g} to {:.3g} N)".format(*interval)
    return [
        f"  {about['force_n']:.3g} N{band}, {about['contact_mm2']:.2f} mm2 in contact, "
        f"pressure up to {1e-3 * about['max_pressure_pa']:.3g} kPa"
    ]
