# SPDX-License-Identifier: Apache-2.0
"""The gel's surface from one tactile image, by whichever model a profile holds.

Colour sensors tell slopes, which are integrated; grey ones tell depths. Heights are in the gel
frame: the rise over the resting face, and the face itself, which is curved on some sensors.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np

from taccel_lab.calibration.dots.marker_picture import DotMask
from taccel_lab.calibration.light.fit import fit_light, fit_press_light
from taccel_lab.calibration.light.image_match import unlike
from taccel_lab.calibration.light.light import LightDrift
from taccel_lab.calibration.light.other_light import light_of_background
from taccel_lab.calibration.light.pattern_shift import pattern_shift
from taccel_lab.calibration.normals.light_errors import LightErrors, grey_light_sigma_mm
from taccel_lab.calibration.normals.touch import Touch, touch_of
from taccel_lab.calibration.result import NORMAL_95
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import SensorProfile
from taccel_lab.signals.depth_response import DepthResponse
from taccel_lab.signals.normal_model import NormalModel
from taccel_lab.signals.normals import normals_from_height
from taccel_lab.signals.read_heights import ReadHeights, read_heights
from taccel_lab.signals.rest_surface import RestSurface, rest_surface
from taccel_lab.summary import Summary
from taccel_lab.with_error import with_error

Method = Literal["auto", "normals", "depth"]
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


@dataclass(frozen=True)
class LitImage:
    """An image as it is read."""

    levels: np.ndarray
    """RGB levels in the profile's light, float32, shape [height_px, width_px, 3] of the grid."""
    light: LightDrift
    """Its own light against the untouched sensor's."""
    still: LightDrift
    """The same if nothing touches: a contact takes part of a gradient of the light."""
    mask: np.ndarray | None
    """Pixels that tell a slope, bool, [h, w]: those under dots do not; None for all."""


