# SPDX-License-Identifier: Apache-2.0
"""The press that a photo shows: found by reading the photo, to be simulated and set beside it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.api.seen_press import SeenPress
from taccel_lab.errors import InputError
from taccel_lab.exporters.image_files import eight_bit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from taccel_lab.calibration.normals.read_surface import SurfaceReader
    from taccel_lab.profile import SensorProfile

LIKE = "like.png"
"""File of a press folder: photo, simulation and difference."""


@dataclass(frozen=True)
class PressPhoto:
    """A photo of a press, and the place and depth that it shows."""

    path: Path
    rgb: np.ndarray
    """Levels in the light of the background, float32, [height_px, width_px, 3]."""
    at_mm: tuple[float, float]
    """Gel x and y of the indenter's axis [mm]; as read, of the middle of what is pressed in."""
    depth_mm: float
    """Deepest place below the resting face [mm]."""
    at_sigma_mm: tuple[float, float] | None
    """Standard deviations of x and y [mm]; None where the profile states none."""
    depth_sigma_mm: float | None
    """Standard deviation of the depth; None where the profile states none."""
    warnings: tuple[str, ...]
    """What the reading says of itself, a sentence each."""
    seen: SeenPress = field(repr=False)
    """What is read in the photo itself."""
    reader: SurfaceReader = field(repr=False)

    @property
    def background(self) -> np.ndarray:
        """The untouched sensor, levels, [height_px, width_px, 3]."""
        return self.reader.background

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
        reading = reader.read(image, str(path))
        seen = SeenPress.of(reading, reader.grid)
        if seen is None:
            raise InputError(f"{path} shows {reading.depth_words}: there is no press to simulate")
        warnings = list(reading.figures(reader.grid)["warnings"])
        if not seen.whole:
            warnings.append("the contact reaches the image's border: its middle is not seen whole")
        return cls(
            path,
            reader.lit(image).levels,
            seen.at_mm,
            seen.depth_mm,
            seen.at_sigma_mm,
            seen.depth_sigma_mm,
            tuple(warnings),
            seen,
            reader,
        )

    def beside(
        self, image: np.ndarray, at_mm: tuple[float, float], depth_mm: float
    ) -> PressPhoto | None:
        """The photo with place and depth of a simulated press, as far off as its image reads.

        Both images are read alike, so that what readings are off by as a rule cancels: the networks
        and the integration, the rest of a curved gel, and the middle of a tool that is not its
        axis.

        Args:
            image: Of the simulated press, RGB levels, [height_px, width_px, 3].
            at_mm: Where it was pressed.
            depth_mm: And how deep.

        Returns:
            None where the simulated image shows no contact.
        """
        levels = self.simulated(image.astype(np.float32), self.reader.profile)
        lit = self.reader.lit(self.reader.in_own_light(levels))
        reading = self.reader.read_lit(lit, uncertainty=False)
        found = SeenPress.of(reading, self.reader.grid)
        if found is None:
            return None
        x, y = np.array(at_mm) + self.seen.at_mm - found.at_mm
        # By their ratio, as readings that are off are so by a share of the depth.
        depth_mm *= self.seen.depth_mm / found.depth_mm
        return replace(self, at_mm=(float(x), float(y)), depth_mm=depth_mm)

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
            "at_sigma_mm": self.at_sigma_mm,
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
