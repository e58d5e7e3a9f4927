# SPDX-License-Identifier: Apache-2.0
"""Labels of a capture folder that a person corrects: places on a rim become a circle in the file.

A label of the manifest stays there. What is clicked goes into ``contacts.toml``, which wins.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

import numpy as np

from taccel_lab.calibration.capture.captures import (
    CapturedPress,
    ContactCircle,
    check_place,
    check_radius,
)
from taccel_lab.calibration.capture.contacts_file import (
    CONTACTS_NAME,
    read_overrides,
    save_contact,
)
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.capture.load import load_capture_folder
from taccel_lab.calibration.capture.schema import MANIFEST_NAME
from taccel_lab.calibration.circles.contact_finder import seen_contact
from taccel_lab.errors import InputError
from taccel_lab.files.inner_path import own_place
from taccel_lab.geometry import PixelGrid

RIM_POINTS = 3
"""Least number of places on a rim that make a circle."""
Origin = Literal["clicked", "label", "found", "none", "left out"]


@dataclass(frozen=True)
class Shown:
    """A press as it is labelled now."""

    press: CapturedPress
    circle: ContactCircle | None
    origin: Origin
    """Whence the circle comes: of ``contacts.toml``, of the manifest, or found in the image."""


def _now() -> str:
    return datetime.now(UTC).strftime("%Y-%m-%d %H:%M:%S UTC")


@dataclass
class Labelling:
    """The ball presses of a capture folder, one of which is looked at."""

    folder: CaptureFolder
    path: Path
    """``contacts.toml`` of the folder."""
    now: Callable[[], str] = _now
    at: int = 0
    """Number of the press that is looked at."""
    clicks: list[tuple[float, float]] = field(default_factory=list)
    """Places on its rim [px]."""
    saved: dict[str, ContactCircle | None] = field(default_factory=dict)
    """What was kept so far by the presses' names; None for one that is left out."""

    @classmethod
    def of(cls, path: Path) -> Labelling:
        """The presses of the folder ``path``.

        Raises InputError where there is no capture folder, none of a layout that can be written
        to, no background or no press, and where the file of labels is a link.
        """
        folder = load_capture_folder(path, corrected=False)
        if Path(folder.source).name != MANIFEST_NAME:
            raise InputError(
                f"{path} is one file, beside which no label can be kept; make a capture folder of "
                "it: taccel-lab capture import"
            )
        folder.require_background()
        if not folder.presses:
            raise InputError(f"{folder.source} holds no ball presses, whose circles are labels")
        found = cls(folder, own_place(folder.root, CONTACTS_NAME))
        found.shown()
        return found

    @property
    def press(self) -> CapturedPress:
        return self.folder.presses[self.at]

    @property
    def grid(self) -> PixelGrid:
        """Pixels of the images; square ones where nobody states a scale."""
        return self.folder.grid(self.folder.mm_per_px or (1.0, 1.0))

    def shown(self) -> Shown:
        """The press that is looked at, with the circle that a calibration takes."""
        press, overrides = self.press, {}
        if self.path.is_file():
            overrides = read_overrides(self.folder.presses, self.path)
        said = overrides.get(press.name)
        if said is not None and said.skip:
            return Shown(press, press.circle, "left out")
        if said is not None and (circle := said.circle()) is not None:
            return Shown(press, circle, "clicked")
        if press.circle is not None:
            return Shown(press, press.circle, "label")
        background = self.folder.require_background().image()
        found = seen_contact(press, background, self.grid, self.folder.mask)
        if isinstance(found, InputError):
            return Shown(press, None, "none")
        return Shown(press, found.circle, "found")

    def go(self, to: int) -> None:
        """Look at another press; clicks on this one are dropped."""
        self.at = to % len(self.folder.presses)
        self.clicks.clear()

    def click(self, u_px: float, v_px: float) -> None:
        """Take a place on the rim; one outside of the image is none."""
        if 0 <= u_px <= self.grid.width_px - 1 and 0 <= v_px <= self.grid.height_px - 1:
            self.clicks.append((u_px, v_px))

    def circle(self) -> ContactCircle | None:
        """The circle through the clicks, by least squares of more than three; None of fewer, and of
        places on a line."""
        if len(self.clicks) < RIM_POINTS:
            return None
        ratio = self.grid.mm_per_px_y / self.grid.mm_per_px_x
        points = np.array(self.clicks) * [1, ratio]
        middle = points.mean(axis=0)
        matrix = np.column_stack([2 * (points - middle), np.ones(len(points))])
        squares = ((points - middle) ** 2).sum(axis=1)
        if np.linalg.matrix_rank(matrix, tol=1e-6 * np.abs(matrix).max()) < RIM_POINTS:
            return None
        du, dv, rest = np.linalg.lstsq(matrix, squares, rcond=None)[0]
        u, v = middle + (du, dv)
        return ContactCircle(float(u), float(v / ratio), float(np.sqrt(rest + du**2 + dv**2)))

    def save(self) -> ContactCircle:
        """Keep the clicked circle. Raises InputError for too few places and for a circle that no
        calibration takes."""
        circle = self.circle()
        if circle is None:
            raise InputError(
                f"{len(self.clicks)} places are clicked; at least {RIM_POINTS} on the rim, not on "
                "a line, make a circle"
            )
        check_place(circle, self.grid, self.press.name)
        radius = self.press.radius_mm or self.folder.ball_radius_mm
        if radius is not None and self.folder.mm_per_px is not None:
            check_radius(circle, self.grid, radius, self.press.name)
        self._write(circle)
        return circle

    def leave_out(self) -> None:
        """Keep that no calibration takes the press. Raises InputError for the last one."""
        self._write(None)

    def _write(self, circle: ContactCircle | None) -> None:
        save_contact(self.path, self.folder.presses, self.press.name, circle, self.now())
        self.saved[self.press.name] = circle
        self.clicks.clear()
