# SPDX-License-Identifier: Apache-2.0
"""What every calibration of a block returns: estimates, figures, remarks, evidence, a profile."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Protocol, Self, TypeVar

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.profile import Provenance, SensorProfile
from taccel_lab.report.remark import Remark, judge
from taccel_lab.summary import Summary
from taccel_lab.with_error import NORMAL_95

MOST_SHOWN = 10
"""Figures that a result shows of itself."""


@dataclass(frozen=True)
class Estimate:
    """A number with its standard deviation, and its 95 % interval where it is not symmetric."""

    value: float
    sigma: float
    unit: str = ""
    interval: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if not math.isfinite(self.value) or math.isnan(self.sigma) or self.sigma < 0:
            raise InputError(f"an estimate needs a finite value and sigma >= 0, got {self}")

    @property
    def interval95(self) -> tuple[float, float]:
        """The stated 95 % interval, or 1.96 sigma about the value."""
        if self.interval is not None:
            return self.interval
        return self.value - NORMAL_95 * self.sigma, self.value + NORMAL_95 * self.sigma

    def figures(self) -> dict[str, Any]:
        """Value, sigma and 95 % interval, ready for JSON."""
        return {"value": self.value, "sigma": self.sigma, "interval95": list(self.interval95)}

    def __str__(self) -> str:
        return f"{self.value:.5g} ± {self.sigma:.2g} {self.unit}".rstrip()


def mean_figures(scores: Sequence[Any]) -> dict[str, float]:
    """Mean of each field over the scores of presses, which are of one dataclass of numbers."""
    names = [item.name for item in fields(scores[0])]
    return {name: float(np.mean([getattr(score, name) for score in scores])) for name in names}


class BlockResult(Summary):
    """What the calibration of a block gives: figures and remarks, and a profile with the block.

    Its ``repr`` is its verdict and its first single figures, not its arrays.
    """

    remarks: tuple[Remark, ...]

    def figures(self) -> dict[str, Any]:
        """Everything measured, ready for JSON."""
        raise NotImplementedError

    def apply_to(self, profile: SensorProfile) -> SensorProfile:
        """``profile`` with the calibrated blocks, their evidence in the provenance."""
        raise NotImplementedError

    @property
    def scored(self) -> Self:
        """What the figures are of alone: later blocks build on that, whose held-out presses are the
        same."""
        return self

    @property
    def rectification(self) -> Any:
        """``RectificationMaps`` to the images that later blocks see; None where they are raw."""
        return None

    def summary(self) -> tuple[str, list[tuple[str, str]]]:
        """The verdict, and at most ``MOST_SHOWN`` figures."""
        single = [
            (name, f"{value:.4g}" if isinstance(value, float) else str(value))
            for name, value in self.figures().items()
            if isinstance(value, (int, float, str))
        ]
        rows = [("verdict", str(judge(self.remarks))), *single[:MOST_SHOWN]]
        return type(self).__name__, rows


def calibrated(remarks: Sequence[Remark], **evidence: Any) -> Provenance:
    """Provenance of a block that a calibration found, with the verdict that its remarks leave;
    ``evidence`` is of the provenance's fields."""
    said = tuple(str(remark) for remark in remarks)
    return Provenance(
        **{"kind": "calibrated", "verdict": judge(remarks).value, "remarks": said} | evidence
    )


class Placed(Protocol):
    """A held-out press."""

    @property
    def rejected(self) -> bool:
        """Whether its image rejects its label: it stands beside the figures."""
        ...


PlacedType = TypeVar("PlacedType", bound=Placed)


def in_figures(items: Sequence[PlacedType]) -> list[PlacedType]:
    """The held-out presses that means are over: a wrong label is no wrong render or reading."""
    return [item for item in items if not item.rejected]
