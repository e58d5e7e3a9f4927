# SPDX-License-Identifier: Apache-2.0
"""Captures in memory: a background, presses of one ball, scale and hashes."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Hashable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np

from taccel_lab.calibration.capture.split import PressSplit, split_presses
from taccel_lab.calibration.press_options import UNTOUCHED_RADII
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid

Result = TypeVar("Result")


class Once:
    """What was made of the captures that hold this, and lives as long as they do.

    Captures that ``dataclasses.replace`` makes of others begin anew: what was made of the others
    need not be true of them.
    """

    def __init__(self) -> None:
        self._made: dict[Hashable, Any] = {}

    def of(self, key: Hashable, make: Callable[[], Result]) -> Result:
        """The result under ``key``; ``make`` is called where there is none yet."""
        if key not in self._made:
            self._made[key] = make()
        return self._made[key]


EQUATOR_SLACK = 1.03
"""A contact may look larger than the ball by this factor: circles are off by a pixel or two."""
FAR_SHARE = 0.1
"""Share of a picture that is taken as far from a contact at least."""


@dataclass(frozen=True)
class ContactCircle:
    """Rim of a contact patch in the image; pixel (0, 0) is the centre of the top left pixel."""

    u_px: float
    v_px: float
    radius_px: float

    @property
    def center_px(self) -> tuple[float, float]:
        """Column and row of the centre [px]."""
        return self.u_px, self.v_px

    def distance_px(self, grid: PixelGrid) -> np.ndarray:
        """Distance of every pixel from the centre in column pixels, shape [height_px, width_px].

        Rows are weighed with the scale's ratio, so that a round contact is a circle even when
        the pixels are not square.
        """
        ratio = grid.mm_per_px_y / grid.mm_per_px_x
        du = np.arange(grid.width_px)[None, :] - self.u_px
        dv = (np.arange(grid.height_px)[:, None] - self.v_px) * ratio
        return np.hypot(du, dv)

    def beyond_px(self, grid: PixelGrid) -> float:
        """How far the circle reaches out of the image [px]; below 0 where it is inside."""
        ratio = grid.mm_per_px_x / grid.mm_per_px_y
        sides_u = (self.u_px, grid.width_px - 1 - self.u_px)
        sides_v = (self.v_px / ratio, (grid.height_px - 1 - self.v_px) / ratio)
        return self.radius_px - min(*sides_u, *sides_v)

    def has_center_in(self, grid: PixelGrid) -> bool:
        """Whether the centre lies in the image."""
        return 0 <= self.u_px <= grid.width_px - 1 and 0 <= self.v_px <= grid.height_px - 1

    def center_gap_px(self, other: ContactCircle, grid: PixelGrid) -> float:
        """Distance of the centres in column pixels, rows weighed as in ``distance_px``."""
        ratio = grid.mm_per_px_y / grid.mm_per_px_x
        return math.hypot(self.u_px - other.u_px, (self.v_px - other.v_px) * ratio)

    def up_to_equator(self, ball_radius_mm: float, grid: PixelGrid) -> ContactCircle:
        """The circle, no larger than the ball, with the slack that circles have."""
        most_px = EQUATOR_SLACK * ball_radius_mm / grid.mm_per_px_x
        return replace(self, radius_px=min(self.radius_px, most_px))

    def untouched(self, grid: PixelGrid) -> np.ndarray:
        """Pixels where the gel is at rest, as far as colour tells, bool, [height_px, width_px]."""
        return self.distance_px(grid) > UNTOUCHED_RADII * self.radius_px

    def far(self, grid: PixelGrid, radii: float, usable: np.ndarray | None = None) -> np.ndarray:
        """Usable pixels beyond ``radii`` contact radii, or the farthest tenth of all where those
        are fewer: on a small picture, under a large ball; bool, shape [height_px, width_px]."""
        away = self.distance_px(grid)
        usable = np.ones_like(away, dtype=bool) if usable is None else usable
        if not usable.any():
            return usable
        farthest = float(np.quantile(away[usable], 1 - FAR_SHARE))
        return usable & (away >= min(radii * self.radius_px, farthest))


def widest_gap_px(circles: Sequence[ContactCircle]) -> float:
    """Largest distance of two centres."""
    centers = np.array([(circle.u_px, circle.v_px) for circle in circles])
    return max(float(np.linalg.norm(centers - own, axis=-1).max()) for own in centers)


@dataclass(frozen=True)
class Frame:
    """One image."""

    name: str
    source: str
    """File (and frame) the image comes from, for error messages."""
    sha256: str
    """Hash of the image file, or of the frame's bytes in a packed file."""
    read: Callable[[], np.ndarray]

    def image(self) -> np.ndarray:
        """The image, RGB uint8, shape [height_px, width_px, 3]."""
        return self.read()


