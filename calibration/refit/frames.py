# SPDX-License-Identifier: Apache-2.0
"""New frames of a sensor and what its profile renders for them: the input of a refit."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.base_profile import captures_on_pad
from taccel_lab.calibration.capture.captures import HOLDOUT_EVERY, CaptureSet, ContactCircle
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.circles.ball_surface import BallSurface, layer_of, layer_surfaces
from taccel_lab.calibration.circles.usable import place_heldout, usable_circles
from taccel_lab.calibration.refit.light_change import RefitFrame
from taccel_lab.errors import InputError
from taccel_lab.profile import SensorProfile
from taccel_lab.signals.color_model import ColorModel
from taccel_lab.signals.rest_surface import rest_surface

NEAR_RADII = 1.8
"""The model's own error matters less beyond this many contact radii."""


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
