# SPDX-License-Identifier: Apache-2.0
"""Images of one sensor in, readings out, by whichever model a profile holds.

The stages of a photo, in their order: frame, light, touch, heights, deviations, pressure.

Colour sensors tell slopes, which are integrated; grey ones tell depths. Heights are in the gel
frame: the rise over the resting face, and the face itself, which is curved on some sensors.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property, partial
from typing import Any, Literal

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.profile import SensorProfile
from taccel_lab.reading.blocks import LARGEST_PX, finest_px
from taccel_lab.reading.colour_specks import colour_specks
from taccel_lab.reading.deviations import LightErrors, grey_light_sigma_mm, together
from taccel_lab.reading.directions import directions_of_blocks, directions_of_heights
from taccel_lab.reading.faded_light import (
    FADED,
    FEIGNED_SHARE,
    MAYBE_FADED,
    FadedLight,
    faded_light,
)
from taccel_lab.reading.features import of_blocks
from taccel_lab.reading.frame_judge import FrameJudge, JudgedFrame
from taccel_lab.reading.grey import GreyDepths, about_specks, grey_depths
from taccel_lab.reading.heights import ReadHeights, read_heights, with_deviations
from taccel_lab.reading.light import LightDrift
from taccel_lab.reading.lit_image import LitImage
from taccel_lab.reading.on_pixels import on_pixels, repeated
from taccel_lab.reading.pressure import PressureReader
from taccel_lab.reading.reading import Reading, SigmaOf
from taccel_lab.reading.rest import RestingPart, resting_part
from taccel_lab.reading.slopes import NormalModel
from taccel_lab.reading.stage_clock import StageClock
from taccel_lab.reading.touch import Touch, likely_touched, touch_of
from taccel_lab.reading.whose import light_of_background
from taccel_lab.signals.depth_response import DepthResponse
from taccel_lab.signals.rest_surface import RestSurface, rest_surface

Method = Literal["auto", "normals", "depth"]
GUESSED_SHARE = 0.5
"""Part of what is touched beyond the calibration from which no depth is given."""
AROUND_BLOCKS = 2
"""Blocks beside those that may be touched that are read pixel by pixel, too: rims bend."""


class Reader:
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
        self.profile = profile
        self.mask = None if mask is None or mask.all() else mask
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
            height, width = self.untouched.shape[:2]
            if min(height, width) <= LARGEST_PX:
                raise InputError(
                    f"the camera of {profile.sensor.name} has {width}x{height} px; slopes are read "
                    f"from images of more than {LARGEST_PX}x{LARGEST_PX} px"
                )
            self.normal_model = NormalModel.from_profile(profile, device)
        self.response = DepthResponse.from_profile(profile) if self.method == "depth" else None
        self.judge = FrameJudge(self.untouched, self.mask)
        """Tells frames that are not to be read, and their light."""
        self._bare = self.background
        if self.judge.dots is not None:
            self._bare = self._day.remove(self.judge.bare).astype(np.float32)
        blur_px = 0.0 if self.normal_model is None else self.normal_model.config.blur_px
        self.no_press, self._pressure = "", None
        """Why no pressure is read, a sentence."""
        try:
            self._pressure = PressureReader(profile, self.grid, self.rest, blur_px)
        except InputError as error:
            self.no_press = str(error)
        self.clock = StageClock()
        """Times of the stages of the last image."""

    @property
    def sigma_of(self) -> SigmaOf | None:
        """What the profile's standard deviations are those of (``Reading``)."""
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

    def read(self, image: np.ndarray, name: str = "image", time_s: float | None = None) -> Reading:
        """The touch that one image shows.

        Args:
            image: RGB levels, shape [height_px, width_px, 3].
            name: How errors call it, and its files.
            time_s: When it was taken [s], for a gel that relaxes; None where it does not follow the
                image before.

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
        self.clock.restart()
        self.clock.begin("frame")
        frame = self.judge.frame(image)
        _refuse(name, frame.fault())
        lit = self.lit(frame)
        _refuse(name, frame.foreign(lit.light))
        found = self.pressed(self._credible(self.surface(lit, name)), time_s)
        self.clock.begin()
        return found

    def _credible(self, found: Reading) -> Reading:
        """The reading; InputError where it is deeper than the gel is thick, or may be."""
        deepest_mm, gel_mm = 1e3 * float(found.depth_m.max()), self.profile.gel.thickness_mm
        if deepest_mm > gel_mm:
            raise InputError(
                f"{found.name} reads {deepest_mm:.1f} mm deep in a gel of {gel_mm:g} mm: its "
                "colours are not those that were calibrated"
            )
        sigma_mm = found.depth_error_mm or 0.0
        if sigma_mm > gel_mm:
            raise InputError(
                f"{found.name} reads {deepest_mm:.1f} +- {sigma_mm:.1f} mm deep in a gel of "
                f"{gel_mm:g} mm: the profile does not know its colours or its light"
            )
        return found

    def lit(self, image: np.ndarray | JudgedFrame, *, dirty: bool = True) -> LitImage:
        """An image in the profile's light: gain, offset and gradient of each channel against the
        untouched sensor are taken off.

        The first look takes a contact for an outlier. Where it finds one, the gel has sunk beside
        it, and its light is fitted as that of a press. Where it finds specks, or light that has
        faded as beside no press, which is not asked of what is not ``dirty``, they are taken off.
        """
        self.clock.begin("light")
        frame = self.judge.frame(image) if isinstance(image, np.ndarray) else image
        even, remark = frame, ""
        common = frame.corners if self.normal_model is None else frame.common
        if common is not None:
            steady = frame.still.remove(frame.levels) / common.factor
            even, remark = frame.with_levels(frame.still.apply(steady)), common.remark

        def shown(light: LightDrift, **seen: Any) -> LitImage:
            levels = light.on(self._day).removed(even.levels)
            return LitImage(frame, levels, light, even.still, remark=remark, **seen)

        first = shown(even.still)
        self.clock.begin("touch")
        if self.response is not None:
            grey = self._grey(first)
            touch = touch_of(grey.depths.height_m, _metres(grey.depths.reading_sigma_mm), self.grid)
            if not touch.any:
                return replace(first, seen=grey)
            faded = self._faded(grey, touch)
            if dirty and faded is not None and faded.is_sure:
                clear = frame.levels / faded.factor(self.response, self._bare)
                return replace(self.lit(frame.with_levels(clear), dirty=False), dirt=FADED)
            self.clock.begin("light")
            return shown(even.pressed, feigned=0.0 if faded is None else FEIGNED_SHARE)
        dented, around, rest, seen = self._look(first)
        if dirty and around is not None and around.any():
            factor, pixel_mm = None if common is None else common.factor, self.grid.mm_per_px_x
            thick_mm = self.profile.gel.thickness_mm
            specks = colour_specks(first.levels, self._bare, factor, around, pixel_mm, thick_mm)
            if specks is not None:
                clean = self.lit(frame.without(specks), dirty=False)
                return replace(clean, dirt=about_specks(specks, pixel_mm))
        if not dented:
            return replace(first, around=around, seen=seen)
        self.clock.begin("light")
        return shown(even.pressed, around=around, rest=rest)

    def in_own_light(self, levels: np.ndarray) -> np.ndarray:
        """An image in the profile's light as the untouched sensor's own light shows it."""
        return self._day.apply(levels)

    def with_dots(self, lit: LitImage) -> np.ndarray:
        """Levels of an image in the profile's light, [height_px, width_px, 3], and its dots."""
        if self.judge.dots is None:
            return lit.levels
        shown = lit.light.on(self._day).removed(lit.frame.image.astype(np.float32))
        return (
            shown
            if lit.frame.seen is None
            else np.where(lit.frame.seen[..., None], lit.levels, shown)
        )

    def _look(
        self, lit: LitImage
    ) -> tuple[bool, np.ndarray | None, RestingPart | None, ReadHeights | None]:
        """Whether a coarse look at an image shows a contact, the blocks where one may be and those
        at rest (``LitImage``), and what it saw where there is none."""
        found = self._heights(lit, LARGEST_PX)
        sigma_m = found.reading_sigma_m
        if sigma_m is not None:
            (light_m,) = self._light_errors.sigma_m([lit.still], found.zero, LARGEST_PX)
            sigma_m = together(sigma_m, light_m)
        dented = touch_of(found.rise_m, sigma_m, self.grid.thinned(LARGEST_PX)).any
        around = likely_touched(found.rise_m, sigma_m, AROUND_BLOCKS)
        rest = self._rest_of(found)
        if rest is not None:
            return True, around | rest.rims, rest, None
        return dented, around, None, None if around.any() else found

    def _rest_of(self, found: ReadHeights) -> RestingPart | None:
        """The part of an image that its heights are counted from, by a coarse look at it."""
        grid = self.grid.thinned(LARGEST_PX)
        counted = self._counted(LARGEST_PX)
        tilt_deg = np.degrees(np.hypot(*np.moveaxis(found.normals.tilt_rad, -1, 0)))
        layer = None if self._pressure is None else self._pressure.layer
        return resting_part(tilt_deg, np.asarray(found.slope), grid, layer, counted)

    def _counted(self, block_px: int) -> np.ndarray | None:
        """Blocks of so many pixels that count, bool, [h, w]; None for all."""
        return None if self.mask is None else of_blocks(self.mask, block_px) > 0.5

    def surface(self, lit: LitImage, name: str = "image") -> Reading:
        """The surface under an image of ``lit``, without the pressure that holds it."""
        self.clock.begin("heights")
        return self._by_normals(lit, name) if self.response is None else self._by_depth(lit, name)

    def pressed(self, found: Reading, time_s: float | None = None) -> Reading:
        """A surface with the pressure that holds it; ``time_s`` as of ``read``."""
        if self._pressure is None:
            return found
        self.clock.begin("pressure")
        press = self._pressure.read(
            -found.depth_m, found.touch, found.height_sigma_m, found.reading_sigma_m, time_s
        )
        return replace(found, press=press)

    def _by_depth(self, lit: LitImage, name: str) -> Reading:
        assert self.response is not None
        grey = lit.seen if isinstance(lit.seen, GreyDepths) else self._grey(lit)
        found = grey.depths
        sigma_m, alone_m = _metres(found.sigma_mm), _metres(found.reading_sigma_mm)
        if sigma_m is not None and alone_m is not None:
            light_m = 1e-3 * grey_light_sigma_mm(
                self.response, lit.light, self.background, found.depth_mm
            )
            sigma_m, alone_m = together(sigma_m, light_m), together(alone_m, light_m)
        touch = touch_of(found.height_m, alone_m, self.grid)
        said = grey.remark
        if lit.feigned and touch.any and sigma_m is not None and alone_m is not None:
            said = " ".join((said, MAYBE_FADED)).strip()
            feigned_m = -lit.feigned * found.height_m
            sigma_m, alone_m = together(sigma_m, feigned_m), together(alone_m, feigned_m)
        face_m = self.rest.height_m + found.height_m
        return self._reading(
            lit, name, found.height_m, sigma_m, alone_m,
            method="depth",
            said=said,
            touch=touch,
            directions=partial(directions_of_heights, face_m, self.grid),
            saturated=found.saturated,
        )  # fmt: skip

    def _grey(self, lit: LitImage) -> GreyDepths:
        assert self.response is not None
        thick_mm = self.profile.gel.thickness_mm
        return grey_depths(self.response, lit.levels, self._bare, self.grid, thick_mm, self.mask)

    def _faded(self, grey: GreyDepths, touch: Touch) -> FadedLight | None:
        """Light that may have faded where a touch is seen; None of a dome, whose law is another."""
        if self._pressure is None or self.response is None:
            return None
        given = grey.depths, grey.drop, touch.pixels, self.grid
        return faded_light(self.response, *given, self._pressure.layer)

    def _heights(self, lit: LitImage, every: int, *, uncertainty: bool = True) -> ReadHeights:
        assert self.normal_model is not None
        return read_heights(
            self.normal_model,
            lit.levels,
            self._bare,
            self.grid,
            mask=self.mask,
            rest_normals=self._rest_normals,
            around=lit.around,
            resting=None if lit.rest is None else lit.rest.blocks,
            uncertainty=uncertainty,
            every=every,
        )

    def _by_normals(self, lit: LitImage, name: str) -> Reading:
        assert self.normal_model is not None
        if isinstance(lit.seen, ReadHeights):
            self.clock.begin("deviations")
            return self._of_blocks(lit, lit.seen, name, LARGEST_PX)
        every = finest_px(self.grid)
        found = self._heights(lit, every, uncertainty=False)
        self.clock.begin("deviations")
        thin = self.grid.thinned(every), self._counted(every)
        found = with_deviations(found, self.normal_model.config, *thin, every)
        return self._of_blocks(lit, found, name, every)

    def _of_blocks(self, lit: LitImage, seen: ReadHeights, name: str, block_px: int) -> Reading:
        """The reading of an image by maps of blocks of so many pixels."""
        assert self.normal_model is not None
        read, config = seen.normals, self.normal_model.config
        shape, rest = self.untouched.shape[:2], lit.rest
        rise_m, sigmas = seen.rise_m, []
        if seen.sigma_m is not None and seen.reading_sigma_m is not None:
            lights = self._light_errors.sigma_m([lit.light, lit.still], seen.zero, block_px)
            known = seen.sigma_m, seen.reading_sigma_m
            sigmas = [together(one, light_m) for one, light_m in zip(known, lights, strict=True)]
        pressed = None
        if rest is not None:
            rise_m = rise_m + rest.bulge_m
            sigmas[:1] = [together(one, np.full_like(one, rest.sigma_m)) for one in sigmas[:1]]
            pressed = repeated(rest.pressed, LARGEST_PX // block_px, rise_m.shape)
        alone_m = sigmas[1] if sigmas else None
        touch = touch_of(rise_m, alone_m, self.grid.thinned(block_px), pressed)
        beyond = self._beyond(read.tilt_rad)
        _require_taught(name, beyond[touch.pixels])

        rise_m, *others = on_pixels([rise_m, *sigmas], shape, block_px)
        # Lines that go on beyond the outermost blocks may fall below any deviation there is.
        others = [np.maximum(fine, known.min()) for fine, known in zip(others, sigmas, strict=True)]
        return self._reading(
            lit, name, rise_m.astype(np.float64), *(others or (None, None)),
            touch=replace(touch, pixels=repeated(touch.pixels, block_px, shape)),
            method="normals",
            directions=partial(directions_of_blocks, read, config, beyond, shape, block_px),
        )  # fmt: skip

    def _beyond(self, tilt_rad: np.ndarray) -> np.ndarray:
        """Where tilts, [h, w, 2], are steeper than any captured ball was, bool."""
        assert self.normal_model is not None
        cone = np.radians(self.normal_model.config.cone_deg)
        return np.einsum("hwc,hwc->hw", tilt_rad, tilt_rad) > cone**2

    def _reading(
        self,
        lit: LitImage,
        name: str,
        rise_m: np.ndarray,
        sigma_m: np.ndarray | None,
        alone_m: np.ndarray | None,
        **by_method: Any,
    ) -> Reading:
        rest = lit.rest
        remarks = (
            lit.remark,
            lit.dirt,
            "" if rest is None else rest.remark,
            by_method.pop("said", ""),
        )
        return Reading(
            grid=self.grid,
            image=lit.frame.image,
            name=name,
            no_press=self.no_press,
            height_m=self.rest.height_m + rise_m,
            depth_m=-rise_m,
            height_sigma_m=sigma_m,
            reading_sigma_m=alone_m,
            sigma_of=self.sigma_of,
            remarks=(*self.remarks, *(remark for remark in remarks if remark)),
            **by_method,
        )

    @property
    def _rest_normals(self) -> np.ndarray | None:
        return None if self.rest.is_flat else self.rest.normals

    @cached_property
    def _light_errors(self) -> LightErrors:
        assert self.normal_model is not None
        return LightErrors(self.normal_model, self._bare, self.grid, self.mask, self._rest_normals)


def _require_taught(name: str, beyond: np.ndarray) -> None:
    """InputError where most of what is touched, flags [n], is steeper than any captured ball."""
    if beyond.size and beyond.mean() > GUESSED_SHARE:
        raise InputError(
            f"{name} is read in vain: {beyond.mean():.0%} of what is touched is steeper than any "
            "ball that was captured; no depth is given"
        )


def _metres(values_mm: np.ndarray | None) -> np.ndarray | None:
    return None if values_mm is None else 1e-3 * values_mm


def _refuse(name: str, why: str) -> None:
    if why:
        raise InputError(f"{name} {why}")
