# SPDX-License-Identifier: Apache-2.0
"""Findings about the ball's radius and the scale: what contradicts what is stated.

A radius on its own cannot be read from a contact circle. It shows where it contradicts something:

- a contact wider than the ball, or a ball pushed in deeper than the gel is thick (``ball_sizes``);
- travel: a ball that is pressed ``d`` deep leaves a contact of ``a^2 = R d`` on an elastic gel
  (Hertz; K. L. Johnson, Contact Mechanics, 1985, eq. 4.22) and ``a^2 = 2 R d - d^2`` in a gel that
  does not rise beside the ball, so ``a^2 / 2 d < R < a^2 / d``;
- slopes: a ball that is too small has contacts steeper than the gel beside them
  (``check_ball``). A ball that is stated too large does not show there, which is remarked;
- two balls: the colour changes over the contact's centre at a rate of 1/R, so that presses of two
  balls differ as their radii do.

The map from slope to colour is free, so that the colours cannot tell a ball from a larger one that
is pressed less steeply: they bound the radius from below only. A ball that is too small cannot hold
the contacts (their radius ends at the ball's) and its slopes, steep towards the equator, do not fit
the gel beside the contact. A gel that sinks in otherwise than the law says does not fit there
either: before a ball is called wrong, each has had the sink-in that suits it best.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from taccel_lab.calibration.capture.captures import (
    CapturedPress,
    CaptureSet,
    check_place,
    check_radius,
)
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.capture.sensor_facts import SensorFacts, catalogue_view_mm
from taccel_lab.calibration.check import remarks
from taccel_lab.calibration.check.ball_sizes import (
    MIN_TRAVELS,
    TRAVEL_SLACK,
    ball_sizes,
    check_size_of_balls,
)
from taccel_lab.calibration.check.frames import FrameFigures
from taccel_lab.calibration.circles.contact_finder import fit_together
from taccel_lab.calibration.circles.joint_fit import PhotometricFit, fit_contacts
from taccel_lab.calibration.circles.press_model import MAX_CONTACT_RATIO, SINK_IN_SCALE
from taccel_lab.calibration.circles.uncertainty import OTHER_SINK_IN_SCALE
from taccel_lab.calibration.pad import fitted_parameters, past_largest_pad, view_remarks
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.report.remark import Remark, Severity

ODD_RATE = 1.45
"""Centre slopes differ by this factor between balls; presses of one ball by 1.25."""
SAME_PROPORTIONS = 0.02
"""Difference of two images' proportions up to which they may show the same."""
FITTED_PRESSES, MIN_PRESSES = 12, 4
SCALE_FACTOR = 1.4
"""Published scales of one and the same sensor differ by up to this."""
FACTORS = (0.7, 0.85, 1.0, 1.2, 1.45, 1.75, 2.2)
"""Ball radii that are tried, over the stated one."""
ROUNDS = 5
SINK_INS = (SINK_IN_SCALE, SINK_IN_SCALE**2 / OTHER_SINK_IN_SCALE, OTHER_SINK_IN_SCALE)
"""Damping lengths of the gel beside a contact: the usual one and both sides of it."""
WORSE = 0.08
"""Rise of the residual that our model of the sink-in does not explain: on real presses of balls of
known radius the residual changes by up to 8 % between the stated radius and twice that."""
SURE_RISE = 3.0
"""Standard errors, over the presses, that a rise has to have."""


def check_balls(
    frames: Sequence[FrameFigures],
    grid: PixelGrid | None,
    ball_radius_mm: float | None,
    gel_thickness_mm: float | None,
) -> list[Remark]:
    """Findings on the radius; ``grid`` only with a known scale, thickness of a known sensor."""
    found = list(_check_rates(frames, ball_radius_mm))
    if grid is not None and ball_radius_mm is not None:
        sizes = ball_sizes(frames, grid, ball_radius_mm)
        found += check_size_of_balls(sizes, grid.mm_per_px_x, gel_thickness_mm)
        found += _check_travel(frames, grid, ball_radius_mm)
    return found


