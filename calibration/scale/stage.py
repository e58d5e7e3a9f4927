# SPDX-License-Identifier: Apache-2.0
"""The scale from where a stage pressed: centres of contacts against places in millimetres.

The stage's axes may lie any way round in the image, also mirrored:

    (x, y) = M (u, v) + t

where the columns of M are what a pixel along the image's rows and columns is on the stage, so that
their lengths are mm/px along x and y.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import least_squares

from taccel_lab.calibration.result import Estimate
from taccel_lab.calibration.robust_spread import spread_about_zero
from taccel_lab.calibration.scale.estimate import ScaleEstimate
from taccel_lab.calibration.scale.spheres import BallContact
from taccel_lab.errors import InputError

LEAST_PLACES = 4
LEAST_SIGMA_PX = 0.5
"""Centres of contacts are not known better than this."""
OFF, OFF_SHARE = 0.5, 0.1
"""Contact radii between a contact and its place, and the part of all contacts that may lie so: a
table that is out of step by one press is off wherever the place changes."""


def scale_from_stage(contacts: Sequence[BallContact]) -> ScaleEstimate:
    """mm/px along x and y from contacts whose press has a ``stage_mm``.

    Raises:
        InputError: Places too few, or all on one line; contacts that do not lie as the places do.
    """
    stage = np.array([contact.press.stage_mm for contact in contacts], dtype=float)
    pixels = np.array([contact.center_px for contact in contacts])
    apart = np.linalg.svd(stage - stage.mean(axis=0), compute_uv=False)
    if len(np.unique(stage, axis=0)) < LEAST_PLACES or apart[1] < 0.05 * apart[0]:
        raise InputError(
            f"the stage pressed at too few places, or all on one line; at least {LEAST_PLACES} "
            "that span the gel are needed"
        )
    # A contact in pixels by the place: what is measured, with its error, is the pixel.
    columns = np.column_stack([stage, np.ones(len(stage))])
    start, *_ = np.linalg.lstsq(columns, pixels, rcond=None)
    spread = max(spread_about_zero((pixels - columns @ start).ravel()), LEAST_SIGMA_PX)
    fit = least_squares(
        lambda p: (columns @ p.reshape(3, 2) - pixels).ravel(),
        start.ravel(), loss="cauchy", f_scale=2 * spread,
    )  # fmt: skip
    found = fit.x.reshape(3, 2)
    left = pixels - columns @ found
    radius = float(np.median([contact.radius_px for contact in contacts]))
    off = np.hypot(*left.T) > OFF * radius
    if off.mean() > OFF_SHARE:
        raise InputError(
            f"{off.sum()} of {len(off)} contacts do not lie where stage_mm says: is each press "
            "beside the place at which it was made?"
        )
    sigma_px = max(spread_about_zero(left.ravel()), LEAST_SIGMA_PX)
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
