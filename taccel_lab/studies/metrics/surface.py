# SPDX-License-Identifier: Apache-2.0
"""What the contact face shows of a load, an edge, two pins, a grating, and in several places."""

from __future__ import annotations

import math

import numpy as np

from taccel_lab.studies.metrics.base import metric
from taccel_lab.studies.metrics.design_point import NoFigure
from taccel_lab.studies.metrics.evidence import (
    Evidence,
    at_load,
    contact_radius_mm,
    dent_mm,
    profile_mm,
)
from taccel_lab.studies.presses.press_record import PressRecord


@metric(
    "sensitivity_um", "um/N",
    "largest motion of the contact face along the press of {tool} at {load}, over the load",
    "higher", ("sphere",), smooth=True,
)  # fmt: skip
def sensitivity_um(evidence: Evidence) -> float:
    """Peak of the dent over the load."""
    record = evidence.one("sphere")
    return at_load(record, dent_mm(record), evidence.load_n) * 1e3 / evidence.load_n


@metric(
    "sensitivity_px", "px/N", "contact radius of {tool} at {load} in pixels, over the load",
    "higher", ("sphere",),
)  # fmt: skip
def sensitivity_px(evidence: Evidence) -> float:
    """Contact radius over the size of a pixel and the load."""
    record = evidence.one("sphere")
    radius = at_load(record, contact_radius_mm(record), evidence.load_n)
    return radius / evidence.mm_per_px / evidence.load_n


@metric(
    "sensitivity_marker_px", "px/N",
    "largest motion of a marker in the image under {tool} at {load}, over the load; points 1 mm "
    "apart stand for markers on a gel without", "higher", ("sphere",),
)  # fmt: skip
def sensitivity_marker_px(evidence: Evidence) -> float:
    """Largest |motion| in the image."""
    record = evidence.one("sphere")
    moved = evidence.marker_motion_px(record, range(record.down.stop))
    pixels = np.linalg.norm(moved, axis=-1).max(axis=1)
    return at_load(record, pixels, evidence.load_n) / evidence.load_n


@metric(
    "sensitivity_grey", "levels/N",
    "mean change of the camera's grey levels in the dent of {tool} at {load}, over the load",
    "higher", ("sphere",),
)  # fmt: skip
def sensitivity_grey(evidence: Evidence) -> float:
    """Follows from the optical model, mean of the three channels."""
    record = evidence.one("sphere")
    change = evidence.picture_change(record, list(range(record.down.stop)))
    return at_load(record, change, evidence.load_n) / evidence.load_n


@metric(
    "contact_area", "mm2", "area of the contact of {tool} at {load}", "none",
    ("sphere",),
)  # fmt: skip
def contact_area(evidence: Evidence) -> float:
    """pi a^2 with the radius of the disc of equal area."""
    record = evidence.one("sphere")
    return math.pi * at_load(record, contact_radius_mm(record), evidence.load_n) ** 2


_HALF_MM = 8.0


def rise_width(x: np.ndarray, dent: np.ndarray) -> float:
    """Mean distance on both sides over which a dent falls from 90 % to 10 % of its peak.

    ``x`` ascending, ``dent`` positive in the dent, NaN beside the face; [n] each. Raises
    NoFigure when a side does not fall that far.
    """
    seen = np.isfinite(dent)
    x, dent = x[seen], dent[seen]
    peak = int(np.argmax(dent))
    widths = []
    for side in (slice(peak, None), slice(peak, None, -1)):
        place, share = np.abs(x[side] - x[peak]), dent[side] / dent[peak]
        crossed = []
        for level in (0.9, 0.1):
            below = np.flatnonzero(share <= level)
            if len(below) == 0:
                raise NoFigure(
                    f"the dent of the edge does not fall below {level:.0%} of its depth on the pad"
                )
            k = int(below[0])
            crossed.append(np.interp(-level, -share[k - 1 : k + 1], place[k - 1 : k + 1]))
        widths.append(crossed[1] - crossed[0])
    return float(np.mean(widths))


@metric(
    "edge_sharpness", "mm",
    "distance over which the dent of {tool} falls from 90 % to 10 % of its depth",
    "lower", ("edge",),
)  # fmt: skip
def edge_sharpness(evidence: Evidence) -> float:
    """10-90 % width of the profile across the edge, the mean of both sides."""
    record = evidence.one("edge")
    x, change = profile_mm(record, _HALF_MM)
    return rise_width(x, -change)


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


def _places(evidence: Evidence) -> list[PressRecord]:
    """Records of the press in several places, three at least."""
    records = evidence.all("places")
    if len(records) < 3:
        raise NoFigure(f"press places has {len(records)} places; three are needed")
    return records


def variation(values: list[float]) -> float:
    """Standard deviation of the sample over its mean."""
    return float(np.std(values, ddof=1) / np.mean(values))


@metric(
    "uniformity_force", "%",
    "coefficient of variation of the force of {tool} at one depth in five places", "lower",
    ("places",),
)  # fmt: skip
def uniformity_force(evidence: Evidence) -> float:
    """Compares at the greatest depth that all places reach."""
    records = _places(evidence)
    depth = min(float(record.depth_mm[record.down][-1]) for record in records)
    forces = [
        float(np.exp(np.interp(np.log(depth), np.log(r.depth_mm[r.down]), np.log(r.normal_n))))
        for r in records
    ]
    return 100 * variation(forces)


@metric(
    "uniformity_contact", "%",
    "coefficient of variation of the contact radius of {tool} at one load in five places",
    "lower", ("places",),
)  # fmt: skip
def uniformity_contact(evidence: Evidence) -> float:
    """Compares at half of the least force that the places end with."""
    records = _places(evidence)
    load = 0.5 * min(float(record.normal_n[-1]) for record in records)
    return 100 * variation([at_load(r, contact_radius_mm(r), load) for r in records])


@metric(
    "uniformity_image", "%",
    "coefficient of variation of the change of the picture over the force, of {tool} in five "
    "places", "lower", ("places",),
)  # fmt: skip
def uniformity_image(evidence: Evidence) -> float:
    """Compares at the greatest depth of each place: grey levels in the dent over the force."""
    records = _places(evidence)
    response = [
        float(evidence.picture_change(r, [r.down.stop - 1])[0] / r.normal_n[-1]) for r in records
    ]
    return 100 * variation(response)