def _radius_mm(frame: FrameFigures, ball_radius_mm: float | None) -> float | None:
    return frame.press.radius_mm or ball_radius_mm


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
    if len(ratios) < MIN_TRAVELS:
        return []
    ratio = float(np.median(ratios))
    if 1 / TRAVEL_SLACK <= ratio <= 2 * TRAVEL_SLACK:
        return []
    low, high = ratio * ball_radius_mm / 2, ratio * ball_radius_mm
    # Only a radius that is twice what contacts and travel allow is that of a diameter.
    doubled = 1 / TRAVEL_SLACK <= 2 * ratio <= 2 * TRAVEL_SLACK
    return [
        remarks.BALL_CONTRADICTED(
            diameter=" (a diameter taken for it?)" if doubled else "",
            evidence=f"contacts and travel of {len(ratios)} presses belong to a ball of "
            f"{low:.2g} to {high:.2g} mm, stated is {ball_radius_mm:g} mm",
        )
    ]


def center_rate(frame: FrameFigures) -> float:
    """Colour change per pixel at the contact's centre, over all lamps [levels/px]."""
    circle = frame.circle
    if circle is None or not np.isfinite(frame.lamps).all():
        return float("nan")
    return float(np.linalg.norm(frame.lamps)) / circle.radius_px


def _check_rates(frames: Sequence[FrameFigures], ball_radius_mm: float | None) -> list[Remark]:
    """Whether presses of several balls differ as their stated radii do."""
    rates = np.array([center_rate(frame) for frame in frames])
    radii = np.array([_radius_mm(frame, ball_radius_mm) or np.nan for frame in frames])
    known = np.isfinite(rates) & np.isfinite(radii) & (rates > 0)
    balls = np.unique(radii[known])
    if known.sum() < 6 or len(balls) < 2:
        return []
    return _check_stated_ratio(rates[known], radii[known], balls)


def _check_stated_ratio(rates: np.ndarray, radii: np.ndarray, balls: np.ndarray) -> list[Remark]:
    """Whether presses of several balls differ as their stated radii do."""
    first, last = float(balls[0]), float(balls[-1])
    seen = float(np.median(rates[radii == first]) / np.median(rates[radii == last]))
    stated = last / first
    if 1 / ODD_RATE < seen / stated < ODD_RATE:
        return []
    return [
        remarks.BALL_CONTRADICTED(
            diameter="",
            evidence=f"balls of {first:g} and {last:g} mm are stated, a ratio of {stated:.2f}; by "
            f"the colours over their contacts it is {seen:.2f}",
            blocks=("color", "normals", "scale"),
        )
    ]


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
        presses=tuple(_without_odd_label(plain[i], grid, folder.ball_radius_mm) for i in pick),
        provenance={},
    )
    found = check_ball(chosen, remarks.BY_COLOR)
    if found is None or (found.code == remarks.BALL_FROM_BELOW.code and _told_otherwise(folder)):
        return []
    return [found]


def _without_odd_label(
    press: CapturedPress, grid: PixelGrid, ball_radius_mm: float
) -> CapturedPress:
    """The press as it is where its label can be one of the ball and leaves its circle free: what
    else labels are is a finding of their own, and colours tell without them."""
    circle = press.circle
    if circle is None:
        return press
    try:
        check_place(circle, grid, press.source)
        check_radius(circle, grid, ball_radius_mm, press.source)
    except InputError:
        return replace(press, circle=None)
    return replace(press, circle=None) if press.checked else press


def _told_otherwise(folder: CaptureFolder) -> bool:
    """Whether travel or several balls bound the radius from above, too."""
    travels = sum(press.depth_mm is not None for press in folder.presses)
    return travels >= MIN_TRAVELS or len(folder.ball_radii_mm()) > 1


def check_size(size_px: tuple[int, int], usual_px: tuple[int, int], family: str) -> list[Remark]:
    """Whether images have the proportions of the sensor's usual ones, lying or upright."""
    (width, height), (usual_width, usual_height) = size_px, usual_px
    if sorted(size_px) == sorted(usual_px):
        return []
    longer = max(size_px) / min(size_px) * min(usual_px) / max(usual_px)
    if abs(longer - 1) < SAME_PROPORTIONS:
        return []
    return [
        remarks.SIZE_OTHER(
            width=width,
            height=height,
            family=family,
            usual_width=usual_width,
            usual_height=usual_height,
        )
    ]


