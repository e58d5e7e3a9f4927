# SPDX-License-Identifier: Apache-2.0
"""Pegs and holes of tasks: prisms on end, and blocks with a hole of the same section, somewhat
larger."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from taccel_lab.files.strict_model import StrictModel
from taccel_lab.scene import TriangleMesh
from taccel_lab.tasks.parameters import FreeBody, NotNegative, Positive
from taccel_lab.tasks.peg_scene import DOG_BONE_CAP, dog_bone, prism, tube

ROUND_SIDES = 64
"""Sides of what stands for a circle: its flats are 0.0012 radii inside it."""
SIZES = {"octagon": 1, "round": 1, "rectangle": 2, "trapezoid": 3, "waisted": 4}
"""Shapes, and how many sizes they have."""


@dataclass(frozen=True)
class PegSection:
    """A section of a peg."""

    outline: np.ndarray
    """Counter-clockwise [m], [n, 2]."""
    cap: list[tuple[int, int, int]]
    """Triangles of its inside."""
    around: np.ndarray
    """An outline around it without a waist, vertex beside vertex [m], [n, 2]."""

    def crosses(self, other: np.ndarray) -> bool:
        """Whether the outline crosses another one, [m, 2]."""
        p, q = self.outline[:, None], np.roll(self.outline, -1, axis=0)[:, None]
        r, s = other[None], np.roll(other, -1, axis=0)[None]
        apart = (_left(p, q, r) != _left(p, q, s)) & (_left(r, s, p) != _left(r, s, q))
        return bool(apart.any())

    def placed(self, x_m: float, y_m: float, turn_rad: float) -> np.ndarray:
        """The outline turned and moved, [n, 2]."""
        c, s = np.cos(turn_rad), np.sin(turn_rad)
        return self.outline @ np.array([[c, s], [-s, c]]) + [x_m, y_m]


def _left(u: np.ndarray, v: np.ndarray, w: np.ndarray) -> np.ndarray:
    first, second = v - u, w - u
    return first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0] > 0


def grown(outline: np.ndarray, by_m: float) -> np.ndarray:
    """A counter-clockwise outline [n, 2] with each side moved outwards."""
    along = np.roll(outline, -1, axis=0) - outline
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    after = np.stack([along[:, 1], -along[:, 0]], axis=1)
    before = np.roll(after, 1, axis=0)
    both = 1 + (before * after).sum(axis=1, keepdims=True)
    return outline + by_m * (before + after) / both


def even(sides: int, apothem_m: float) -> np.ndarray:
    """An even polygon with flats to +-x and +-y, [sides, 2]; ``sides`` a multiple of four."""
    angles = np.pi / sides * (1 + 2 * np.arange(sides))
    corner = apothem_m / np.cos(np.pi / sides)
    return corner * np.stack([np.cos(angles), np.sin(angles)], axis=1)


class Peg(FreeBody):
    """A prism on end, gripped at its faces towards +x and -x."""

    shape: Literal["octagon", "round", "rectangle", "trapezoid", "waisted"]
    size_mm: Annotated[tuple[Positive, ...], Field(min_length=1, max_length=4)]
    """Size across flats of an octagon; diameter; across x and y of a rectangle; across x of a
    trapezoid, and its sides at +x and -x; across x and y of a rectangle, length and
    width of its waist."""
    height_mm: Positive

    @model_validator(mode="after")
    def _check(self) -> Self:
        if len(self.size_mm) != SIZES[self.shape]:
            raise ValueError(
                f"a {self.shape} has {SIZES[self.shape]} sizes, got {len(self.size_mm)}"
            )
        if self.shape == "waisted":
            x, y, length, width = self.size_mm
            if length >= x or width >= y:
                raise ValueError("the waist must be shorter and narrower than the peg")
        return self

    @property
    def half_m(self) -> float:
        """Half of its size across x."""
        return 5e-4 * self.size_mm[0]

    def section(self) -> PegSection:
        """Its section."""
        sizes = [1e-3 * value for value in self.size_mm]
        x = self.half_m
        if self.shape == "waisted":
            y, waist = sizes[1] / 2, sizes[2] / 2
            outline = dog_bone(x, y, waist, sizes[3] / 2)
            return PegSection(outline, DOG_BONE_CAP, dog_bone(x, y, waist, y))
        if self.shape == "rectangle":
            y = sizes[1] / 2
            outline = np.array([(x, y), (-x, y), (-x, -y), (x, -y)])
        elif self.shape == "trapezoid":
            right, left = sizes[1] / 2, sizes[2] / 2
            outline = np.array([(x, right), (-x, left), (-x, -left), (x, -right)])
        elif self.shape == "octagon":
            outline = even(8, x)
        else:
            outline = even(ROUND_SIDES, x)
            outline *= x / np.linalg.norm(outline[0])
        cap = [(0, i, i + 1) for i in range(1, len(outline) - 1)]
        return PegSection(outline, cap, outline)

    def mesh(self) -> TriangleMesh:
        """Surface from z = 0 up [m]."""
        section = self.section()
        return prism(section.outline, section.cap, 1e-3 * self.height_mm)


class Hole(StrictModel):
    """A hole in a block that stands still, of the peg's section and somewhat larger."""

    clearance_mm: Positive
    """Clearance on each side of the peg."""
    wall_mm: Positive
    depth_mm: Positive
    friction: NotNegative

    def outline(self, peg: Peg) -> np.ndarray:
        """Outline of the hole for a peg [m], [n, 2]; flats of a round one touch the circle."""
        by = 1e-3 * self.clearance_mm
        if peg.shape == "round":
            return even(ROUND_SIDES, peg.half_m + by)
        return grown(peg.section().outline, by)

    def mesh(self, peg: Peg) -> TriangleMesh:
        """The block, from z = 0 to the rim [m]."""
        around = grown(peg.section().around, 1e-3 * (self.clearance_mm + self.wall_mm))
        return tube(self.outline(peg), around, 1e-3 * self.depth_mm)
