# SPDX-License-Identifier: Apache-2.0
"""What every task's file says, and parts that several tasks have in common."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import islice
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from taccel_lab.errors import InputError
from taccel_lab.files.strict_model import Number, StrictModel, Whole
from taccel_lab.scene import Element
from taccel_lab.tasks.draw import draws

Positive = Annotated[Number, Field(gt=0)]
NotNegative = Annotated[Number, Field(ge=0)]
Count = Annotated[Whole, Field(ge=1, le=100_000)]


class Published(StrictModel):
    """A figure that somebody published for a task like this one."""

    who: str
    figure: str
    source: str
    differs: str
    """What makes it not comparable."""


class TaskParameters(StrictModel):
    """What the file of any task says."""

    kind: str
    summary: str
    criterion: str
    """Words; the numbers are those of the file."""
    seeds: Count
    """Seeds 0, 1, ... of a run that names no other number."""
    environments: Count
    """Seeds that one solver steps together."""
    dt_s: Positive
    steps: Count
    """Steps after which it is over."""
    published: Annotated[tuple[Published, ...], Field(min_length=1)]


class Randomised(StrictModel):
    """A parameter of bodies that each episode of a learning loop draws anew, evenly."""

    what: Literal["young_modulus_pa", "poisson_ratio", "mass_kg", "friction"]
    of: Annotated[tuple[tuple[str, ...], ...], Field(min_length=1)]
    """Names of the bodies, of friction of pairs of them; all get the same value."""
    low: NotNegative
    high: NotNegative

    @model_validator(mode="after")
    def _check(self) -> Self:
        wanted = 2 if self.what == "friction" else 1
        if any(len(names) != wanted for names in self.of):
            raise ValueError(f"of needs {wanted} names each time for {self.what}")
        if self.low > self.high:
            raise ValueError(f"low {self.low:g} lies above high {self.high:g}")
        return self


class PadParameters(StrictModel):
    """A block of gel, bonded at its back."""

    cells: tuple[Count, Count, Count]
    size_mm: tuple[Positive, Positive, Positive]
    """Width and height of its face, and thickness."""
    young_modulus_pa: Positive
    poisson_ratio: Number
    density_kg_m3: Positive
    friction: NotNegative
    element: Element
    jitter: Annotated[Number, Field(ge=0, le=0.3)] = 0.0
    """How far nodes are moved, as a part of a cell: no direction of the mesh is special then."""
    focus: NotNegative = 0.0
    """Cells shrink towards the middle of the face, as sinh(focus s) does for s towards 0."""


class Contact(StrictModel):
    """How close contact is solved."""

    dhat_mm: Positive
    friction_speed_mm_s: Positive
    """Sliding speed below which friction is static."""
    absolute_tolerance_n: Positive


class FreeBody(StrictModel):
    """A stiff body that nothing holds."""

    mass_kg: Positive
    friction: NotNegative


class LearningParameters(StrictModel):
    """What a learned policy may do: move the gels together."""

    speed_mm_s: tuple[Positive, Positive, Positive]
    """Speed of an action of 1 along each axis."""
    turn_deg_s: Positive
    """Speed of an action of 1, about the vertical."""
    reach_mm: tuple[Positive, Positive, Positive]
    """How far from their start the gels may go."""
    reach_deg: Positive
    randomise: tuple[Randomised, ...]


class PlanarStart(StrictModel):
    """Half ranges of where something is, from above the middle."""

    x_mm: NotNegative
    """Half range along the way on which fingers or gels close."""
    y_mm: NotNegative
    yaw_deg: NotNegative

    def draw(
        self, seeds: Sequence[int], again: Callable[[float, float, float], bool] | None = None
    ) -> tuple[list[dict[str, float]], np.ndarray]:
        """What each seed draws, and the poses of that, [seed, 7], at z = 0.

        ``again`` tells of x and y [m] and yaw [rad] whether they are drawn again; after a thousand
        draws InputError says that there is no other start.
        """
        ranges, starts = self.model_dump(), []
        for seed in seeds:
            for drawn in islice(draws(seed, ranges), 1000):
                x, y, yaw = drawn.values()
                if again is None or not again(1e-3 * x, 1e-3 * y, np.radians(yaw)):
                    starts.append(drawn)
                    break
            else:
                raise InputError(f"no start of {ranges} counts")
        yaw = np.radians([start["yaw_deg"] for start in starts])
        poses = np.zeros((len(starts), 7))
        poses[:, 0] = [1e-3 * start["x_mm"] for start in starts]
        poses[:, 1] = [1e-3 * start["y_mm"] for start in starts]
        poses[:, 5], poses[:, 6] = np.sin(yaw / 2), np.cos(yaw / 2)
        return starts, poses
