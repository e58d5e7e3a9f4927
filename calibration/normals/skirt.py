# SPDX-License-Identifier: Apache-2.0
"""Closed-form skirts around contacts, for fits that do without a simulation.

The half-space's sinking (``taccel_lab.calibration.surfaces.analytic``) reaches much too far on a
gel that is bonded to a plate. Damped over half the contact's radius it comes near the simulated
surfaces of three sensors with gels of 4 mm and contacts of 1.6 to 2.1 mm: 1 to 5 degrees off
between 1.05 and 2 radii, where undamped it is 2 to 15.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from taccel_lab.calibration.capture.captures import CaptureSet, ContactCircle
from taccel_lab.calibration.surfaces import PressSurface, analytic_surface

DECAY_RADII = 0.5
LARGEST_RADII = 0.985
"""Contacts up to the ball's equator are taken this much smaller: its slope has no bound there."""


def hertz_skirts(captures: CaptureSet, circles: Sequence[ContactCircle]) -> list[PressSurface]:
    """Damped Hertz surfaces of all presses, in order."""
    grid, ball_mm = captures.grid, captures.ball_radius_mm
    surfaces = []
    for circle in circles:
        most_px = LARGEST_RADII * ball_mm / grid.mm_per_px_x
        contact = replace(circle, radius_px=min(circle.radius_px, most_px))
        decay_mm = DECAY_RADII * contact.radius_px * grid.mm_per_px_x
        surfaces.append(analytic_surface(contact, grid, ball_mm, decay_mm=decay_mm))
    return surfaces
