# SPDX-License-Identifier: Apache-2.0
"""A design, and what was found out about it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from taccel_lab.studies.presses.press_record import PressRecord

LOAD_N = 0.5
"""Load at which figures are read, where they are read at a load and a study names none."""


@dataclass(frozen=True)
class DesignPoint:
    """A sensor of the catalogue with other values for some of its parameters."""

    id: str
    """Stable name of the design within its study."""
    family: str
    """Name in the catalogue."""
    parameters: dict[str, Any] = field(default_factory=dict)
    """Overrides of the family's defaults, by name."""


@dataclass
class DesignFigures:
    """Figures of one design; a figure that could not be had is None and has a cause."""

    point: DesignPoint
    figures: dict[str, float | None] = field(default_factory=dict)
    """Values by the names of the metrics, in their units."""
    causes: dict[str, str] = field(default_factory=dict)
    """Why a figure is None, by metric; under ``press NAME`` why a press failed, and under
    ``design`` why the design could not be built at all."""
    seconds: float = 0.0
    """Wall time spent for this design; work shared by a batch counts in equal parts."""
    simulations: int = 0
    """Presses simulated for this design and not taken over from another one."""
    curves: dict[str, Any] = field(default_factory=dict)
    """Steps of each press, ready for JSON: depth [mm], force [N] and so on, by press."""
    records: dict[str, list[PressRecord]] = field(default_factory=dict, repr=False)
    """What the presses left behind, by press, one for each place and indenter."""
    intervals: dict[str, tuple[float | None, float | None]] = field(default_factory=dict)
    """Ends of what is known of a figure, see ``unknowns``; None where an end cannot be had."""


@dataclass(frozen=True)
class Fitted:
    """A figure that was fitted."""

    value: float
    half: float
    """Half of the fit's own 95 % interval."""


class NoFigure(Exception):
    """A metric has no value for a design; the message says why."""
