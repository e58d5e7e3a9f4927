# SPDX-License-Identifier: Apache-2.0
"""The gel's surface from one tactile image, by whichever model a profile holds.

Colour sensors tell slopes, which are integrated; grey ones tell depths. Heights are in the gel
frame: the rise over the resting face, and the face itself, which is curved on some sensors.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from taccel_lab.calibration.light.drift_choice import DriftMode
from taccel_lab.calibration.light.fit import fit_light
from taccel_lab.calibration.light.image_match import unlike
from taccel_lab.calibration.light.light import LightDrift
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import SensorProfile
from taccel_lab.signals.depth_response import DepthResponse
from taccel_lab.signals.normal_model import NormalModel
from taccel_lab.signals.normals import normals_from_height
from taccel_lab.signals.read_heights import BAND_SIGMAS, read_heights
from taccel_lab.signals.rest_surface import RestSurface, rest_surface
from taccel_lab.summary import Summary

MOSTLY = 0.5
"""Share of a larger pixel that has to count."""
LEAST_LIGHT_LEVELS = 4.0
"""A change of light below this is left in, whatever the calibration saw: contacts shift the fit of
the light by as much."""
UNKNOWN_LIGHT_LEVELS = 8.0
"""Largest change of light left in where a profile does not say how much its frames had. Presses of
four sensors that are read as they are have 0.7 to 6.7."""
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
CONTACT_MM = 0.05
CONTACT_SHARE = 0.1
"""Pixels pressed deeper than this, than this share of the deepest one and than the height is
uncertain count as touched."""


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
    """That of the reading alone [m], which tells places of one image apart: what all depths are off
    by alike, such as the calibration's circles, scale or zero, is not in it."""
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
    drift_removed: bool
    sigma_of: SigmaOf | None = None
    """What ``height_sigma_m`` is that of: the absolute depth, or, with profiles of earlier versions
    that know no more, the reading alone; None where the profile tells none."""
    remarks: tuple[str, ...] = ()
    """What the profile says of itself, such as that it is of another unit."""

    def summary(self) -> tuple[str, list[tuple[str, str]]]:
        """How deep the gel is pressed, and by which model."""
        deepest = np.unravel_index(int(np.argmin(self.rise_m)), self.rise_m.shape)
        depth = f"{-1e3 * self.rise_m[deepest]:.4g}"
        if self.height_sigma_m is not None:
            depth += f" +- {1e3 * self.height_sigma_m[deepest]:.2g}"
        height, width = self.rise_m.shape
        light = "taken off" if self.drift_removed else "as it is"
        return f"surface read from {self.method}", [
            ("deepest", f"{depth} mm at ({deepest[1]}, {deepest[0]}) px"),
            ("pixels", f"{width} x {height}"),
            ("light", light),
            *(("note", remark) for remark in self.remarks),
        ]

    def figures(self, grid: PixelGrid) -> dict[str, Any]:
        """Depth, place and size of what is pressed in, ready for JSON; ``grid`` is the maps'."""
        depth_mm = -1e3 * self.rise_m
        row, column = np.unravel_index(int(np.argmax(depth_mm)), depth_mm.shape)
        touched, least_mm = pressed_in(self.rise_m, self.reading_sigma_m)
        pixel_mm2 = grid.mm_per_px_x * grid.mm_per_px_y
        at_mm = grid.gel_from_pixel(np.array([column, row], dtype=float))
        found: dict[str, Any] = {
            "method": self.method,
            "light_drift_removed": self.drift_removed,
            "max_depth_mm": float(depth_mm[row, column]),
            "max_depth_sigma_mm": None
            if self.height_sigma_m is None
            else float(1e3 * self.height_sigma_m[row, column]),
            "sigma_of": self.sigma_of,
            "deepest_px": [int(column), int(row)],
            "deepest_gel_mm": [float(at_mm[0]), float(at_mm[1])],
            "touched_mm2": float(touched.sum() * pixel_mm2),
            "touched_deeper_than_mm": least_mm,
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
        drift: DriftMode = "auto",
        background_name: str = "the background",
        shrink: int = 1,
    ) -> None:
        """A reader of the profile's images.

        Args:
            background: Untouched sensor instead of the profile's, RGB, shape [h, w, 3].
            mask: Pixels that count, bool, shape [height_px, width_px].
            method: ``normals`` or ``depth``; ``auto`` takes the block that the profile has.
            drift: Whether each image is brought to the background's light first; ``auto`` does as
                in the calibration, and does it for colours whose light lies beyond the calibrated.
            background_name: How an error calls ``background``, such as by its file.
            shrink: Images are made smaller by about this factor before they are read, and so are
                the maps (``grid``): a live picture at 3 takes a sixth of the time.
        """
        self.profile, self.mask = profile, mask
        self.method = self._chosen(method)
        self.background = profile.untouched(background, background_name).astype(np.float32)
        grid = profile.grid()
        self._image_shape = self.background.shape
        self.grid = grid if shrink == 1 else _smaller(grid, shrink)
        """Of the maps that are read."""
        # A larger pixel is the mean of several: fewer of them tell the light as well.
        self._light_step = 1 if shrink == 1 else 2
        self.background = self._small(self.background)
        if mask is not None and shrink > 1:
            self.mask = self._small(mask.astype(np.float32)) > MOSTLY
        self.remarks = profile.sensor.provenance.remarks
        self.rest: RestSurface = rest_surface(profile.mesh, self.grid)
        self.normal_model = NormalModel.from_profile(profile) if self.method == "normals" else None
        if self.normal_model is not None and shrink > 1:
            self.normal_model = _shrunk(self.normal_model, self.grid)
        self.response = DepthResponse.from_profile(profile) if self.method == "depth" else None
        self.drift = drift == "on"
        self._light_limit = np.full(3, np.inf)
        if drift == "auto" and self.normal_model is not None:
            self.drift = self.normal_model.config.light_drift
            self._light_limit = _light_limit(profile)

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
        if image.shape != self._image_shape:
            raise InputError(
                f"{name} is {image.shape[1]}x{image.shape[0]} px, the profile's camera "
                f"{self._image_shape[1]}x{self._image_shape[0]} px; give images of that "
                "size (raw ones are rectified with --maps)"
            )
        levels = self._small(image).astype(np.float32)
        light = self._light(levels)
        why = unlike(levels, self.background, light, self.mask)
        if why is not None:
            raise InputError(f"{name} is no image of the sensor that was calibrated: {why}")
        removed = self._is_removed(light)
        levels = light.remove(levels).astype(np.float32) if removed else levels
        found = replace(self.read_levels(levels), drift_removed=removed)
        deepest_mm, gel_mm = -1e3 * float(found.rise_m.min()), self.profile.gel.thickness_mm
        if deepest_mm > gel_mm:
            raise InputError(
                f"{name} reads {deepest_mm:.1f} mm deep in a gel of {gel_mm:g} mm: its colours are "
                "not those that were calibrated"
            )
        return found

    def unlike(self, image: np.ndarray) -> str | None:
        """Why an image is not of the profile's sensor, or None; see ``light.image_match``."""
        levels = self._small(image).astype(np.float32)
        return unlike(levels, self.background, self._light(levels), self.mask)

    def in_own_light(self, image: np.ndarray) -> np.ndarray:
        """The image as small as it is read, in the background's light where that is requested, or
        where its own was never calibrated; float32, shape [height_px, width_px, 3] of ``grid``."""
        levels = self._small(image).astype(np.float32)
        light = self._light(levels)
        return light.remove(levels).astype(np.float32) if self._is_removed(light) else levels

    def _is_removed(self, light: LightDrift) -> bool:
        if self.drift:
            return True
        level = self.background.reshape(-1, 3).mean(axis=0)
        return bool((np.abs(light.shift(level)) > self._light_limit).any())

    def _light(self, levels: np.ndarray) -> LightDrift:
        part = np.s_[:: self._light_step, :: self._light_step]
        mask = None if self.mask is None else self.mask[part]
        return fit_light(levels[part], self.background[part], mask, gradient=False)

    def read_levels(self, levels: np.ndarray, *, uncertainty: bool = True) -> SurfaceReading:
        """The surface under what ``in_own_light`` made of an image; ``uncertainty`` as in
        ``read_heights``."""
        if self.response is not None:
            return self._by_depth(levels)
        return self._by_normals(levels, uncertainty)

    def _small(self, image: np.ndarray) -> np.ndarray:
        import cv2

        size = (self.grid.width_px, self.grid.height_px)
        if image.shape[1::-1] == size:
            return image
        return cv2.resize(image, size, interpolation=cv2.INTER_AREA)

    def _by_depth(self, levels: np.ndarray) -> SurfaceReading:
        assert self.response is not None
        found = self.response.read(levels, self.background, self.mask)
        height = self.rest.height_m + found.height_m
        return SurfaceReading(
            height_m=height,
            rise_m=found.height_m,
            height_sigma_m=_metres(found.sigma_mm),
            reading_sigma_m=_metres(found.reading_sigma_mm),
            normals=normals_from_height(height, self.grid),
            sigma_deg=None,
            radius95_deg=None,
            beyond_balls=None,
            saturated=found.saturated,
            method="depth",
            drift_removed=self.drift,
            sigma_of=self.sigma_of,
            remarks=self.remarks,
        )

    def _by_normals(self, levels: np.ndarray, uncertainty: bool) -> SurfaceReading:
        assert self.normal_model is not None
        found = read_heights(
            self.normal_model,
            levels,
            self.background,
            self.grid,
            mask=self.mask,
            rest_normals=None if self.rest.is_flat else self.rest.normals,
            uncertainty=uncertainty,
        )
        read = found.normals
        tilt_deg = np.degrees(np.linalg.norm(read.tilt_rad, axis=-1))
        return SurfaceReading(
            height_m=self.rest.height_m + found.rise_m,
            rise_m=found.rise_m,
            height_sigma_m=found.sigma_m,
            reading_sigma_m=found.reading_sigma_m,
            normals=read.normals,
            sigma_deg=read.sigma_deg,
            radius95_deg=read.radius95_deg,
            beyond_balls=tilt_deg > self.normal_model.config.cone_deg,
            saturated=None,
            method="normals",
            drift_removed=self.drift,
            sigma_of=self.sigma_of,
            remarks=self.remarks,
        )


