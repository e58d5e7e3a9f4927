# SPDX-License-Identifier: Apache-2.0
"""The one set of circles of a capture folder that colours and normals are fitted in.

Circles are found in the images and fused with labels (``contacts``); the colours of the other
presses then place each of them anew (``registration``), which also tells circles that are all too
large. It is done once for all blocks of a folder.
"""

from __future__ import annotations

from dataclasses import replace

from taccel_lab.calibration.ball_presses import BallPresses, ball_presses
from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.color.frames import ColorFrame
from taccel_lab.calibration.color.registration import MIN_PRESSES, register_presses
from taccel_lab.calibration.contacts.labels import LabelPlacement
from taccel_lab.calibration.press_options import BallPressOptions
from taccel_lab.calibration.surfaces.ball_in_layer import layer_of, layer_surfaces
from taccel_lab.calibration.surfaces.press_surface import BallSurface
from taccel_lab.profile import SensorProfile
from taccel_lab.progress import Progress, silent
from taccel_lab.signals.rest_surface import rest_surface

REGISTERING = "reading the circles again with the colours"


def placed_presses(
    folder: CaptureFolder,
    base: SensorProfile,
    block: str,
    options: BallPressOptions,
    progress: Progress = silent,
    *,
    cache: bool = True,
) -> BallPresses:
    """``ball_presses`` with their surfaces, in the circles that the colours of the other presses
    give; with fewer than 8 of them as they are found. Errors of ``ball_presses``."""
    presses = ball_presses(folder, base, block, options, progress, cache=cache)
    key = (
        "placed",
        presses.captures.grid,
        presses.split,
        options.circles,
        presses.profile.gel.thickness_mm,
    )

    def placed() -> tuple[list[ContactCircle], tuple[BallSurface, ...]]:
        few = len(presses.circles) < MIN_PRESSES
        circles = presses.circles if few else _registered(presses, progress)
        return circles, _surfaces(replace(presses, circles=circles))

    circles, surfaces = folder.once.of(key, placed)
    labels = LabelPlacement.of(presses.training.presses, circles)
    return replace(presses, circles=circles, labels=labels, surfaces=surfaces)


def _surfaces(presses: BallPresses) -> tuple[BallSurface, ...]:
    profile, training = presses.profile, presses.training
    rest = rest_surface(profile.mesh, training.grid)
    return tuple(layer_surfaces(training, presses.circles, layer_of(profile), rest))


def _registered(presses: BallPresses, progress: Progress) -> list[ContactCircle]:
    training, grid, mask = presses.training, presses.training.grid, presses.training.mask
    frames = [
        ColorFrame(press.name, press.image(), circle, surface, press.sha256)
        for press, circle, surface in zip(
            training.presses, presses.circles, _surfaces(presses), strict=True
        )
    ]
    assert presses.profile.background_rgb is not None
    found = register_presses(
        frames,
        presses.profile.background_rgb,
        grid,
        mask=mask,
        progress=lambda done, total: progress(REGISTERING, done, total),
    ).circles
    return [
        circle.up_to_equator(press.radius_mm or training.ball_radius_mm, grid)
        for press, circle in zip(training.presses, found, strict=True)
    ]
