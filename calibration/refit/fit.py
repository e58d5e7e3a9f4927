# SPDX-License-Identifier: Apache-2.0
"""Bring an existing profile to the light of today from a handful of new frames.

The profile stays of the same kind: its background is put into the new light and averaged with what
the new frames show of the untouched gel, and the last layer of its colour model is scaled a
channel, which scales the colour change that it gives. Every figure is of frames that were left out
of the fit, one after the other.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.background.untouched import RunningMean, steady_pixels, untouched_pixels
from taccel_lab.calibration.base_profile import captures_on_pad, require_image_of
from taccel_lab.calibration.capture.captures import CaptureSet, ContactCircle
from taccel_lab.calibration.capture.folder import CaptureFolder, source_of
from taccel_lab.calibration.capture.split import HOLDOUT_EVERY
from taccel_lab.calibration.circles.ball_surface import BallSurface, layer_of, layer_surfaces
from taccel_lab.calibration.circles.usable import place_heldout, usable_circles
from taccel_lab.calibration.pad import require_view_on_pad
from taccel_lab.calibration.refit import remarks
from taccel_lab.calibration.refit.light_change import (
    LightChange,
    LightChangeFit,
    RefitFrame,
    fit_light_change,
)
from taccel_lab.calibration.refit.result import CHANNELS, FrameError, RefitCalibration
from taccel_lab.errors import InputError
from taccel_lab.profile import SensorProfile
from taccel_lab.reading.light import fit_light
from taccel_lab.report.remark import Remark
from taccel_lab.sensors.registry import is_of_sensor
from taccel_lab.signals.color_model import ColorModel
from taccel_lab.signals.rest_surface import rest_surface

MIN_FRAMES = 3
MAX_RESPONSE_SIGMA = 0.25
"""Largest relative standard deviation of the response that a refit may have."""
ROUGH_RESPONSE_SIGMA = 0.1
"""The same above which it is worth a warning."""
FRAME_DRIFT_LEVELS = 3.0
MIN_GAIN_LEVELS = 0.1
_PAIRS = (("before", "after"), ("whole_before", "whole_after"))
NEAR_RADII = 1.8
"""The model's own error matters less beyond this many contact radii."""


def calibrate_refit(
    folder: CaptureFolder,
    base: SensorProfile,
) -> RefitCalibration:
    """Correct ``base`` for the light of today, which ``folder`` shows.

    Raises:
        InputError: Captures of another sensor or image size, a profile without a background, and
            whatever ``refit_profile`` refuses.
    """
    if not is_of_sensor(base, folder.sensor):
        raise InputError(
            f"the captures are of a {folder.sensor}, the profile is of a {base.sensor.family}"
        )
    require_image_of(base, folder)
    _require_background(base)
    require_view_on_pad(base, base.grid(), folder.mask, folder.source, "color")
    new = refit_frames(base, folder)
    return refit_profile(
        base,
        new.fitted,
        source=source_of(folder.provenance, folder.source),
        surface_provider=new.surface_provider,
        mask=folder.mask,
        heldout=new.heldout,
    )


def _require_background(profile: SensorProfile) -> np.ndarray:
    if profile.background_rgb is None:
        raise InputError(
            "the profile has no background, so that there is nothing to refit; run taccel-lab "
            "calibrate color first"
        )
    return profile.background_rgb


def refit_profile(
    profile: SensorProfile,
    frames: Sequence[RefitFrame],
    *,
    source: str,
    surface_provider: str,
    mask: np.ndarray | None = None,
    heldout: Sequence[RefitFrame] = (),
) -> RefitCalibration:
    """Fit today's light to new ``frames`` of the sensor of ``profile``.

    Presses of ``heldout`` have no part in it; the finished correction is scored on them.

    Raises InputError when the profile has no background, or when the frames cannot tell the
    correction: too few, no contact although the profile has a colour model, a response that the
    frames disagree on, or no gain on frames that were left out.
    """
    old = _require_background(profile)
    if len(frames) < MIN_FRAMES:
        raise InputError(
            f"{len(frames)} new frames cannot tell a correction from chance; at least "
            f"{MIN_FRAMES}, better 5, presses among them"
        )
    pressed = [frame for frame in frames if frame.change is not None]
    if profile.color is not None and len(pressed) < 2:
        raise InputError(
            f"{len(pressed)} of the {len(frames)} new frames are presses: too few for the "
            "colour model's response; at least 2 presses of a known ball"
        )
    old = old.astype(np.float64)
    fit = fit_light_change(frames, old, mask)
    errors = tuple(
        _error(frame, change, _new_background(frames, change, old, mask, k), old, mask)
        for k, (frame, change) in enumerate(zip(frames, fit.left_out, strict=True))
    )
    background = _new_background(frames, fit.change, old, mask, None)
    refit = RefitCalibration(
        fit=fit,
        background=background,
        errors=errors,
        heldout=tuple(_error(frame, fit.change, background, old, mask) for frame in heldout),
        remarks=_remarks(fit, frames, errors, old, mask),
        inputs={frame.name: frame.sha256 for frame in frames},
        source=source,
        surface_provider=surface_provider,
    )
    _refuse_chance(refit, profile.color is not None)
    return refit


