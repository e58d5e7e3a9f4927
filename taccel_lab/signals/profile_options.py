# SPDX-License-Identifier: Apache-2.0
"""What ``SignalTactile`` takes from a profile: colours, background and dots."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.camera.gel_camera import View, camera_of
from taccel_lab.geometry import QuadraticMesh, TetMesh
from taccel_lab.signals.color_model import ColorModel
from taccel_lab.signals.dots import DotPainter, PaintedDots, radius_px
from taccel_lab.signals.markers import MarkerLayout
from taccel_lab.signals.tactile_image import PressedFace, tactile_image

if TYPE_CHECKING:
    from taccel_lab.profile import SensorProfile


def profile_options(
    profile: SensorProfile,
    mesh: TetMesh | QuadraticMesh,
    own: Mapping[str, Any] | None = None,
    rest_positions_m: np.ndarray | None = None,
) -> dict[str, Any]:
    """Arguments of ``SignalTactile``: ``color_model`` and ``background_rgb`` where the profile has
    both, ``markers`` where it has dots: those that the camera sees and that lie on ``mesh``; and
    ``dots``, cut out of the background, where it has all of them. What is given in ``own`` goes
    first; dots are then its own as well. ``rest_positions_m``: nodes at rest [rest_count, node, 3],
    where they are not those of ``mesh``."""
    own = own or {}
    found: dict[str, Any] = {}
    model, grid = ColorModel.from_profile(profile), profile.grid()
    view = profile_view(profile, own)
    if model is not None and profile.background_rgb is not None:
        found |= {"color_model": model, "background_rgb": profile.background_rgb}
    if profile.markers is not None:
        points = profile.markers.grid().points_mm()
        found["markers"], seen = MarkerLayout.seen_on(
            mesh, points, view, rest_positions_m, profile.mesh
        )
        if "background_rgb" in found and own.keys().isdisjoint(found):
            dots = PaintedDots.cut_out(
                found["background_rgb"],
                grid.pixel_from_gel(points[seen]),
                radius_px(profile.markers.radius_mm, grid),
            )
            found |= {"dots": dots, "background_rgb": dots.clean_rgb}
    return found | dict(own)


def profile_view(profile: SensorProfile, own: Mapping[str, Any]) -> View:
    """What the pixels of a profile's signals see: its camera, or, with colours of one's own, which
    are of its pixel grid, that."""
    return profile.grid() if "color_model" in own else camera_of(profile)


def image_painter(
    profile: SensorProfile, mesh: TetMesh | QuadraticMesh
) -> Callable[[PressedFace, np.ndarray], np.ndarray] | None:
    """What makes images of a pressed gel in the colours of a profile, with its dots; None where the
    profile has no colour model or no background.

    It takes the face on the profile's pixels and the positions of the nodes of ``mesh`` [m],
    [node, 3], in the gel's frame, and gives levels, float32, [height_px, width_px, 3].
    """
    options = profile_options(profile, mesh)
    if "color_model" not in options:
        return None
    model, background = options["color_model"], options["background_rgb"]
    painter = None
    if "dots" in options:
        painter = DotPainter(options["dots"], options["markers"], mesh, profile.grid())

    def image(face: PressedFace, positions_m: np.ndarray) -> np.ndarray:
        levels = tactile_image(model, background, face)
        return levels if painter is None else painter.painted(levels, positions_m)

    return image
