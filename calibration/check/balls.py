# SPDX-License-Identifier: Apache-2.0
"""Findings about the ball's radius and the scale: what contradicts what is stated.

A radius on its own cannot be read from a contact circle. It shows where it contradicts something:

- a contact wider than the ball, or a ball pushed in deeper than the gel is thick;
- travel: a ball that is pressed ``d`` deep leaves a contact of ``a^2 = R d`` on an elastic gel
  (Hertz; K. L. Johnson, Contact Mechanics, 1985, eq. 4.22) and ``a^2 = 2 R d - d^2`` in a gel that
  does not rise beside the ball, so ``a^2 / 2 d < R < a^2 / d``;
- slopes: a ball that is too small has contacts steeper than the gel beside them
  (``taccel_lab.calibration.contacts.ball_radius``; a ball that is stated too large does not show
  there);
- two balls: the colour changes over the contact's centre at a rate of 1/R, so that presses of one
  ball agree and those of two differ as their radii do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from taccel_lab.calibration.capture.captures import CaptureSet
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.check import remarks
from taccel_lab.calibration.check.findings import name_some
from taccel_lab.calibration.check.frames import FrameFigures
from taccel_lab.calibration.contacts.ball_radius import check_ball
from taccel_lab.calibration.contacts.fit import find_contacts
from taccel_lab.calibration.result import Remark
from taccel_lab.calibration.robust_spread import spread_about_zero
from taccel_lab.geometry import PixelGrid

TRAVEL_SLACK = 1.35
"""Factor left to both bounds: contact radii are known to 5 %, first touch less well."""
ODD_RATE = 1.45
"""Centre slopes differ by this factor between balls; presses of one ball by 1.25."""
BALL_FACTOR = 4.0
"""Two balls of one set hardly differ by more."""
FIELD_SLACK = 1.05
FITTED_PRESSES, MIN_PRESSES = 12, 4
FEW_SHARE = 0.1
"""So many contacts may be wrongly found or labelled before the radius is at fault."""
SCALE_FACTOR = 1.4
"""Published scales of one and the same sensor differ by up to this."""


def check_balls(
    frames: Sequence[FrameFigures],
    grid: PixelGrid | None,
    ball_radius_mm: float | None,
    gel_thickness_mm: float | None,
) -> list[Remark]:
    """Findings on the radius; ``grid`` only with a known scale, thickness of a known sensor."""
    found = list(_check_rates(frames, ball_radius_mm))
    if grid is not None and ball_radius_mm is not None:
        found += _check_size(frames, grid, ball_radius_mm, gel_thickness_mm)
        found += _check_travel(frames, grid, ball_radius_mm)
    return found


def _radius_mm(frame: FrameFigures, ball_radius_mm: float | None) -> float | None:
    return frame.press.radius_mm or ball_radius_mm


def _check_size(
    frames: Sequence[FrameFigures],
    grid: PixelGrid,
    ball_radius_mm: float,
    gel_thickness_mm: float | None,
) -> list[Remark]:
    too_wide, too_deep, widest, deepest, measured = [], [], 0.0, 0.0, 0
    for frame in frames:
        smallest = _smallest_radius_px(frame)
        if smallest is None:
            continue
        measured += 1
        radius = _radius_mm(frame, ball_radius_mm) or ball_radius_mm
        contact = smallest * grid.mm_per_px_x
        if contact > radius:
            too_wide.append(frame.press.name)
            widest = max(widest, contact)
            continue
        depth = radius - np.sqrt(radius**2 - contact**2)
        if gel_thickness_mm is not None and depth > 0.9 * gel_thickness_mm:
            too_deep.append(frame.press.name)
            deepest = max(deepest, float(depth))
    found = []
    if too_wide:
        found.append(
            remarks.BALL_TOO_SMALL(
                wider=len(too_wide),
                count=measured,
                widest=widest,
                mm_per_px=grid.mm_per_px_x,
                stated=ball_radius_mm,
                names=name_some(too_wide),
                frames=too_wide,
                grave=len(too_wide) > FEW_SHARE * measured,
            )
        )
    if too_deep:
        found.append(
            remarks.BALL_TOO_DEEP(
                count=len(too_deep),
                deepest=deepest,
                gel=gel_thickness_mm,
                frames=too_deep,
            )
        )
    return found


def _smallest_radius_px(frame: FrameFigures) -> float | None:
    """The contact's radius at the least: given or found, less what the detector is unsure of."""
    radii = []
    if frame.press.circle is not None:
        radii.append(frame.press.circle.radius_px)
    if frame.contact is not None:
        unsure = max(2.0, 2 * frame.contact.radius_sigma_px)
        radii.append(frame.contact.circle.radius_px - unsure)
    return min(radii, default=None)


def _check_travel(
    frames: Sequence[FrameFigures], grid: PixelGrid, ball_radius_mm: float
) -> list[Remark]:
    ratios = []
    for frame in frames:
        circle, depth = frame.circle, frame.press.depth_mm
        if circle is None or depth is None or depth <= 0:
            continue
        radius = _radius_mm(frame, ball_radius_mm) or ball_radius_mm
        contact = circle.radius_px * grid.mm_per_px_x
        ratios.append(contact**2 / depth / radius)
    if len(ratios) < 2:
        return []
    ratio = float(np.median(ratios))
    if 1 / TRAVEL_SLACK <= ratio <= 2 * TRAVEL_SLACK:
        return []
    low, high = ratio * ball_radius_mm / 2, ratio * ball_radius_mm
    return [
        remarks.BALL_AGAINST_TRAVEL(count=len(ratios), low=low, high=high, stated=ball_radius_mm)
    ]


