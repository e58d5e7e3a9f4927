# SPDX-License-Identifier: Apache-2.0
"""The standard presses: what every design of a study goes through.

Indenters have fixed sizes, so that designs are compared on the same objects; depths follow the
thickness of the gel, so that thin and thick gels are loaded alike.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.guards import require_known, require_range
from taccel_lab.presses import PHYSICS, Accuracy, PressPhysics, parse_indenter

CENTRE = (0.0, 0.0)


@dataclass(frozen=True)
class Waypoint:
    """Where the indenter stands at the end of a step."""

    depth: float
    """Part of the full depth."""
    shear: float = 0.0
    """Part of the full shear."""
    twist: float = 0.0
    """Part of the full twist."""


@dataclass(frozen=True)
class StandardPress:
    """One press of a study: an indenter, or several that differ in size, in one or more places."""

    name: str
    indenters: tuple[str, ...]
    """Indenters as ``parse_indenter`` reads them; each one is a separate simulation."""
    depth_fraction: float = 0.0
    """Full depth as a part of the gel's thickness under the press; or else ``depth_mm``."""
    depth_mm: float = 0.0
    """Full depth past first touch [mm]; or else ``depth_fraction``."""
    depth_limit_mm: float = math.inf
    """Largest full depth [mm], whatever ``depth_fraction`` gives."""
    steps: int = 6
    """Steps down to the full depth."""
    shear_fraction: float = 0.0
    """Sideways motion along x at full depth, as a part of that depth."""
    twist_deg: float = 0.0
    """Turn about the press's axis at full depth."""
    shear_steps: int = 4
    twist_steps: int = 2
    shear_back: bool = False
    """Whether the indenter goes back sideways before it turns."""
    release: bool = False
    """Whether the indenter goes up again, by the steps it came down."""
    places: tuple[tuple[float, float], ...] = (CENTRE,)
    """Where, in parts of half of the camera's view along x and y: (0, 0) is its centre."""
    physics: PressPhysics = PHYSICS[Accuracy.DEFAULT]
    """Element, mesh, contact range and tolerance: how accurate it is."""

    def __post_init__(self) -> None:
        if not self.name or not self.name.isidentifier():
            raise InputError(f"the name of a press must be a word, got {self.name!r}")
        if not self.indenters or not self.places:
            raise InputError(f"press {self.name}: needs at least one indenter and one place")
        for text in self.indenters:
            parse_indenter(text).require_size(self.depth_mm)
        if len(set(self.indenters)) < len(self.indenters):
            raise InputError(f"press {self.name}: an indenter is named twice")
        if (self.depth_fraction > 0) == (self.depth_mm > 0):
            raise InputError(
                f"press {self.name}: give either depth_fraction or depth_mm, got "
                f"{self.depth_fraction:g} and {self.depth_mm:g}"
            )
        for name, low, high in (
            ("depth_fraction", 0.0, 0.8), ("depth_mm", 0.0, 50.0), ("shear_fraction", -4.0, 4.0),
            ("twist_deg", -90.0, 90.0), ("steps", 1, 200), ("shear_steps", 1, 200),
            ("twist_steps", 1, 200),
        ):  # fmt: skip
            require_range(f"press {self.name}: {name}", getattr(self, name), low, high)
        if not self.depth_limit_mm > 0:
            raise InputError(
                f"press {self.name}: depth_limit_mm must be above 0, got {self.depth_limit_mm}"
            )
        if not (np.abs(np.asarray(self.places)) <= 1).all():
            raise InputError(
                f"press {self.name}: places are parts of half of the view, in [-1, 1], got "
                f"{self.places}"
            )

    def full_depth_mm(self, thickness_mm: float) -> float:
        """Full depth [mm] on a gel that is ``thickness_mm`` thick under the press."""
        wanted = self.depth_mm or self.depth_fraction * thickness_mm
        return min(wanted, self.depth_limit_mm)

    def waypoints(self) -> list[Waypoint]:
        """End of each step: down, sideways [and back], turned, up."""
        path = [Waypoint((i + 1) / self.steps) for i in range(self.steps)]
        shear = 0.0
        if self.shear_fraction:
            n = self.shear_steps
            path += [Waypoint(1.0, (i + 1) / n) for i in range(n)]
            if self.shear_back:
                path += [Waypoint(1.0, (n - 1 - i) / n) for i in range(n)]
            shear = path[-1].shear
        if self.twist_deg:
            path += [
                Waypoint(1.0, shear, (i + 1) / self.twist_steps) for i in range(self.twist_steps)
            ]
        if self.release:
            twist = path[-1].twist
            path += [Waypoint(i / self.steps, shear, twist) for i in range(self.steps - 1, -1, -1)]
        return path

    @property
    def straight(self) -> bool:
        """Whether it goes straight down in one place and stays there."""
        moves = self.shear_fraction or self.twist_deg or self.release
        return not moves and len(self.places) == 1


_CORNERS = ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))

STANDARD_PRESSES: dict[str, StandardPress] = {
    press.name: press
    for press in (
        StandardPress("sphere", ("sphere:3",), depth_fraction=0.4, depth_limit_mm=2.4, steps=6),
        StandardPress("punch", ("cylinder:2",), depth_fraction=0.15, depth_limit_mm=0.8, steps=4),
        StandardPress("cylinder", ("roller:2x6",), depth_fraction=0.2, depth_limit_mm=1.0, steps=4),
        StandardPress("edge", ("edge:90x6x0.1",), depth_fraction=0.15, depth_limit_mm=0.6, steps=4),
        StandardPress(
            "grating", ("grating:2x4x6",), depth_fraction=0.1, depth_limit_mm=0.4, steps=3
        ),
        StandardPress(
            "shear",
            ("sphere:3",),
            depth_fraction=0.2,
            depth_limit_mm=1.2,
            steps=3,
            shear_fraction=0.6,
            shear_back=True,
            twist_deg=8.0,
        ),
        StandardPress(
            "pairs",
            ("pair:0.25x0.1", "pair:0.25x0.4", "pair:0.25x1.2"),
            depth_fraction=0.08,
            depth_limit_mm=0.4,
            steps=3,
        ),
        StandardPress(
            "places",
            ("sphere:3",),
            depth_fraction=0.15,
            depth_limit_mm=0.8,
            steps=3,
            places=(CENTRE, *_CORNERS),
        ),
        StandardPress(
            "release",
            ("sphere:3",),
            depth_fraction=0.3,
            depth_limit_mm=1.8,
            steps=6,
            release=True,
        ),
    )
}
"""Known presses by name; the first six are those of a study that names none."""

DEFAULT_PRESSES = tuple(list(STANDARD_PRESSES)[:6])


def standard_presses(names: tuple[str, ...] | list[str] | None = None) -> list[StandardPress]:
    """Presses by name, the default six when None; InputError lists the known ones."""
    names = DEFAULT_PRESSES if names is None else names
    for name in names:
        require_known("press", name, STANDARD_PRESSES)
    return [STANDARD_PRESSES[name] for name in names]
