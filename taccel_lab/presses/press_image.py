# SPDX-License-Identifier: Apache-2.0
"""What a sensor shows of a press: in its calibrated colours, or as its optical design predicts."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.camera.gel_camera import GelCamera, camera_of
from taccel_lab.optics.render import OpticalModel
from taccel_lab.signals.profile_options import image_painter

if TYPE_CHECKING:
    from taccel_lab.presses.press_outcome import PressOutcome
    from taccel_lab.profile import SensorProfile

PREDICTED_PX = 640
"""Longest side of the picture that the optical model predicts."""


def painted_images(
    profile: SensorProfile, outcome: PressOutcome
) -> tuple[np.ndarray | None, list[np.ndarray] | None]:
    """The image of a press in the profile's colours, RGB levels, float32, [height_px, width_px, 3],
    and those at rest and after each step that was kept; None where colours or steps are missing."""
    paint = image_painter(profile, outcome.mesh)
    if paint is None:
        return None, None
    rgb = paint(outcome, outcome.positions_m)
    if outcome.states is None:
        return rgb, None
    rest, states = outcome.mesh.nodes_m, outcome.states
    seen = zip(states.surfaces, states.moved_m, strict=True)
    assert profile.background_rgb is not None
    return rgb, [profile.background_rgb, *(paint(one, rest + moved) for one, moved in seen)]


def predicted_images(
    profile: SensorProfile, outcome: PressOutcome, places_m: np.ndarray, longest_px: int
) -> list[np.ndarray] | None:
    """Pictures that the optical model of an uncalibrated sensor predicts, through its one camera.

    Args:
        profile: Of the sensor.
        outcome: Press whose mesh the places are of.
        places_m: Positions of its nodes [m], [state, node, 3].
        longest_px: Longest side of a picture.

    Returns:
        RGB levels, uint8, [height_px, width_px, 3] each; None where the sensor has no optics.
    """
    design, camera = profile.optical_design(), camera_of(profile)
    if design is None or not isinstance(camera, GelCamera):
        return None
    seen = camera.resized(*camera.camera.size_within(longest_px))
    markers = None if profile.markers is None else profile.markers.grid()
    model = OpticalModel.through(seen, design, outcome.mesh, markers=markers, designed=profile.mesh)
    return [model.render(places).rgb for places in places_m]