def _sure_gain(errors: Sequence[FrameError], before: str, after: str) -> float:
    """How much less left-out frames are off, less what may be chance [levels].

    Two standard errors over the frames may be.
    """
    gain = np.array([getattr(error, before) - getattr(error, after) for error in errors])
    return float(gain.mean() - max(MIN_GAIN_LEVELS, 2 * gain.std(ddof=1) / np.sqrt(len(gain))))


def _refuse_chance(refit: RefitCalibration, has_color: bool) -> None:
    sigma = refit.fit.sigma.response / np.maximum(refit.fit.change.response, 1e-3)
    worst = int(np.argmax(sigma))
    if has_color and sigma[worst] > MAX_RESPONSE_SIGMA:
        raise InputError(
            f"the {len(refit.errors)} frames cannot tell the correction: the response of "
            f"{CHANNELS[worst]} is {refit.fit.change.response[worst]:.2f} with a standard "
            f"deviation of {100 * sigma[worst]:.0f} %, at most {100 * MAX_RESPONSE_SIGMA:.0f} % "
            "is allowed. Give more presses, spread over the gel, in steady light"
        )
    disc, whole = (_sure_gain(refit.errors, *names) for names in _PAIRS)
    if max(disc, whole) <= 0:
        raise InputError(
            "no correction helps; on frames left out of the fit the error is "
            f"{refit.mean('before'):.2f} levels with the old profile and "
            f"{refit.mean('after'):.2f} with a refitted one; over whole frames "
            f"{refit.mean('whole_before'):.2f} and {refit.mean('whole_after'):.2f}; the old "
            "profile stays"
        )


def _new_background(
    frames: Sequence[RefitFrame],
    change: LightChange,
    old: np.ndarray,
    mask: np.ndarray | None,
    leave_out: int | None,
) -> np.ndarray:
    """The old background in the new light, averaged with what the frames show of the gel."""
    base = change.light.apply(old)
    mean = RunningMean.empty(old.shape)
    mean.add(base, np.ones(old.shape[:2], bool))
    for k, frame in enumerate(frames):
        if k == leave_out:
            continue
        drift = fit_light(frame.image, base, mask)
        pick = untouched_pixels if frame.change is None else steady_pixels
        seen = pick(frame.image, base, drift, mask)
        mean.add(drift.remove(frame.image.astype(np.float64)), seen)
    averaged = mean.mean(base)
    if mask is not None:
        averaged[~mask] = base[~mask]
    return np.clip(averaged, 0, 255).astype(np.float32)


def _error(
    frame: RefitFrame,
    change: LightChange,
    new: np.ndarray,
    old: np.ndarray,
    mask: np.ndarray | None,
) -> FrameError:
    """How far a frame is off with the old background, and with a new one and its change."""
    usable = np.ones(old.shape[:2], bool) if mask is None else mask
    background = new.astype(np.float64)
    before, after = old, background
    if frame.change is not None:
        before = np.clip(old + frame.change, 0, 255)
        after = np.clip(background + change.response * frame.change, 0, 255)
    where = usable if frame.disc is None else usable & frame.disc
    image = frame.image.astype(np.float64)

    def l1(rendered: np.ndarray, pixels: np.ndarray) -> float:
        return float(np.abs(rendered - image)[pixels].mean())

    return FrameError(
        name=frame.name,
        pressed=frame.change is not None,
        before=l1(before, where),
        after=l1(after, where),
        whole_before=l1(before, usable),
        whole_after=l1(after, usable),
    )


def _remarks(
    fit: LightChangeFit,
    frames: Sequence[RefitFrame],
    errors: Sequence[FrameError],
    old: np.ndarray,
    mask: np.ndarray | None,
) -> tuple[Remark, ...]:
    change, sigma = fit.change, fit.sigma
    found = []
    rough = sigma.response / np.maximum(change.response, 1e-3)
    if rough.max() > ROUGH_RESPONSE_SIGMA:
        name = CHANNELS[int(np.argmax(rough))]
        found.append(remarks.ROUGH_RESPONSE(percent=100 * rough.max(), channel=name))
    worse = [error.name for error in errors if error.after > error.before + 0.5]
    if worse:
        found.append(remarks.SOME_WORSE(names=", ".join(worse)))
    moving = _between(frames, change, old, mask)
    if moving > FRAME_DRIFT_LEVELS:
        found.append(remarks.LIGHT_UNSTEADY(levels=moving))
    return tuple(found)


def _between(
    frames: Sequence[RefitFrame], change: LightChange, old: np.ndarray, mask: np.ndarray | None
) -> float:
    """Root mean square over the frames and channels of the light's change left in each [levels]."""
    base = change.light.apply(old)
    level = base.reshape(-1, 3).mean(axis=0)
    shifts = [fit_light(frame.image, base, mask).shift(level) for frame in frames]
    return float(np.sqrt(np.mean(np.square(shifts))))