def check_scale(
    grid: PixelGrid, mask: np.ndarray | None, facts: SensorFacts, design: Mapping[str, Any]
) -> list[Remark]:
    """Whether the stated scale fits the sensor: its pad's plan, and its usual field of view, or
    that of the catalogue's sensors where it is none of them."""
    found = past_largest_pad(facts.family, grid, design) or view_remarks(
        fitted_parameters(facts.family, grid, design), grid, mask
    )
    if any(remark.severity == Severity.ERROR for remark in found):
        return found
    longer = max(grid.width_px * grid.mm_per_px_x, grid.height_px * grid.mm_per_px_y)
    if facts.view_mm is None:
        low, high = catalogue_view_mm()
        usual = f"sensors usually show {low:.0f} to {high:.0f} mm"
    else:
        low, high = facts.view_mm / SCALE_FACTOR, facts.view_mm * SCALE_FACTOR
        usual = f"a {facts.family} usually shows {facts.view_mm:.1f} mm"
    if not low < longer < high:
        found.append(remarks.SCALE_UNUSUAL(mm_per_px=grid.mm_per_px_x, length=longer, usual=usual))
    return found


def check_ball(captures: CaptureSet, blocks: Sequence[str] = ()) -> Remark | None:
    """Whether the colours of presses of one ball allow its stated radius: ``WRONG_BALL_RADIUS``, or
    ``BALL_FROM_BELOW`` where they do. None with fewer than 4 fitted presses.

    ``blocks`` are those that the remark concerns.
    """
    found, stated = fit_together(captures), captures.ball_radius_mm
    if found.fit is None or len(found.samples) < MIN_PRESSES:
        return None
    start, count = found.fit, len(found.samples)

    @cache
    def fitted(factor: float, sink_in: float) -> PhotometricFit:
        ball_px = [factor * ball for ball in found.ball_px]
        return fit_contacts(found.samples, start, ball_px, iterations=ROUNDS, sink_in=sink_in)

    def judged(fits: dict[float, PhotometricFit]) -> tuple[float, int]:
        """Smallest radius [mm] that the colours allow, and presses whose contact is as large as the
        stated ball."""
        contacts = zip(fits[1.0].contacts, found.ball_px, strict=True)
        largest = 0.99 * MAX_CONTACT_RATIO
        pinned = sum(contact.circle.radius_px > largest * ball for contact, ball in contacts)
        return stated * _lowest(fits), pinned

    fits = {factor: fitted(factor, SINK_IN_SCALE) for factor in FACTORS if factor >= 1.0}
    lowest, pinned = judged(fits)
    # Where larger balls allow the stated one, smaller ones cannot take that back.
    if stated < lowest or pinned > count / 4:
        # Contacts as wide as the ball speak against it whatever the gel does beside them.
        sink_ins = SINK_INS[:1] if pinned > count / 4 else SINK_INS
        fits = {
            factor: min((fitted(factor, one) for one in sink_ins), key=lambda fit: fit.rms_levels)
            for factor in FACTORS
        }
        lowest, pinned = judged(fits)
    if stated >= lowest and pinned <= count / 4:
        return remarks.BALL_FROM_BELOW(
            rms=fits[1.0].rms_levels,
            stated=stated,
            larger=FACTORS[-1] * stated,
            larger_rms=fits[FACTORS[-1]].rms_levels,
            blocks=blocks,
        )
    best = min(fits, key=lambda factor: fits[factor].rms_levels)
    return remarks.WRONG_BALL_RADIUS(
        rms=fits[1.0].rms_levels,
        stated=stated,
        best_rms=fits[best].rms_levels,
        best=best * stated,
        lowest=lowest,
        pinned=pinned,
        count=count,
        blocks=blocks,
    )


def _lowest(fits: dict[float, PhotometricFit]) -> float:
    """Smallest factor whose residuals do not surely exceed the best ones; factors rise.

    Between two factors that are tried, the rise is taken as linear.
    """
    factors = list(fits)
    log_sums = np.array([np.log(np.maximum(fit.sums_by_press, 1e-9)) for fit in fits.values()])
    best = int(np.argmin(log_sums.mean(axis=1)))
    rise = (log_sums - log_sums[best]) / 2  # of the residual, not of its square
    mean = rise.mean(axis=1)
    error = rise.std(axis=1, ddof=1) / np.sqrt(rise.shape[1])
    excess = np.minimum(mean - np.log1p(WORSE), mean - SURE_RISE * error)
    low = factors[0]
    for k in range(best, 0, -1):
        if excess[k - 1] > 0:
            inside = max(-excess[k], 0.0)
            part = inside / max(inside + excess[k - 1], 1e-9)
            low = factors[k] + part * (factors[k - 1] - factors[k])
            break
    return float(low)
