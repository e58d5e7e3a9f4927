# SPDX-License-Identifier: Apache-2.0
"""Findings about contacts beside the ball that is said to have left them: wider than it is, deeper
than the gel is thick, and whether a ball of half the stated radius could have left them as well.

Callipers say a diameter, and colours fit it as well as a radius: with the ball twice as large, all
slopes and depths are half of what they are. A contact that is wider than half of what is stated
tells, as does a travel: what is stated is then no diameter.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.check import remarks
from taccel_lab.calibration.check.frames import FrameFigures
from taccel_lab.calibration.circles.ball_surface import depth_of_contact
from taccel_lab.calibration.circles.grey import LABEL_SHARE, LABEL_SIGMA_PX
from taccel_lab.calibration.remarks import name_some
from taccel_lab.geometry import PixelGrid
from taccel_lab.reading.bonded_layer import BondedLayer
from taccel_lab.report.remark import Remark

SURE = 2.0
"""Standard deviations by which a contact has to be wider than its ball."""
FOUND_SIGMA_PX, SCALE_SHARE = 1.0, 0.02
"""Standard deviations of a found contact's radius (and the least of them [px]), and of a scale that
somebody states. Found circles lie 2 px and 3 % off careful labels.
"""
FEW_SHARE = 0.1
"""So many contacts may be wrongly found or labelled before the radius is at fault."""
DEEPEST_SHARE = 0.9
"""Part of its thickness that a gel can be pressed in by."""
TRAVEL_SLACK = 1.35
"""Factor left to bounds by travel: contact radii are known to 5 %, first touch less well."""
MIN_TRAVELS, MOST_TRAVELS = 2, 6
"""Fewest presses whose travel says something of the ball, and as many as are looked at."""


@dataclass(frozen=True)
class BallSize:
    """A contact beside the ball that is said to have left it."""

    name: str
    contact_mm: float
    """Radius of the contact."""
    sigma_mm: float
    ball_mm: float

    @property
    def _least_mm(self) -> float:
        return max(self.contact_mm - SURE * self.sigma_mm, 0.0)

    def is_wider(self, share: float = 1.0) -> bool:
        """Say whether it is surely wider than a ball of that share of the stated radius."""
        return self._least_mm > share * self.ball_mm

    def cap_mm(self, share: float = 1.0) -> float:
        """Height of such a ball's cap over the least contact; endless where it is wider."""
        if self.is_wider(share):
            return math.inf
        ball = share * self.ball_mm
        return ball - math.sqrt(ball**2 - self._least_mm**2)


def ball_sizes(
    frames: Sequence[FrameFigures], grid: PixelGrid, ball_radius_mm: float
) -> list[BallSize]:
    """Contacts of all presses that have one."""
    sizes = []
    for frame in frames:
        size = _contact_mm(frame, grid)
        if size is not None:
            radius = frame.press.radius_mm or ball_radius_mm
            sizes.append(BallSize(frame.press.name, *size, radius))
    return sizes


def check_size_of_balls(
    sizes: Sequence[BallSize], mm_per_px: float, gel_thickness_mm: float | None
) -> list[Remark]:
    """Contacts that the stated balls cannot have left."""
    found = []
    wider = [one for one in sizes if one.is_wider()]
    if wider:
        worst = max(wider, key=lambda one: one.contact_mm / one.ball_mm)
        names = [one.name for one in wider]
        found.append(
            remarks.BALL_TOO_SMALL(
                wider=len(names),
                count=len(sizes),
                first=worst.name,
                widest=worst.contact_mm,
                sigma=worst.sigma_mm,
                mm_per_px=mm_per_px,
                stated=worst.ball_mm,
                names=name_some(names),
                frames=names,
                grave=len(names) > FEW_SHARE * len(sizes),
            )
        )
    if gel_thickness_mm is None:
        return found
    most_mm = DEEPEST_SHARE * gel_thickness_mm
    deeper = {one.name: one.cap_mm() for one in sizes if most_mm < one.cap_mm() < math.inf}
    if deeper:
        found.append(
            remarks.BALL_CONTRADICTED(
                diameter="",
                evidence=f"{len(deeper)} contacts of the stated ball would be up to "
                f"{max(deeper.values()):.1f} mm deep in a gel of {gel_thickness_mm:g} mm",
                frames=list(deeper),
            )
        )
    return found


def check_diameter(
    frames: Sequence[FrameFigures],
    sizes: Sequence[BallSize],
    layer: BondedLayer | None,
) -> list[Remark]:
    """Remark where balls half as large as stated, whose diameters were taken for radii, could have
    left the contacts, too. ``layer``: the gel, where it is known."""
    most_mm = math.inf if layer is None else DEEPEST_SHARE * layer.thickness_mm
    told = sum(one.cap_mm(0.5) > most_mm or one.is_wider(0.5) for one in sizes)
    if not sizes or told > FEW_SHARE * len(sizes) or _travel_tells(frames, sizes, layer):
        return []
    largest = max(one.contact_mm / one.ball_mm for one in sizes)
    return [remarks.BALL_OR_DIAMETER(stated=sizes[0].ball_mm, largest=largest)]


def _travel_tells(
    frames: Sequence[FrameFigures], sizes: Sequence[BallSize], layer: BondedLayer | None
) -> bool:
    """Say whether presses went less deep than half the stated ball does in contacts of their size.

    In a layer it goes twice as deep as the stated one and more; in an unknown gel as deep as its
    cap at least, ``a^2 / R`` of the stated radius.
    """
    travels = {frame.press.name: frame.press.depth_mm for frame in frames if frame.press.depth_mm}
    known = [one for one in sizes if one.name in travels]
    if len(known) < MIN_TRAVELS:
        return False
    pick = np.unique(np.linspace(0, len(known) - 1, min(len(known), MOST_TRAVELS)).astype(int))
    known = [known[i] for i in pick]
    if layer is None:
        halves = [one.contact_mm**2 / one.ball_mm for one in known]
    else:
        halves = [2 * depth_of_contact(one.contact_mm, one.ball_mm, layer) for one in known]
    shares = [travels[one.name] / half for one, half in zip(known, halves, strict=True)]
    return TRAVEL_SLACK * float(np.median(shares)) < 1.0


def _contact_mm(frame: FrameFigures, grid: PixelGrid) -> tuple[float, float] | None:
    """Radius of the contact and its standard deviation [mm]: of the smaller of the circles given
    and found; None without either."""
    radii = []
    if frame.press.circle is not None:
        label = frame.press.circle.radius_px
        radii.append((label, max(LABEL_SIGMA_PX, LABEL_SHARE * label)))
    if frame.contact is not None:
        found = frame.contact.circle.radius_px
        radii.append(
            (found, max(frame.contact.radius_sigma_px, FOUND_SIGMA_PX, LABEL_SHARE * found))
        )
    if not radii:
        return None
    radius, sigma = min(radii)
    share = np.hypot(sigma / radius, SCALE_SHARE)
    return radius * grid.mm_per_px_x, float(share * radius * grid.mm_per_px_x)
