# SPDX-License-Identifier: Apache-2.0
"""What ``SignalTactile`` takes from a profile: colours, background and dots."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from taccel_lab.geometry import QuadraticMesh, TetMesh
from taccel_lab.signals.color_model import ColorModel
from taccel_lab.signals.markers import MarkerLayout

if TYPE_CHECKING:
    from taccel_lab.profile import SensorProfile


def profile_options(profile: SensorProfile, mesh: TetMesh | QuadraticMesh) -> dict[str, Any]:
    """Arguments of ``SignalTactile``: ``color_model`` and ``background_rgb`` where the profile has
    both, ``markers`` where it has dots: those that the camera sees and that lie on ``mesh``."""
    found: dict[str, Any] = {}
    model = ColorModel.from_profile(profile)
    if model is not None and profile.background_rgb is not None:
        found |= {"color_model": model, "background_rgb": profile.background_rgb}
    if profile.markers is not None:
        points = profile.markers.grid().points_mm()
        seen = profile.grid().contains(points)
        found["markers"] = MarkerLayout.where_on(mesh, points[seen])[0]
    return found
