# SPDX-License-Identifier: Apache-2.0
"""What presses of balls of known radius tell of the scale.

The picture of a contact alone does not give it. Inside the contact, the slope of the gel at a place
is set by its distance from the centre in ball radii, whatever the depth; how colour depends on
slope is not known, so that every ball radius in pixels explains the colours as well. What remains
is a limit: no contact is larger than the ball. With the depth of the presses a scale follows:

    a^2 = beta d (2 R - d)

with the contact radius a, the depth d past first touch, and beta from 1/2 (a half-space, Hertz) to
about 1 (a thin bonded layer that cannot sink beside the ball; K. L. Johnson, Contact Mechanics,
1985, sections 4.2 and 5.8). That range of beta is most of its uncertainty.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from taccel_lab.calibration.capture.captures import CapturedPress
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.capture.sensor_facts import sensor_facts
from taccel_lab.calibration.contacts.seen import seen_contact
from taccel_lab.calibration.result import NORMAL_95, Estimate
from taccel_lab.calibration.robust_spread import spread_about_zero
from taccel_lab.calibration.scale.estimate import ScaleEstimate
from taccel_lab.calibration.scale.remarks import DEPTHS_DISAGREE
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid

BETA = (0.5, 1.05)
"""Range of a^2 / (d (2 R - d))."""
ONE_SIDED_95 = 1.645
MIN_SIGMA_PX = 1.0
"""A circle is not known better than this, whatever the fit says."""
MIN_DEPTHS = 3


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
    grid = PixelGrid(width, height, 1.0, ratio)
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


def scale_from_spheres(
    contacts: list[BallContact], refused: list[str], ratio: float = 1.0
) -> ScaleEstimate:
    """Limit of the scale from the largest contacts, and the scale itself where depths are known.

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
    estimate = ScaleEstimate(
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
    with_depth = [contact for contact in contacts if contact.press.depth_mm]
    if len(with_depth) < MIN_DEPTHS:
        return estimate
    return _with_depths(estimate, with_depth, ratio)


def _upper_limit(ball_mm: float, group: list[BallContact]) -> float:
    """95 % upper limit of mm/px by the second largest contact, so that one mistake is harmless."""
    ranked = sorted(group, key=lambda contact: -contact.radius_px)
    taken = ranked[1] if len(ranked) >= 5 else ranked[0]
    return ball_mm / max(taken.radius_px - ONE_SIDED_95 * taken.sigma_px, 1.0)


def _with_depths(
    estimate: ScaleEstimate, contacts: list[BallContact], ratio: float
) -> ScaleEstimate:
    """Scale from contact radius against depth, for beta anywhere in its range."""
    depth = np.array([float(contact.press.depth_mm or 0.0) for contact in contacts])
    ball = np.array([contact.ball_mm for contact in contacts])
    radius = np.array([contact.radius_px for contact in contacts])
    sigma = np.array([contact.sigma_px for contact in contacts])
    # a^2 s^2 = beta d (2 R - d): with q = s^2 / beta, a = sqrt(d (2R - d) / q).
    shape = np.sqrt(np.maximum(depth * (2 * ball - depth), 0.0))
    start = float(np.median(radius / np.maximum(shape, 1e-9)))
    spread = max(spread_about_zero((radius - start * shape) / sigma), 0.5)
    slope = float(
        least_squares(
            lambda x: (radius - x[0] * shape) / sigma, [start], loss="cauchy", f_scale=3 * spread
        ).x[0]
    )
    left = radius - slope * shape
    noise = max(1.0, float(np.sqrt(np.mean((left / sigma) ** 2))))
    slope_sigma = noise / np.sqrt(float(np.sum(shape**2 / sigma**2)))
    middle = np.sqrt(0.5 * (BETA[0] + BETA[1]))
    value = float(middle / slope)
    own = value * slope_sigma / slope
    # Every beta in the range is possible: a uniform law for sqrt(beta).
    by_beta = (np.sqrt(BETA[1]) - np.sqrt(BETA[0])) / np.sqrt(12) / slope
    low = np.sqrt(BETA[0]) / slope - NORMAL_95 * own
    high = np.sqrt(BETA[1]) / slope + NORMAL_95 * own
    if estimate.upper_x is not None:
        high = max(min(high, estimate.upper_x), value)
    total = float(np.hypot(own, by_beta))
    x = Estimate(value, total, "mm/px", (float(low), float(high)))
    y = Estimate(value * ratio, total * ratio, "mm/px", (float(low) * ratio, float(high) * ratio))
    correlation = float(np.corrcoef(shape, radius)[0, 1]) if len(contacts) > 2 else 1.0
    remarks = []
    if correlation < 0.5:
        remarks.append(DEPTHS_DISAGREE(correlation=correlation))
    return replace(
        estimate,
        x=x,
        y=y,
        remarks=tuple(remarks),
        evidence=estimate.evidence
        | {"depths": len(contacts), "beta_range": list(BETA), "radius_rms_px": float(left.std())},
    )
