# SPDX-License-Identifier: Apache-2.0
"""What every calibration of a block returns: estimates, figures, remarks, evidence, a profile."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Generic, Protocol, Self, TypeVar

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.profile import Provenance, SensorProfile
from taccel_lab.report.remark import Remark, judge
from taccel_lab.summary import Summary

if TYPE_CHECKING:
    from taccel_lab.calibration.ball_presses import Untouched
    from taccel_lab.calibration.capture.split import PressSplit
    from taccel_lab.calibration.thickness.fit import GelThickness

MOST_SHOWN = 10
"""Figures that a result shows of itself."""
NORMAL_95 = 1.959963984540054
"""Half width of the 95 % interval of a normal distribution, in standard deviations."""


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


class Fit(Protocol):
    """A fitted model."""

    @property
    def inputs(self) -> Mapping[str, str]:
        """SHA-256 of the images it was fitted to, by name."""
        ...


FitType = TypeVar("FitType", bound=Fit)


@dataclass(frozen=True, repr=False, kw_only=True)
class ScoredFit(BlockResult, Generic[FitType]):
    """A model that is fitted, scored on held-out presses, and then fitted to all of them."""

    fit: FitType
    """To the training presses: all figures are of it."""
    final: FitType | None
    """To all presses, once the held-out ones were scored; what a profile gets. None where no
    held-out press can be used."""
    split: PressSplit | None
    """How the held-out presses were chosen; None where there are none."""
    valid_region: dict[str, tuple[float, float]]
    """Range of contact positions, tilts and displacements in the presses of the last fit."""
    gel: GelThickness | None = None
    """What the presses say of the gel's thickness; None where it is known and they agree."""
    untouched: Untouched | None = None
    """What it was fitted against; that of the captures when None."""
    remarks: tuple[Remark, ...] = ()
    """What a person has to know before the model is used."""

    @property
    def last(self) -> FitType:
        """What a profile gets."""
        return self.final or self.fit

    @property
    def scored(self) -> Self:
        """With the model that the figures are of alone: what later blocks build on, whose held-out
        presses are the same."""
        return self if self.final is None else replace(self, final=None)

    @property
    def then_fitted(self) -> str:
        """What the last fit was made to, for the record; empty where there is none."""
        if self.final is None:
            return ""
        return f"scored so, then fitted to all {len(self.final.inputs)} presses"