@dataclass(frozen=True, repr=False)
class SurfaceReading(Summary):
    """What one image shows."""

    height_m: np.ndarray
    """z of the contact face [m], gel frame, shape [height_px, width_px]."""
    rise_m: np.ndarray
    """Its rise over the resting face [m], negative in a dent."""
    height_sigma_m: np.ndarray | None
    """Standard deviation of both heights [m]. None of models that were fitted without synthetic
    presses, and of curves of earlier versions."""
    reading_sigma_m: np.ndarray | None
    """Standard deviation of a place if nothing touches [m], by the reading and the image's light:
    what is off along with a depth, such as the calibration's circles or scale, is not in it."""
    normals: np.ndarray
    """Outward unit normals, shape [height_px, width_px, 3]."""
    sigma_deg: np.ndarray | None
    """Standard deviation of each component of the tilt [degrees]; None of a grey sensor."""
    radius95_deg: np.ndarray | None
    """Angle within which 95 % of the true normals lie [degrees]; None of a grey sensor."""
    beyond_balls: np.ndarray | None
    """Pixels that read steeper than any captured ball was, bool: their slopes are what the colour
    model makes of colours that nobody captured. None of a grey sensor."""
    saturated: np.ndarray | None
    """Pixels darker than any that was calibrated, bool; None of a colour sensor."""
    method: Literal["normals", "depth"]
    touch: Touch
    """Where the gel is touched: the one decision that area, pressure and force follow."""
    sigma_of: SigmaOf | None = None
    """What ``height_sigma_m`` is that of: the absolute depth, or, with profiles of earlier versions
    that know no more, the reading alone; None where the profile tells none."""
    remarks: tuple[str, ...] = ()
    """What the profile says of itself, such as that it is of another unit."""

    def summary(self) -> tuple[str, list[tuple[str, str]]]:
        """How deep the gel is pressed, and by which model."""
        height, width = self.rise_m.shape
        return f"surface read from {self.method}", [
            ("deepest", self.depth_words),
            ("pixels", f"{width} x {height}"),
            *(("note", remark) for remark in self.remarks),
        ]

    @property
    def deepest_px(self) -> tuple[int, int]:
        """Row and column of the deepest place that is touched; of the image where nothing is."""
        depth = -self.rise_m
        if self.touch.any:
            depth = np.where(self.touch.pixels, depth, -np.inf)
        row, column = np.unravel_index(int(np.argmax(depth)), depth.shape)
        return int(row), int(column)

    @property
    def depth_interval_mm(self) -> tuple[float, float] | None:
        """95 % interval of the deepest place [mm], from 0 where nothing touches; None where the
        profile states no deviation."""
        if self.height_sigma_m is None:
            return None
        if not self.touch.any:
            return 0.0, self.touch.unseen_mm
        at = self.deepest_px
        depth, off = -1e3 * float(self.rise_m[at]), NORMAL_95 * 1e3 * float(self.height_sigma_m[at])
        return max(depth - off, 0.0), depth + off

    @property
    def depth_words(self) -> str:
        """Depth and its standard deviation, or that nothing touches, in words."""
        row, column = self.deepest_px
        if not self.touch.any:
            return f"no contact deeper than {self.touch.unseen_mm:.2g} mm"
        sigma_m = None if self.height_sigma_m is None else self.height_sigma_m[row, column]
        depth = with_error(
            -1e3 * self.rise_m[row, column], None if sigma_m is None else 1e3 * sigma_m
        )
        return f"{depth} mm at ({column}, {row}) px"

    def figures(self, grid: PixelGrid) -> dict[str, Any]:
        """Depth, place and size of what is pressed in, ready for JSON; ``grid`` is the maps'."""
        depth_mm = -1e3 * self.rise_m
        row, column = self.deepest_px
        touched = self.touch.pixels
        pixel_mm2 = grid.mm_per_px_x * grid.mm_per_px_y
        at_mm = grid.gel_from_pixel(np.array([column, row], dtype=float))
        found: dict[str, Any] = {
            "method": self.method,
            "touched": self.touch.any,
            "depth_words": self.depth_words,
            "max_depth_mm": float(depth_mm[row, column]) if self.touch.any else 0.0,
            "max_depth_interval95_mm": self.depth_interval_mm and list(self.depth_interval_mm),
            "max_depth_sigma_mm": None
            if self.height_sigma_m is None
            else float(1e3 * self.height_sigma_m[row, column]),
            "sigma_of": self.sigma_of,
            "deepest_px": [int(column), int(row)],
            "deepest_gel_mm": [float(at_mm[0]), float(at_mm[1])],
            "touched_mm2": float(touched.sum() * pixel_mm2),
            "touched_deeper_than_mm": self.touch.least_mm,
            "volume_mm3": float(depth_mm[touched].sum() * pixel_mm2),
        }
        inside = touched if touched.any() else np.ones_like(touched)
        if self.sigma_deg is not None:
            found["sigma_deg"] = float(self.sigma_deg[inside].mean())
        if self.radius95_deg is not None:
            found["radius95_deg"] = float(self.radius95_deg[inside].mean())
        if self.height_sigma_m is not None:
            found["depth_sigma_mm"] = float(1e3 * self.height_sigma_m[inside].mean())
        if self.beyond_balls is not None:
            found["beyond_balls_share"] = float(self.beyond_balls[inside].mean())
        if self.saturated is not None:
            found["saturated_share"] = float(self.saturated.mean())
        found["warnings"] = self._warnings(found)
        return found

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


