# SPDX-License-Identifier: Apache-2.0
"""New frames of a sensor and what its profile renders for them: the input of a refit."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Literal

import numpy as np

from calibration.background.light_change import RefitFrame
from calibration.capture.captures import CaptureSet, ContactCircle
from calibration.capture.folder import CaptureFolder
from calibration.surfaces import PressSurface, analytic_surface
from taccel_lab.errors import InputError
from taccel_lab.profile import SensorProfile
from taccel_lab.signals.color_model import ColorModel, ColorModelConfig

NEAR_RADII = 1.8
"""The model's own error matters less beyond this many contact radii."""

Surfaces = Callable[[CaptureSet, list[ContactCircle]], list[PressSurface]]


def refit_frames(
    profile: SensorProfile,
    folder: CaptureFolder,
    surfaces: Surfaces | Literal["hertz"] = "hertz",
) -> tuple[list[RefitFrame], str]:
    """Frames of ``folder`` with the old profile's render, and what made the surfaces.

    ``surfaces`` makes the gel's surface under each press, ``hertz`` in closed form. The presses'
    circles are found in the images; a profile without a colour model takes the untouched frames
    only. Raises InputError when the images are not of the profile's size.
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
        return frames, "none"
    captures = _capture_set(profile, folder)
    for press in captures.presses:
        _check_size(press.image(), size, press.source)
    from calibration.targets import choose_circles, resolve_contacts

    circles = choose_circles(captures, resolve_contacts(captures))
    model = ColorModel(
        ColorModelConfig.from_dict(profile.color.architecture), profile.color_weights
    )
    if surfaces == "hertz":
        made = [
            analytic_surface(
                circle,
                captures.grid,
                press.radius_mm or captures.ball_radius_mm,
                decay_mm=profile.gel.thickness_mm,
            )
            for circle, press in zip(circles, captures.presses, strict=True)
        ]
    else:
        made = surfaces(captures, circles)
    for press, circle, surface in zip(captures.presses, circles, made, strict=True):
        distance = circle.distance_px(captures.grid)
        frames.append(
            RefitFrame(
                press.name,
                press.sha256,
                press.image(),
                model.predict(surface.normals, surface.displacement_mm(), surface.rest_normals),
                distance <= circle.radius_px,
                distance <= NEAR_RADII * circle.radius_px,
            )
        )
    return frames, ", ".join(sorted({surface.provider for surface in made}))


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
    return CaptureSet(
        source=folder.source,
        sensor=folder.sensor,
        background=background,
        background_sha256="" if folder.background is None else folder.background.sha256,
        mask=np.ones(background.shape[:2], bool) if folder.mask is None else folder.mask,
        ball_radius_mm=radius,
        grid=profile.grid(),
        presses=tuple(dataclasses.replace(press) for press in folder.presses),
        provenance=folder.provenance,
    )


def _check_size(image: np.ndarray, size: tuple[int, int], source: str) -> None:
    found = image.shape[1], image.shape[0]
    if found != size:
        raise InputError(
            f"{source} is {found[0]}x{found[1]} px, the profile's camera {size[0]}x{size[1]} px; a "
            "refit takes frames of the same camera and crop"
        )
