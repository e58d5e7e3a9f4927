# SPDX-License-Identifier: Apache-2.0
"""The press that a photo shows: found by reading the photo, to be simulated and set beside it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.exporters.image_files import eight_bit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from taccel_lab.profile import SensorProfile

LIKE = "like.png"
"""File of a press folder: photo, simulation and difference."""
_CORE = 0.5
"""Share of the deepest place above which the gel follows the indenter: its middle is the press's.
The gel's slope around it would draw the middle towards the side with more gel."""


@dataclass(frozen=True)
class PressPhoto:
    """A photo of a press, and the place and depth that it shows."""

    path: Path
    rgb: np.ndarray
    """Levels in the light of the background, float32, [height_px, width_px, 3]."""
    background: np.ndarray
    """The untouched sensor, levels, the same shape."""
    at_mm: tuple[float, float]
    """Gel x and y of the middle of what is pressed in [mm]."""
    depth_mm: float
    """Deepest place below the resting face [mm]."""
    depth_sigma_mm: float | None
    """Its standard deviation; None where the profile states none."""
    warnings: tuple[str, ...]
    """What the reading says of itself, a sentence each."""

    @classmethod
    def read(cls, profile: SensorProfile, path: Path, background: Path | None = None) -> PressPhoto:
        """Find the press in an image.

        Args:
            profile: With colours, to simulate them, and with normals or depths, to read them.
            path: The image.
            background: Image of the untouched sensor in place of the profile's; with a starter
                profile it is looked for beside the image.

        Raises:
            InputError: A profile without these blocks, an image of another sensor, no contact, a
                starter profile without an untouched image.
        """
        from scipy import ndimage

        from taccel_lab.calibration.normals.read_surface import SurfaceReader
        from taccel_lab.calibration.untouched_frame import UntouchedFrame
        from taccel_lab.files.images import read_image

        if profile.color is None or profile.background_rgb is None:
            raise InputError(
                f"{path} cannot be compared with a press: the profile of {profile.sensor.name} has "
                "no colours; calibrate them first"
            )
        image = read_image(path)
        untouched = UntouchedFrame.of(profile, [path], background, option="--untouched")
        reader = SurfaceReader(
            untouched.profile, background=untouched.image, background_name=untouched.name
        )
        found = reader.read(image, str(path))
        figures = found.figures(reader.grid)
        if not found.touch.any:
            raise InputError(f"{path} shows {found.depth_words}: there is no press to simulate")
        depth = -found.rise_m
        column, row = figures["deepest_px"]
        parts, _ = ndimage.label(depth > _CORE * depth[row, column])  # type: ignore[misc]
        core = parts == parts[row, column]
        middle = ndimage.center_of_mass(depth * core)[::-1]
        x, y = reader.grid.gel_from_pixel(np.array(middle))
        warnings = list(figures["warnings"])
        edge = np.concatenate([core[0], core[-1], core[:, 0], core[:, -1]])
        if edge.any():
            warnings.append("the contact reaches the image's border: its middle is not seen whole")
        return cls(
            path,
            reader.lit(image).levels,
            reader.background,
            (float(x), float(y)),
            figures["max_depth_mm"],
            figures["max_depth_sigma_mm"],
            tuple(warnings),
        )

    def simulated(self, painted: np.ndarray, profile: SensorProfile) -> np.ndarray:
        """A painted press over the photo's own background, levels, [height_px, width_px, 3]."""
        assert profile.background_rgb is not None
        return np.clip(self.background + (painted - profile.background_rgb), 0.0, 255.0)

    def figures(
        self, painted: np.ndarray, contact: np.ndarray, profile: SensorProfile
    ) -> dict[str, Any]:
        """What was found, and how far the simulation is from it.

        Args:
            painted: Simulated image, levels, [height_px, width_px, 3].
            contact: Its contact, bool, [height_px, width_px].
            profile: The sensor's.

        Returns:
            Place and depth; in the crop of 1.6 contact radii the peak signal-to-noise ratio [dB],
            the mean absolute error [levels], and both of the untouched image.
        """
        from taccel_lab.calibration.capture.captures import ContactCircle
        from taccel_lab.calibration.color.evaluate import crop_slices, psnr_db

        grid = profile.grid()
        u, v = grid.pixel_from_gel(np.array(self.at_mm))
        pixels = max(int(contact.sum()), 1)
        radius_px = float(np.sqrt(pixels * grid.mm_per_px_y / grid.mm_per_px_x / np.pi))
        crop = crop_slices(ContactCircle(float(u), float(v), radius_px), grid)
        seen, shown = self.rgb[crop], self.simulated(painted, profile)[crop]
        rest = self.background[crop]
        return {
            "photo": str(self.path),
            "at_mm": self.at_mm,
            "depth_mm": self.depth_mm,
            "depth_sigma_mm": self.depth_sigma_mm,
            "psnr_db": psnr_db(shown, seen),
            "untouched_psnr_db": psnr_db(rest, seen),
            "mean_error_levels": float(np.abs(shown - seen).mean()),
            "untouched_error_levels": float(np.abs(rest - seen).mean()),
            "warnings": list(self.warnings),
        }

    def draw(self, painted: np.ndarray, profile: SensorProfile, psnr_db: float) -> Figure:
        """Photo, simulation and their difference side by side, over the gel."""
        from taccel_lab.report.figures import draw_comparison

        simulated = self.simulated(painted, profile)
        return draw_comparison(eight_bit(self.rgb), eight_bit(simulated), profile.grid(), psnr_db)
