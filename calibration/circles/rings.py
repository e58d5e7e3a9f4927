# SPDX-License-Identifier: Apache-2.0
"""Colour changes on rings around a contact: few samples, evenly spread over what matters."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from taccel_lab.calibration.capture.captures import ContactCircle

RING_COUNT = 34
RAY_COUNT = 48
REACH_RADII = 1.4
"""Radius of the outermost ring, in contact radii: the gel beside a ball is modelled less well than
under it, and shadows lie there."""
SECTORS = 12
"""Sectors over the angle, each cut into an inner and an outer part."""


@dataclass(frozen=True)
class RingSamples:
    """Samples of one press; those outside the image or on masked pixels are left out."""

    u_px: np.ndarray
    """Columns, shape [n]."""
    v_px: np.ndarray
    """Rows, shape [n]."""
    unit_u: np.ndarray
    """Columns as -1..1 over the image, shape [n]."""
    unit_v: np.ndarray
    change: np.ndarray
    """Colour change [levels], shape [n, 3]."""
    weight: np.ndarray
    """Root of the area that a sample stands for, relative to the mean, shape [n]."""
    sector: np.ndarray
    """Index of the sample's sector, shape [n]."""
    sector_count: int
    reach_px: float
    visible: float
    """Share of the samples that could be taken."""


def sample_rings(
    change: np.ndarray,
    circle: ContactCircle,
    mask: np.ndarray | None = None,
    reach_radii: float = REACH_RADII,
) -> RingSamples:
    """Colour change [height_px, width_px, 3] at the rings around ``circle``, square pixels."""
    height, width = change.shape[:2]
    rings = (np.arange(RING_COUNT) + 0.5) / RING_COUNT
    angle = np.arange(RAY_COUNT) * (2 * np.pi / RAY_COUNT)
    distance = (rings * reach_radii * circle.radius_px)[:, None]
    u = (circle.u_px + distance * np.cos(angle)).ravel()
    v = (circle.v_px + distance * np.sin(angle)).ravel()
    taken = (u >= 0) & (v >= 0) & (u <= width - 1) & (v <= height - 1)
    if mask is not None:
        at = np.clip(np.rint(v), 0, height - 1).astype(int), np.clip(np.rint(u), 0, width - 1)
        taken &= mask[at[0], at[1].astype(int)]
    ring_weight = np.sqrt(rings / rings.mean())
    turn = np.arange(RAY_COUNT) * SECTORS // RAY_COUNT
    sector = 2 * turn[None, :] + (rings * reach_radii > 1.0)[:, None]
    u, v = u[taken], v[taken]
    values = np.zeros((0, 3))
    if len(u):
        columns, lines = u.astype(np.float32)[None], v.astype(np.float32)[None]
        values = cv2.remap(change, columns, lines, cv2.INTER_LINEAR)[0].astype(np.float64)
    return RingSamples(
        u_px=u,
        v_px=v,
        unit_u=2 * u / (width - 1) - 1,
        unit_v=2 * v / (height - 1) - 1,
        change=values.reshape(-1, 3),
        weight=np.repeat(ring_weight, RAY_COUNT)[taken],
        sector=sector.ravel()[taken],
        sector_count=2 * SECTORS,
        reach_px=float(reach_radii * circle.radius_px),
        visible=float(taken.mean()),
    )