@dataclass(frozen=True)
class CapturedPress(Frame):
    """One image of one press."""

    circle: ContactCircle | None = None
    """Contact circle given with the capture, or None."""
    radius_mm: float | None = None
    """Radius of this press's ball, where it is not that of the set [mm]."""
    depth_mm: float | None = None
    """Travel past first touch, where a stage measured it [mm]."""
    force_n: float | None = None
    """Normal force, where a cell measured it [N]."""
    stage_mm: tuple[float, float] | None = None
    """Where a stage pressed, along any two axes at right angles [mm]."""
    checked: bool = False
    """A person has corrected the circle (``contacts.toml``): it wins over any detection."""
    rejected: ContactCircle | None = None
    """A label that the image rejects, taken off."""
    once: Once = field(default_factory=Once, init=False, repr=False, compare=False)

    @property
    def mislabelled(self) -> bool:
        """Whether its image rejects the label that came with it."""
        return self.rejected is not None


def without_labels(
    presses: Sequence[CapturedPress], names: Collection[str]
) -> tuple[CapturedPress, ...]:
    """The presses with the labels of some taken off, which their images reject."""
    return tuple(
        replace(press, circle=None, rejected=press.circle) if press.name in names else press
        for press in presses
    )


@dataclass(frozen=True)
class CaptureSet:
    """Presses of one ball on one sensor, checked when they were loaded; none is a part of a set."""

    source: str
    sensor: str
    background: np.ndarray
    """Image of the untouched sensor, RGB uint8, shape [height_px, width_px, 3]."""
    background_sha256: str
    mask: np.ndarray
    """Pixels that may be used, bool, shape [height_px, width_px]."""
    ball_radius_mm: float
    grid: PixelGrid
    presses: tuple[CapturedPress, ...]
    provenance: dict[str, str]
    heldout: tuple[str, ...] | None = None
    """Names of the presses that the manifest holds out; None where it leaves that to the rule."""

    def __post_init__(self) -> None:
        names = [press.name for press in self.presses]
        twice = sorted(name for name, count in Counter(names).items() if count > 1)
        if twice:
            raise InputError(
                f"{self.source}: press names must differ, {', '.join(twice)} appears twice"
            )
        for press in self.presses:
            if press.circle is not None:
                check_place(press.circle, self.grid, press.source)
                check_radius(press.circle, self.grid, self.ball_radius_mm, press.source)

    def hashes(self) -> dict[str, str]:
        """SHA-256 of every input by name, the background under ``background``."""
        return {"background": self.background_sha256} | {p.name: p.sha256 for p in self.presses}

    def split(self, holdout_every: int) -> PressSplit:
        """Presses to fit and to hold out, by names and labels alone (``split_presses``), also those
        that images reject."""
        given = [replace(press, circle=press.circle or press.rejected) for press in self.presses]
        return split_presses(given, holdout_every, self.heldout, self.source)

    @property
    def rejected(self) -> frozenset[str]:
        """Names of the presses whose labels their images reject."""
        return frozenset(press.name for press in self.presses if press.mislabelled)

    def only(self, indices: Sequence[int]) -> CaptureSet:
        """The set with some of its presses, in the order given."""
        return replace(self, presses=tuple(self.presses[i] for i in indices))


def check_place(circle: ContactCircle, grid: PixelGrid, source: str) -> None:
    """Refuse a contact circle that is none, or whose centre lies outside of the image.

    The border of the image may cut it, as that of a press near the border does.
    """
    values = (circle.u_px, circle.v_px, circle.radius_px)
    if not all(math.isfinite(value) for value in values):
        raise InputError(
            f"{source}: the contact circle (u, v, radius) is {values}; three finite numbers of "
            "pixels are allowed"
        )
    if circle.radius_px < 3.0:
        raise InputError(
            f"{source}: contact radius {circle.radius_px:g} px is too small; at least 3 px"
        )
    if not circle.has_center_in(grid):
        seen = (circle.distance_px(grid) <= circle.radius_px).any()
        lies = "reaches into" if seen else "lies outside of"
        raise InputError(
            f"{source}: the contact circle at ({circle.u_px:g}, {circle.v_px:g}) px with radius "
            f"{circle.radius_px:g} px {lies} the image of {grid.width_px}x{grid.height_px} px, and "
            f"its centre has to be inside: u from 0 to {grid.width_px - 1}, v from 0 to "
            f"{grid.height_px - 1}. Leave the press out, or was the circle made in an image that "
            "was turned or of another size?"
        )


def check_radius(
    circle: ContactCircle, grid: PixelGrid, ball_radius_mm: float, source: str
) -> None:
    """Refuse a contact circle larger than the ball, by more than circles are wrong by.

    A ball pressed to its equator is seen as large as itself.
    """
    radius_mm = circle.radius_px * grid.mm_per_px_x
    if radius_mm > EQUATOR_SLACK * ball_radius_mm:
        raise InputError(
            f"{source}: contact radius {circle.radius_px:g} px is {radius_mm:.3f} mm at "
            f"{grid.mm_per_px_x:g} mm/px, more than the ball's radius of {ball_radius_mm:g} mm; "
            "check mm_per_px_x, the ball's radius and the circle"
        )