def pressed_in(rise_m: np.ndarray, reading_sigma_m: np.ndarray | None) -> tuple[np.ndarray, float]:
    """Pixels that count as touched, bool, shape [h, w], and the least depth of any [mm]."""
    depth_mm = -1e3 * rise_m
    least_mm = max(CONTACT_MM, CONTACT_SHARE * float(depth_mm.max()))
    touched = depth_mm > least_mm
    if reading_sigma_m is not None:
        touched &= depth_mm > 1e3 * BAND_SIGMAS * reading_sigma_m
    return touched, least_mm


def _light_limit(profile: SensorProfile) -> np.ndarray:
    """Change of each channel's mean level [levels], shape [3], beyond which an image's light is
    none that the calibration saw: its colours would be read as slopes. Three standard deviations of
    the unit's frames where the profile has them."""
    known = profile.perturbation
    if known is None or not any(known.offset_rgb):
        return np.full(3, UNKNOWN_LIGHT_LEVELS)
    return np.maximum(3 * np.array(known.offset_rgb), LEAST_LIGHT_LEVELS)


def _metres(values_mm: np.ndarray | None) -> np.ndarray | None:
    return None if values_mm is None else 1e-3 * values_mm


def _shrunk(model: NormalModel, grid: PixelGrid) -> NormalModel:
    """The model for images of fewer pixels: its windows shrink along and see what they saw, as in
    training on other zooms."""
    config = model.config
    factor = config.width_px / grid.width_px
    smaller = replace(
        config,
        width_px=grid.width_px,
        height_px=grid.height_px,
        scales_px=tuple(scale / factor for scale in config.scales_px),
        slope_scales_px=tuple(scale / factor for scale in config.slope_scales_px),
        error_length_px=config.error_length_px / factor,
    )
    return NormalModel(smaller, model.weights)


def _smaller(grid: PixelGrid, factor: int) -> PixelGrid:
    """The same view in fewer pixels, as many as cosine transforms are fast at."""
    from scipy.fft import next_fast_len

    width = int(next_fast_len(round(grid.width_px / factor), real=True) or 0)
    height = int(next_fast_len(round(grid.height_px / factor), real=True) or 0)
    return grid.resized(width, height)