@dataclass(frozen=True)
class NewFrames:
    """What a refit is given."""

    fitted: list[RefitFrame]
    """Untouched frames and training presses."""
    heldout: list[RefitFrame]
    """Presses that only figures see, placed without any part in the others' circles."""
    surface_provider: str
    """What made the surfaces."""


def refit_frames(
    profile: SensorProfile,
    folder: CaptureFolder,
) -> NewFrames:
    """Frames of ``folder`` with the old profile's render.

    Presses are split before an image is read, by the one rule for captures; with fewer than four,
    only what the manifest holds out is. The circles of the training presses are found in their
    images together; a held-out press is placed by its label, as those of the training presses lie,
    or else found in its own image alone. A profile without a colour model takes the untouched
    frames only. Raises InputError when the images are not of the profile's size.
    """
    size = profile.camera.width_px, profile.camera.height_px
    frames: list[RefitFrame] = []
    untouched = list(folder.untouched)
    if folder.background is not None:
        untouched.insert(0, folder.background)
    for i, frame in enumerate(untouched):
        image = frame.image()
        _check_size(image, size, frame.source)
        name = f"untouched_{i}_{frame.name}"
        frames.append(RefitFrame(name, frame.sha256, image, None, None, None))
    if profile.color is None or profile.color_weights is None or not folder.presses:
        return NewFrames(frames, [], "none")
    captures = _capture_set(profile, folder)
    # Of fewer presses than that the rule can hold none out; what the manifest says still holds.
    few = len(captures.presses) < HOLDOUT_EVERY and captures.heldout is None
    split = captures.split(0 if few else HOLDOUT_EVERY)
    for press in captures.presses:
        _check_size(press.image(), size, press.source)
    training = captures.only(split.train)
    usable = usable_circles(training, cache=False)
    training, circles = usable.captures, usable.circles
    pad, rest = layer_of(profile), rest_surface(profile.mesh, captures.grid)
    made = layer_surfaces(training, circles, pad, rest)
    frames += _pressed(profile, training, circles, made)
    if not split.heldout:
        return NewFrames(frames, [], _providers(made))
    others = captures.only(split.heldout)
    shift = usable.labels
    placed = [place_heldout(press, press.image(), others, shift) for press in others.presses]
    made_there = layer_surfaces(others, placed, pad, rest)
    heldout = _pressed(profile, others, placed, made_there)
    return NewFrames(frames, heldout, _providers([*made, *made_there]))


def _pressed(
    profile: SensorProfile,
    captures: CaptureSet,
    circles: list[ContactCircle],
    surfaces: list[BallSurface],
) -> list[RefitFrame]:
    """The presses with the change that the profile's colour model gives for them."""
    model = ColorModel.from_profile(profile)
    assert model is not None
    frames = []
    for press, circle, surface in zip(captures.presses, circles, surfaces, strict=True):
        distance = circle.distance_px(captures.grid)
        frames.append(
            RefitFrame(
                press.name,
                press.sha256,
                press.image(),
                _predicted_change(model, surface),
                distance <= circle.radius_px,
                distance <= NEAR_RADII * circle.radius_px,
            )
        )
    return frames


def _predicted_change(model: ColorModel, surface: BallSurface) -> np.ndarray:
    """Change of colour that the model gives for a press [levels], [height_px, width_px, 3]."""
    change = model.predict_pixels(
        np.arange(surface.height_m.size),
        surface.normals.reshape(-1, 3),
        surface.displacement_mm().ravel(),
        surface.rest_normals.reshape(-1, 3),
    )
    return change.reshape(surface.normals.shape)


def _providers(surfaces: list[BallSurface]) -> str:
    return ", ".join(sorted({surface.provider for surface in surfaces}))


def _capture_set(profile: SensorProfile, folder: CaptureFolder) -> CaptureSet:
    """The presses on the profile's own grid, against the new background or else the old one."""
    radius = folder.ball_radius_mm or next(iter(folder.ball_radii_mm()), None)
    if radius is None:
        raise InputError(
            f"{folder.source}: the radius of the ball is missing; give [indenter] radius_mm"
        )
    old = profile.background_rgb
    assert old is not None
    background = old if folder.background is None else folder.background.image()
    captures = CaptureSet(
        source=folder.source,
        sensor=folder.sensor,
        background=background,
        background_sha256="" if folder.background is None else folder.background.sha256,
        mask=np.ones(background.shape[:2], bool) if folder.mask is None else folder.mask,
        ball_radius_mm=radius,
        grid=profile.grid(),
        presses=tuple(dataclasses.replace(press) for press in folder.presses),
        provenance=folder.provenance,
        heldout=folder.heldout,
    )
    return captures_on_pad(captures, profile)


def _check_size(image: np.ndarray, size: tuple[int, int], source: str) -> None:
    found = image.shape[1], image.shape[0]
    if found != size:
        raise InputError(
            f"{source} is {found[0]}x{found[1]} px, the profile's camera {size[0]}x{size[1]} px; a "
            "refit takes frames of the same camera and crop"
        )
