# SPDX-License-Identifier: Apache-2.0
"""What presses of balls tell of the scale: a limit by their radius, and more by a stage's places.

The picture of a contact alone does not give it. Inside the contact, the slope of the gel at a place
is set by its distance from the centre in ball radii, whatever the depth; how colour depends on
slope is not known, so that every ball radius in pixels explains the colours as well. What remains
is a limit: no contact is larger than the ball. The depth of a press does not help: a gel sinks
beside the ball or not (a^2 = beta d (2 R - d), beta 1/2 to 1: K. L. Johnson, Contact Mechanics,
1985, sections 4.2 and 5.8), which leaves 14 %, as much as the catalogue does.

Where a stage pressed gives the scale: centres of contacts against places in millimetres. Its axes
may lie any way round in the image, also mirrored:

    (x, y) = M (u, v) + t

where the columns of M are what a pixel along the image's rows and columns is on the stage, so that
their lengths are mm/px along x and y.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from taccel_lab.calibration.capture.captures import CapturedPress, ContactCircle
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.capture.sensor_facts import sensor_facts
from taccel_lab.calibration.circles.contact_finder import seen_contact
from taccel_lab.calibration.result import Estimate
from taccel_lab.calibration.scale.result import ScaleEstimate
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.robust_fit import spread_about_zero

ONE_SIDED_95 = 1.645
MIN_SIGMA_PX = 1.0
"""A circle is not known better than this, whatever the fit says."""
LEAST_PLACES = 4
LEAST_CENTER_SIGMA_PX = 0.5
"""Centres of contacts are not known better than this."""
OFF, OFF_SHARE = 0.5, 0.1
"""Contact radii between a contact and its place, and the part of all contacts that may lie so: a
table that is out of step by one press is off wherever the place changes."""


@dataclass(frozen=True)
class BallContact:
    """The contact of one press."""

    press: CapturedPress
    ball_mm: float
    circle: ContactCircle
    """The given circle, else the one found."""
    sigma_px: float = MIN_SIGMA_PX
    """Standard deviation of its radius."""


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
            found.append(BallContact(press, ball, press.circle))
            continue
        contact = seen_contact(press, background, grid, folder.mask, grey)
        if isinstance(contact, InputError):
            refused.append(str(contact))
            continue
        sigma_px = max(contact.radius_sigma_px, MIN_SIGMA_PX)
        found.append(BallContact(press, ball, contact.circle, sigma_px))
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
            "labelled": sum(contact.press.circle is not None for contact in contacts),
            "largest_radius_px": max(contact.circle.radius_px for contact in contacts),
            "upper_limit_by_ball_mm": {f"{ball:g}": limit for ball, limit in limits.items()},
        },
        refused=tuple(refused),
    )


def _upper_limit(ball_mm: float, group: list[BallContact]) -> float:
    """95 % upper limit of mm/px by the second largest contact, so that one mistake is harmless."""
    ranked = sorted(group, key=lambda contact: -contact.circle.radius_px)
    taken = ranked[1] if len(ranked) >= 5 else ranked[0]
    return ball_mm / max(taken.circle.radius_px - ONE_SIDED_95 * taken.sigma_px, 1.0)


def scale_from_stage(contacts: Sequence[BallContact]) -> ScaleEstimate:
    """mm/px along x and y from contacts whose press has a ``stage_mm``.

    Raises:
        InputError: Places too few, or all on one line; contacts that do not lie as the places do.
    """
    stage = np.array([contact.press.stage_mm for contact in contacts], dtype=float)
    pixels = np.array([(contact.circle.u_px, contact.circle.v_px) for contact in contacts])
    apart = np.linalg.svd(stage - stage.mean(axis=0), compute_uv=False)
    if len(np.unique(stage, axis=0)) < LEAST_PLACES or apart[1] < 0.05 * apart[0]:
        raise InputError(
            f"the stage pressed at too few places, or all on one line; at least {LEAST_PLACES} "
            "that span the gel are needed"
        )
    # A contact in pixels by the place: what is measured, with its error, is the pixel.
    columns = np.column_stack([stage, np.ones(len(stage))])
    start, *_ = np.linalg.lstsq(columns, pixels, rcond=None)
    spread = max(spread_about_zero((pixels - columns @ start).ravel()), LEAST_CENTER_SIGMA_PX)
    fit = least_squares(
        lambda p: (columns @ p.reshape(3, 2) - pixels).ravel(),
        start.ravel(), loss="cauchy", f_scale=2 * spread,
    )  # fmt: skip
    found = fit.x.reshape(3, 2)
    left = pixels - columns @ found
    radius = float(np.median([contact.circle.radius_px for contact in contacts]))
    off = np.hypot(*left.T) > OFF * radius
    if off.mean() > OFF_SHARE:
        raise InputError(
            f"{off.sum()} of {len(off)} contacts do not lie where stage_mm says: is each press "
            "beside the place at which it was made?"
        )
    sigma_px = max(spread_about_zero(left.ravel()), LEAST_CENTER_SIGMA_PX)
    covariance = sigma_px**2 * np.linalg.inv(columns.T @ columns)[:2, :2]
    jacobian = found[:2].T  # d(u, v) / d(x, y)
    inverse = np.linalg.inv(jacobian)
    estimates = []
    for axis in range(2):
        value = float(np.linalg.norm(inverse[:, axis]))
        # d inverse = -inverse dJ inverse, of independent rows of J with the same covariance.
        along = inverse[:, axis] / value
        gain = float(np.sum((along @ inverse) ** 2))
        sigma = float(np.sqrt(gain * (inverse[:, axis] @ covariance @ inverse[:, axis])))
        estimates.append(Estimate(value, sigma, "mm/px"))
    return ScaleEstimate(
        "stage",
        *estimates,
        inputs={contact.press.name: contact.press.sha256 for contact in contacts},
        evidence={"places": len(contacts), "center_rms_px": float(np.sqrt(np.mean(left**2)))},
    )