class SurfaceReader:
    """Reads images of one sensor; what does not depend on the image is done once."""

    def __init__(
        self,
        profile: SensorProfile,
        *,
        background: np.ndarray | None = None,
        mask: np.ndarray | None = None,
        method: Method = "auto",
        background_name: str = "the background",
        device: str = "cpu",
    ) -> None:
        """A reader of the profile's images.

        Args:
            background: Untouched sensor instead of the profile's, RGB, shape [h, w, 3].
            mask: Pixels that count, bool, shape [height_px, width_px].
            method: ``normals`` or ``depth``; ``auto`` takes the block that the profile has.
            background_name: How an error calls ``background``, such as by its file.
            device: Of torch, on which colours are read to normals and heights.
        """
        self.profile, self.mask = profile, mask
        self.method = self._chosen(method)
        untouched = profile.untouched(background, background_name).astype(np.float32)
        self.grid = profile.grid()
        """Grid of the maps that are read."""
        self.untouched = untouched
        """The untouched sensor in its own light, float32 levels."""
        self._day = LightDrift(np.ones(3), np.zeros(3))
        if background is not None and profile.background_rgb is not None:
            known = profile.background_rgb.astype(np.float32)
            self._day = light_of_background(self.untouched, known, mask=None)
        self.background = self._day.remove(self.untouched).astype(np.float32)
        """The same in the profile's light, in which everything is read."""
        self.remarks = profile.sensor.provenance.remarks
        self.rest: RestSurface = rest_surface(profile.mesh, self.grid)
        self.normal_model = None
        if self.method == "normals":
            self.normal_model = NormalModel.from_profile(profile, device)
        self.response = DepthResponse.from_profile(profile) if self.method == "depth" else None
        self._last_sigma_m: np.ndarray | None = None
        self._dots = DotMask.of(self.untouched)

    @property
    def sigma_of(self) -> SigmaOf | None:
        """What the profile's standard deviations are those of (``SurfaceReading``)."""
        if self.response is not None:
            return None if self.response.reading_sigma_mm is None else "absolute depth"
        assert self.normal_model is not None
        config = self.normal_model.config
        if config.height_factor == 0:
            return None
        return "absolute depth" if config.depth_share > 0 else "reading alone"

    def _chosen(self, method: Method) -> Literal["normals", "depth"]:
        if method != "auto":
            return method
        if self.profile.normals is not None:
            return "normals"
        if self.profile.depth_response is not None:
            return "depth"
        raise InputError(
            f"the profile of {self.profile.sensor.name} has neither a normals nor a "
            "depth_response block; fit one with taccel-lab calibrate normals (colour sensors) or "
            "calibrate depth (grey ones)"
        )

    def read(self, image: np.ndarray, name: str = "image") -> SurfaceReading:
        """The surface under one image, RGB levels, shape [height_px, width_px, 3].

        Raises:
            InputError: Another size, an image that is not of this sensor, or one that reads deeper
                than the gel is thick.
        """
        if image.shape != self.untouched.shape:
            raise InputError(
                f"{name} is {image.shape[1]}x{image.shape[0]} px, the profile's camera "
                f"{self.untouched.shape[1]}x{self.untouched.shape[0]} px; give images of that "
                "size (raw ones are rectified with --maps)"
            )
        lit = self.lit(image)
        why = self._not_ours(image, lit)
        if why:
            raise InputError(f"{name} {why}")
        found = self.read_lit(lit)
        deepest_mm, gel_mm = -1e3 * float(found.rise_m.min()), self.profile.gel.thickness_mm
        if deepest_mm > gel_mm:
            raise InputError(
                f"{name} reads {deepest_mm:.1f} mm deep in a gel of {gel_mm:g} mm: its colours are "
                "not those that were calibrated"
            )
        if found.height_sigma_m is not None:
            sigma_mm = 1e3 * float(found.height_sigma_m[found.deepest_px])
            if sigma_mm > gel_mm:
                raise InputError(
                    f"{name} reads {deepest_mm:.1f} +- {sigma_mm:.1f} mm deep in a gel of "
                    f"{gel_mm:g} mm: the profile does not know its colours or its light"
                )
        return found

    def unlike(self, image: np.ndarray) -> str | None:
        """Why an image is not of the untouched sensor's gel, or None."""
        return self._not_ours(image, self.lit(image)) or None

    def _not_ours(self, image: np.ndarray, lit: LitImage) -> str:
        levels = image.astype(np.float32)
        why = unlike(levels, self.untouched, lit.light, lit.mask)
        if why is not None:
            return f"is no image of the sensor that was calibrated: {why}"
        # Dots go with the gel that a press drags along; only what else there is stands still.
        shift = pattern_shift(lit.light.remove(levels), self.untouched, lit.mask)
        if shift is None:
            return ""
        right, down = shift
        return (
            f"shows the untouched gel's pattern {right:+.0f} px to the right and {down:+.0f} px "
            "down of where the background has it: gel or camera has moved. Give an image of the "
            "untouched sensor as it is now (--background)"
        )

    def lit(self, image: np.ndarray) -> LitImage:
        """An image in the profile's light: gain, offset and gradient of each channel against the
        untouched sensor are taken off.

        The first look takes a contact for an outlier. Where it finds one, the gel has sunk beside
        it, and its light is fitted as that of a press.
        """
        levels = image.astype(np.float32)
        mask = self.mask if self._dots is None else self._dots.uncovered(levels, self.mask)

        still = fit_light(levels, self.untouched, mask)

        def shown(light: LightDrift) -> LitImage:
            own = self._day.remove(light.remove(levels))
            return LitImage(own.astype(np.float32), light, still, mask)

        first = shown(still)
        if not self._is_dented(first):
            return first
        return shown(fit_press_light(levels, self.untouched, mask))

    def in_own_light(self, levels: np.ndarray) -> np.ndarray:
        """An image in the profile's light as the untouched sensor's own light shows it."""
        return self._day.apply(levels)

    def _is_dented(self, lit: LitImage) -> bool:
        """Whether a coarse look at an image shows a contact."""
        if self.response is not None:
            rise_m = self.response.read(lit.levels, self.background, lit.mask).height_m
            return touch_of(rise_m, None, self.grid).any
        every = self._light_errors.every
        found = self._heights(lit, every=every)
        sigma_m = found.reading_sigma_m
        if sigma_m is not None:
            (light_m,) = self._light_errors.sigma_m([lit.still], found.zero, every)
            sigma_m = np.hypot(sigma_m, light_m)
        return touch_of(found.rise_m, sigma_m, self.grid.thinned(every)).any

    def read_lit(self, lit: LitImage, *, uncertainty: bool = True) -> SurfaceReading:
        """The surface under an image of ``lit``; without ``uncertainty`` the touch is decided by
        the standard deviations of the last image that had them."""
        if self.response is not None:
            return self._by_depth(lit)
        return self._by_normals(lit, uncertainty)

    def _by_depth(self, lit: LitImage) -> SurfaceReading:
        assert self.response is not None
        found = self.response.read(lit.levels, self.background, lit.mask)
        height = self.rest.height_m + found.height_m
        sigma_m, alone_m = _metres(found.sigma_mm), _metres(found.reading_sigma_mm)
        if sigma_m is not None and alone_m is not None:
            light_m = 1e-3 * grey_light_sigma_mm(
                self.response, lit.light, self.background, found.depth_mm
            )
            sigma_m, alone_m = np.hypot(sigma_m, light_m), np.hypot(alone_m, light_m)
        return SurfaceReading(
            height_m=height,
            rise_m=found.height_m,
            height_sigma_m=sigma_m,
            reading_sigma_m=alone_m,
            normals=normals_from_height(height, self.grid),
            sigma_deg=None,
            radius95_deg=None,
            beyond_balls=None,
            saturated=found.saturated,
            method="depth",
            touch=touch_of(found.height_m, alone_m, self.grid),
            sigma_of=self.sigma_of,
            remarks=self.remarks,
        )

    def _heights(self, lit: LitImage, *, uncertainty: bool = True, every: int = 1) -> ReadHeights:
        assert self.normal_model is not None
        return read_heights(
            self.normal_model,
            lit.levels,
            self.background,
            self.grid,
            mask=lit.mask,
            rest_normals=self._rest_normals,
            uncertainty=uncertainty,
            every=every,
        )

    def _by_normals(self, lit: LitImage, uncertainty: bool) -> SurfaceReading:
        assert self.normal_model is not None
        found = self._heights(lit, uncertainty=uncertainty)
        read = found.normals
        tilt_deg = np.degrees(np.linalg.norm(read.tilt_rad, axis=-1))
        sigma_m, alone_m = found.sigma_m, found.reading_sigma_m
        if sigma_m is not None and alone_m is not None:
            light_m, still_m = self._light_errors.sigma_m([lit.light, lit.still], found.zero)
            sigma_m, alone_m = np.hypot(sigma_m, light_m), np.hypot(alone_m, still_m)
            self._last_sigma_m = alone_m
        return SurfaceReading(
            height_m=self.rest.height_m + found.rise_m,
            rise_m=found.rise_m,
            height_sigma_m=sigma_m,
            reading_sigma_m=alone_m,
            normals=read.normals,
            sigma_deg=read.sigma_deg,
            radius95_deg=read.radius95_deg,
            beyond_balls=tilt_deg > self.normal_model.config.cone_deg,
            saturated=None,
            method="normals",
            touch=touch_of(found.rise_m, self._last_sigma_m, self.grid),
            sigma_of=self.sigma_of,
            remarks=self.remarks,
        )

    @property
    def _rest_normals(self) -> np.ndarray | None:
        return None if self.rest.is_flat else self.rest.normals

    @cached_property
    def _light_errors(self) -> LightErrors:
        assert self.normal_model is not None
        return LightErrors(
            self.normal_model, self.background, self.grid, self.mask, self._rest_normals
        )


def _metres(values_mm: np.ndarray | None) -> np.ndarray | None:
    return None if values_mm is None else 1e-3 * values_mm
