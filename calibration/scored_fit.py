# SPDX-License-Identifier: Apache-2.0
"""What fits of networks to ball presses share: one that is scored, and one to all presses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Generic, Protocol, Self, TypeVar

from taccel_lab.calibration.result import BlockResult
from taccel_lab.report.remark import Remark

if TYPE_CHECKING:
    from taccel_lab.calibration.ball_presses import Untouched
    from taccel_lab.calibration.capture.captures import PressSplit
    from taccel_lab.calibration.thickness.fit import GelThickness


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
    """Fit to the training presses: all figures are of it."""
    final: FitType | None
    """Fit to all presses, once the held-out ones were scored; what a profile gets. None where no
    held-out press can be used."""
    split: PressSplit | None
    """How the held-out presses were chosen; None where the fit was given no set of them."""
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
        """Result with the model that the figures are of alone: what later blocks build on, whose
        held-out presses are the same."""
        return self if self.final is None else replace(self, final=None)

    @property
    def then_fitted(self) -> str:
        """What the last fit was made to, for the record; empty where there is none."""
        if self.final is None:
            return ""
        return f"scored so, then fitted to all {len(self.final.inputs)} presses"
