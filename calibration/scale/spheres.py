# SPDX-License-Identifier: Apache-2.0
"""What presses of balls of known radius tell of the scale.

The picture of a contact alone does not give it. Inside the contact, the slope of the gel at a place
is set by its distance from the centre in ball radii, whatever the depth; how colour depends on
slope is not known, so that every ball radius in pixels explains the colours as well. What remains
is a limit: no contact is larger than the ball. The depth of a press does not help: a gel sinks
beside the ball or not (a^2 = beta d (2 R - d), beta 1/2 to 1: K. L. Johnson, Contact Mechanics,
1985, sections 4.2 and 5.8), which leaves 14 %, as much as the catalogue does.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

from taccel_lab.calibration.capture.captures import CapturedPress
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.capture.sensor_facts import sensor_facts
from taccel_lab.calibration.circles.seen import seen_contact
from taccel_lab.calibration.scale.estimate import ScaleEstimate
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid

ONE_SIDED_95 = 1.645
MIN_SIGMA_PX = 1.0
"""A circle is not known better than this, whatever the fit says."""


@dataclass(frozen=True)
class BallContact:
    """The contact of one press."""

    press: CapturedPress
    ball_mm: float
    center_px: tuple[float, float]
    radius_px: float
    sigma_px: float
    labelled: bool


def measure_contacts(
    folder: CaptureFolder, ratio: float = 1.0
) -> tuple[list[BallContact], list[str]]:
    """Contact radius of every press, given or found, and the reasons of presses without one.

    ``ratio``: mm/px along y over that along x.
    """
    found: list[BallContact] = []
    refused: list[str] = []
    background = folder.require_background().image()
    height, width = background.shape[:2]
    # No pixel of a grid is larger than a millimetre.
    grid = PixelGrid(width, height, min(1.0, 1 / ratio), min(1.0, ratio))
    facts = sensor_facts(folder.sensor, folder.design)
    grey = "grey" if facts is not None and facts.is_grey else None
    for press in folder.presses:
        ball = press.radius_mm or folder.ball_radius_mm
        if ball is None:
            refused.append(f"{press.source}: the radius of the ball is not stated")
            continue
        if press.circle is not None:
            center = press.circle.u_px, press.circle.v_px
            radius = press.circle.radius_px
            found.append(BallContact(press, ball, center, radius, MIN_SIGMA_PX, True))
            continue
        try:
            contact = seen_contact(press, background, grid, folder.mask, grey)
        except InputError as error:
            refused.append(str(error))
            continue
        sigma = max(contact.radius_sigma_px, MIN_SIGMA_PX)
        center = contact.circle.u_px, contact.circle.v_px
        found.append(BallContact(press, ball, center, contact.circle.radius_px, sigma, False))
    return found, refused


def scale_from_spheres(contacts: list[BallContact], refused: list[str]) -> ScaleEstimate:
    """Limit of the scale from the largest contacts.

    Raises:
        InputError: No press shows a contact.
    """
    if not contacts:
        raise InputError("no contact of a ball was found:\n" + "\n".join(refused[:5]))
    balls: dict[float, list[BallContact]] = defaultdict(list)
    for contact in contacts:
        balls[contact.ball_mm].append(contact)
    limits = {ball: _upper_limit(ball, group) for ball, group in balls.items()}
    upper = min(limits.values())
    return ScaleEstimate(
        "spheres",
        upper_x=upper,
        inputs={contact.press.name: contact.press.sha256 for contact in contacts},
        evidence={
            "contacts": len(contacts),
            "labelled": sum(contact.labelled for contact in contacts),
            "largest_radius_px": max(contact.radius_px for contact in contacts),
            "upper_limit_by_ball_mm": {f"{ball:g}": limit for ball, limit in limits.items()},
        },
        refused=tuple(refused),
    )


def _upper_limit(ball_mm: float, group: list[BallContact]) -> float:
    """95 % upper limit of mm/px by the second largest contact, so that one mistake is harmless."""
    ranked = sorted(group, key=lambda contact: -contact.radius_px)
    taken = ranked[1] if len(ranked) >= 5 else ranked[0]
    return ball_mm / max(taken.radius_px - ONE_SIDED_95 * taken.sigma_px, 1.0)