def center_rate(frame: FrameFigures) -> float:
    """Colour change per pixel at the contact's centre, over all lamps [levels/px]."""
    circle = frame.circle
    if circle is None or not np.isfinite(frame.lamps).all():
        return float("nan")
    return float(np.linalg.norm(frame.lamps)) / circle.radius_px


def _check_rates(frames: Sequence[FrameFigures], ball_radius_mm: float | None) -> list[Remark]:
    rates = np.array([center_rate(frame) for frame in frames])
    radii = np.array([_radius_mm(frame, ball_radius_mm) or np.nan for frame in frames])
    if not np.isfinite(radii).any():
        radii = np.ones(len(frames))
    known = np.isfinite(rates) & np.isfinite(radii) & (rates > 0)
    if known.sum() < 6:
        return []
    balls = np.unique(radii[known])
    if len(balls) > 1:
        return _check_stated_ratio(rates[known], radii[known], balls)
    middle = float(np.median(rates[known]))
    spread = float(np.exp(spread_about_zero(np.log(rates[known] / middle))))
    limit = max(ODD_RATE, spread**4)
    odd = known & ((rates > limit * middle) | (rates < middle / limit))
    if not odd.any() or odd.sum() > 0.4 * known.sum():
        return []
    names = [frame.press.name for frame, is_odd in zip(frames, odd, strict=True) if is_odd]
    factor = middle / float(np.median(rates[odd]))
    as_ball = f"as with a ball of {factor:.2g} times the radius, or a wrong circle"
    if not 1 / BALL_FACTOR < factor < BALL_FACTOR:
        as_ball = "a wrong circle, or hardly a contact"
    return [
        remarks.OTHER_BALL(names=name_some(names), factor=1 / factor, cause=as_ball, frames=names)
    ]


def _check_stated_ratio(rates: np.ndarray, radii: np.ndarray, balls: np.ndarray) -> list[Remark]:
    """Whether presses of several balls differ as their stated radii do."""
    first, last = float(balls[0]), float(balls[-1])
    seen = float(np.median(rates[radii == first]) / np.median(rates[radii == last]))
    stated = last / first
    if 1 / ODD_RATE < seen / stated < ODD_RATE:
        return []
    return [remarks.BALL_RATIO(first=first, last=last, stated=stated, seen=seen)]


def check_slopes(folder: CaptureFolder, background: np.ndarray) -> list[Remark]:
    """Whether the colours of up to twelve presses allow the stated ball."""
    plain = tuple(press for press in folder.presses if press.radius_mm is None)
    if len(plain) < MIN_PRESSES or folder.mm_per_px is None or folder.ball_radius_mm is None:
        return []
    pick = np.unique(np.linspace(0, len(plain) - 1, min(len(plain), FITTED_PRESSES)).astype(int))
    grid = PixelGrid(background.shape[1], background.shape[0], *folder.mm_per_px)
    chosen = CaptureSet(
        source=folder.source,
        sensor=folder.sensor,
        background=background,
        background_sha256="",
        mask=np.ones(background.shape[:2], dtype=bool) if folder.mask is None else folder.mask,
        ball_radius_mm=folder.ball_radius_mm,
        grid=grid,
        # Labels that contradict the ball are a finding of their own.
        presses=tuple(replace(plain[i], circle=None) for i in pick),
        provenance={},
    )
    found = check_ball(chosen, find_contacts(chosen))
    if found is None:
        return []
    return [found.remark(remarks.BY_COLOR)]


def check_scale(
    mm_per_px: tuple[float, float],
    size_px: tuple[int, int],
    pad_mm: tuple[float, float] | None,
    usual_width_mm: float | None,
    family: str,
) -> list[Remark]:
    """Whether the stated scale fits the sensor: its pad's plan, and its usual field of view."""
    width, height = size_px[0] * mm_per_px[0], size_px[1] * mm_per_px[1]
    longer, shorter = max(width, height), min(width, height)
    # Lenses of domes see past the pad, as their usual view says.
    wide = pad_mm is None or (usual_width_mm or 0.0) > max(pad_mm)
    if (
        pad_mm is not None
        and not wide
        and (longer > FIELD_SLACK * max(pad_mm) or shorter > FIELD_SLACK * min(pad_mm))
    ):
        return [
            remarks.SCALE_PAST_PAD(
                mm_per_px_x=mm_per_px[0],
                mm_per_px_y=mm_per_px[1],
                width=width,
                height=height,
                family=family,
                pad_x=pad_mm[0],
                pad_y=pad_mm[1],
            )
        ]
    if usual_width_mm is not None and not (
        1 / SCALE_FACTOR < longer / usual_width_mm < SCALE_FACTOR
    ):
        return [
            remarks.SCALE_UNUSUAL(
                mm_per_px=mm_per_px[0], length=longer, family=family, usual=usual_width_mm
            )
        ]
    return []
