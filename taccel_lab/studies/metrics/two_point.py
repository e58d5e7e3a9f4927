# SPDX-License-Identifier: Apache-2.0
"""What the gel's surface resolves: two pins side by side, the ridges of a grating."""

from __future__ import annotations

import math

import numpy as np

from taccel_lab.studies.metrics.base import NoFigure, metric
from taccel_lab.studies.metrics.evidence import Evidence, profile_mm

RESOLVED = 0.2
"""Contrast from which two pins count as two; Rayleigh's criterion in optics has 0.265 [Born and
Wolf 1999, sec. 8.6.2]."""


def contrast(x: np.ndarray, dent: np.ndarray, half_mm: float) -> float:
    """How far the surface comes up between two dents at -half and +half: 1 - middle / peak."""
    apart = half_mm * np.array([-1.0, 1.0])
    left, right = (
        np.nanmax(dent[np.abs(x - at) <= 0.5 * half_mm], initial=-np.inf) for at in apart
    )
    between = np.nanmin(dent[np.abs(x) <= 0.5 * half_mm], initial=np.inf)
    peak = 0.5 * float(left + right)
    return max(0.0, 1 - float(between) / peak) if peak > 0 else 0.0


def sizes(indenter: str) -> list[float]:
    """The numbers in an indenter's name."""
    return [float(word) for word in indenter.partition(":")[2].split("x")]


@metric(
    "two_point_resolution", "mm",
    "distance between the axes of two pins of 0.25 mm radius at which the surface between them "
    "comes up by 20 % of the dents; not below two pixels", "lower", ("pairs",), each_tool=False,
)  # fmt: skip
def two_point_resolution(evidence: Evidence) -> float:
    """Interpolated between the distances of the press, and from no contrast at no distance."""
    apart, found = [0.0], [0.0]
    for record in sorted(evidence.all("pairs"), key=lambda r: sizes(r.indenter)[1]):
        radius, gap = sizes(record.indenter)
        x, change = profile_mm(record, 2 * radius + gap)
        apart.append(2 * radius + gap)
        found.append(contrast(x, -change, radius + gap / 2))
    rising = np.maximum.accumulate(found)
    if rising[-1] < RESOLVED:
        raise NoFigure(
            f"pins {apart[-1]:g} mm apart are not resolved: contrast {rising[-1]:.3g} of {RESOLVED}"
        )
    k = int(np.flatnonzero(rising >= RESOLVED)[0])
    between = np.interp(RESOLVED, rising[k - 1 : k + 1], apart[k - 1 : k + 1])
    return max(float(between), 2 * evidence.mm_per_px)


@metric(
    "grating_modulation", "1",
    "height that the gel's surface keeps between the ridges of {tool}, over the "
    "depth of the press", "higher", ("grating",),
)  # fmt: skip
def grating_modulation(evidence: Evidence) -> float:
    """Peak to valley of the profile's part at the grating's pitch, over the depth."""
    record = evidence.one("grating")
    pitch = sizes(record.indenter)[0]
    x, change = profile_mm(record, pitch)
    if not np.isfinite(change).all():
        raise NoFigure("the grating reaches beyond the contact face")
    # Two whole pitches in the middle; the mean dent, which is wider, bends as a parabola.
    trend = np.polynomial.Polynomial.fit(x, change, 2)(x)
    turns = 2 * math.pi * x / pitch
    wave = change - trend
    amplitude = 2 * math.hypot(np.mean(wave * np.cos(turns)), np.mean(wave * np.sin(turns)))
    return 2 * amplitude / float(record.depth_mm[record.down][-1])
