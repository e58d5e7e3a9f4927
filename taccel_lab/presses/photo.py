# SPDX-License-Identifier: Apache-2.0
"""The press that a photo shows: found by reading the photo, to be simulated and set beside it.

What one reading of a photo says of place and depth is off by what readings are off by. So the press
is simulated roughly there, its image is read like the photo, and place and depth are corrected by
the difference, until that is small beside what the photo leaves open.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import eight_bit
from taccel_lab.optics.image_measures import crop_slices, psnr_db

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from taccel_lab.profile import SensorProfile
    from taccel_lab.reading.reader import Reader
    from taccel_lab.reading.reading import Reading

PhotoReader = Callable[["SensorProfile", Path, Path | None], "Reader"]
"""Reader of a photo, for its profile and the untouched image that a person gave."""
LIKE = "like.png"
"""File of a press folder: photo, simulation and difference."""
_CORE = 0.5
"""Share of the deepest place above which the gel follows the indenter: its middle is the press's.
The gel's slope around it would draw the middle towards the side with more gel."""
_LEFT_OF_CORRECTION = 1 / 3
"""Part of the last correction that is left, at most."""
_AROUND = 0.2
"""Part of the deepest place from which on pixels are compared."""
_SHOWN = 0.5
"""Part of a depth's smooth error that is seen around it, where both deepest places are as deep."""
_CURVED_TO = 0.5
"""Part of a curved gel's lean that is uncertain. A tool touches a slope beside its axis, where it
comes straight down; presses on a GelSight's dome are found up to half of that from the contacts
that a person marked."""


@dataclass(frozen=True)
class SeenPress:
    """The middle of what is pressed in, and how deep it is."""

    at_mm: tuple[float, float]
    """Gel x and y [mm] of the middle of the dent's core, weighed by depth."""
    depth_mm: float
    """Deepest place below the resting face [mm]."""
    at_error_mm: tuple[float, float] | None
    """Standard deviations of x and y; None where the profile states none of heights."""
    depth_error_mm: float | None
    """Standard deviation of the depth; None likewise."""
    whole: bool
    """Whether the image shows all of the core."""
    alone_mm: float = 0.0
    """Standard deviation of the depth by the reading alone; 0 where none is known."""

    @classmethod
    def of(cls, reading: Reading) -> SeenPress | None:
        """The deepest press of a reading; None where nothing touches.

        Errors of heights are smooth, and move the middle most where they lean: those of the place
        are what it moves by if the dent leans by one deviation of the reading from its middle to
        its rim, twice the standard deviation of the core's pixels, and by a part of the gel's own
        lean at rest.
        """
        touched = reading.touch.pixels
        if not touched.any():
            return None
        depth_mm = 1e3 * reading.depth_m
        core, middle_px = _core(depth_mm, touched)
        middle = reading.grid.gel_from_pixel(middle_px)
        at_sigma, depth_sigma, alone_mm = None, None, 0.0
        if reading.height_sigma_m is not None and reading.reading_sigma_m is not None:
            depth_sigma = reading.depth_error_mm
            alone_mm = 1e3 * float(reading.reading_sigma_m[reading.deepest_px])
            at_sigma = _place_sigma(reading, depth_mm, core)
        edge = np.concatenate([core[0], core[-1], core[:, 0], core[:, -1]])
        x, y = middle
        at_mm, whole = (float(x), float(y)), not edge.any()
        return cls(at_mm, reading.depth_mm, at_sigma, depth_sigma, whole, alone_mm)


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
    at_error_mm: tuple[float, float] | None
    """Standard deviations of x and y [mm]; None where the profile states none."""
    depth_error_mm: float | None
    """Standard deviation of the depth; None where the profile states none."""
    warnings: tuple[str, ...]
    """What the reading says of itself, a sentence each."""
    seen: SeenPress = field(repr=False)
    """What is read in the photo itself."""
    read_depth_mm: np.ndarray = field(repr=False)
    """Depth below the resting face as read, at each pixel [mm], [height_px, width_px]."""
    reader: Reader = field(repr=False)

    @property
    def background(self) -> np.ndarray:
        """The untouched sensor, levels, [height_px, width_px, 3]."""
        return self.reader.background

    @classmethod
    def read(
        cls, profile: SensorProfile, path: Path, untouched: Path | None, reader_of: PhotoReader
    ) -> PressPhoto:
        """Find the press in an image.

        Args:
            profile: With colours, to simulate them, and with normals or depths, to read them.
            path: The image.
            untouched: Image of the untouched sensor in place of the profile's.
            reader_of: Finds what the image is read against.

        Raises:
            InputError: A profile without these blocks, an image of another sensor, no contact, a
                starter profile without an untouched image.
        """
        from taccel_lab.files.images import read_image

        if profile.color is None or profile.background_rgb is None:
            raise InputError(
                f"{path} cannot be compared with a press: the profile of {profile.sensor.name} has "
                "no colours; calibrate them first"
            )
        image = read_image(path)
        reader = reader_of(profile, path, untouched)
        reading = reader.read(image, str(path))
        seen = SeenPress.of(reading)
        if seen is None:
            raise InputError(f"{path} shows {reading.depth_words}: there is no press to simulate")
        warnings = list(reading.figures()["warnings"])
        if not seen.whole:
            warnings.append("the contact reaches the image's border: its middle is less certain")
        return cls(
            path,
            reader.with_dots(reader.lit(image)),
            seen.at_mm,
            seen.depth_mm,
            seen.at_error_mm,
            seen.depth_error_mm,
            tuple(warnings),
            seen,
            1e3 * reading.depth_m,
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
        reading = self.reader.surface(lit)
        found = SeenPress.of(reading)
        if found is None:
            return None
        x, y = np.array(at_mm) + self.seen.at_mm - found.at_mm
        # By their ratio, as readings that are off are so by a share of the depth.
        ratio = self.seen.depth_mm / found.depth_mm
        here, there = (np.array(each.at_mm) for each in (self.seen, found))
        moved_px = reading.grid.pixel_from_gel(here) - reading.grid.pixel_from_gel(there)
        left_mm = self._left_mm(ratio * 1e3 * reading.depth_m, moved_px)
        left_mm = math.hypot(left_mm, _LEFT_OF_CORRECTION * (ratio - 1.0) * depth_mm)
        depth_mm *= ratio
        return replace(
            self,
            at_mm=(float(x), float(y)),
            depth_mm=depth_mm,
            depth_error_mm=self._sigma_mm(left_mm, depth_mm),
        )

    def _left_mm(self, depth_mm: np.ndarray, moved_px: np.ndarray) -> float:
        """How far a depth may be off where the photo still reads other than a simulated press,
        whose depths are as deep, ``moved_px`` (columns, rows) beside it."""
        from scipy import ndimage

        shown = ndimage.shift(depth_mm, moved_px[::-1], order=1, mode="nearest")
        around = np.maximum(shown, self.read_depth_mm) > _AROUND * self.seen.depth_mm
        return float(np.sqrt(np.mean((shown - self.read_depth_mm)[around] ** 2))) / _SHOWN

    def _sigma_mm(self, left_mm: float, depth_mm: float) -> float | None:
        """Standard deviation of a corrected depth: what closing the loop left, both readings'
        noise, and what all readings are off by alike; that of one reading at most."""
        read_mm, share = self.seen.depth_error_mm, _common_share(self.reader)
        if read_mm is None or share is None:
            return read_mm
        noise_mm = math.sqrt(2) * self.seen.alone_mm
        return min(math.hypot(left_mm, noise_mm, share * depth_mm), read_mm)

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
        grid = profile.grid()
        u, v = grid.pixel_from_gel(np.array(self.at_mm))
        pixels = max(int(contact.sum()), 1)
        radius_px = float(np.sqrt(pixels * grid.mm_per_px_y / grid.mm_per_px_x / np.pi))
        crop = crop_slices((float(u), float(v)), radius_px, grid)
        seen, shown = self.rgb[crop], self.simulated(painted, profile)[crop]
        rest = self.background[crop]
        return {
            "photo": str(self.path),
            "at_mm": self.at_mm,
            "at_error_mm": self.at_error_mm,
            "depth_mm": self.depth_mm,
            "depth_error_mm": self.depth_error_mm,
            "psnr_db": psnr_db(shown, seen),
            "untouched_psnr_db": psnr_db(rest, seen),
            "mean_error_levels": float(np.abs(shown - seen).mean()),
            "untouched_error_levels": float(np.abs(rest - seen).mean()),
            "warnings": list(self.warnings),
        }

    def draw(self, simulated: np.ndarray, profile: SensorProfile, psnr_db: float) -> Figure:
        """Photo, simulation and their difference side by side, over the gel."""
        from taccel_lab.report.figures import draw_comparison

        return draw_comparison(eight_bit(self.rgb), eight_bit(simulated), profile.grid(), psnr_db)


def _common_share(reader: Reader) -> float | None:
    """Standard deviation of what all readings of a profile are off by alike, over the depth; None
    where the profile does not know it."""
    if reader.sigma_of != "absolute depth":
        return None
    if reader.response is not None:
        return reader.response.depth_share
    assert reader.normal_model is not None
    config = reader.normal_model.config
    return math.hypot(config.depth_share, config.unit_share)


def _core(depth_mm: np.ndarray, touched: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels around the deepest of those that are touched, bool, and their middle [px], [2]."""
    from scipy import ndimage

    deepest = int(np.where(touched, depth_mm, -np.inf).argmax())
    parts, _ = ndimage.label(depth_mm > _CORE * depth_mm.ravel()[deepest])  # type: ignore[misc]
    core = parts == parts.ravel()[deepest]
    return core, np.array(ndimage.center_of_mass(depth_mm * core)[::-1])


def _place_sigma(reading: Reading, depth_mm: np.ndarray, core: np.ndarray) -> tuple[float, float]:
    """How far the middle moves in x and y [mm] where the dent leans along each."""
    assert reading.reading_sigma_m is not None
    sigma_mm = 1e3 * float(reading.reading_sigma_m[core].mean())
    rest_mm = 1e3 * (reading.height_m + reading.depth_m)
    touched, grid = reading.touch.pixels, reading.grid
    middle = _core(depth_mm, touched)[1]
    found = []
    for axis, step_mm in enumerate((grid.mm_per_px_x, grid.mm_per_px_y)):
        places = np.indices(core.shape)[1 - axis]
        rim_px = max(2 * float(places[core].std()), 1.0)
        own_mm = rim_px * float(np.gradient(rest_mm, axis=1 - axis)[core].mean())
        lean_mm = np.hypot(sigma_mm, _CURVED_TO * own_mm)
        leaning = depth_mm + lean_mm * (places - middle[axis]) / rim_px
        found.append(step_mm * abs(float(_core(leaning, touched)[1][axis] - middle[axis])))
    return found[0], found[1]
