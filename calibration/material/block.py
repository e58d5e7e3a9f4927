# SPDX-License-Identifier: Apache-2.0
"""Stiffness, Poisson's ratio and friction."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from taccel_lab.calibration.block import Block, BlockWords, Needs, Residuals
from taccel_lab.errors import InputError
from taccel_lab.report.lead import Score

if TYPE_CHECKING:
    from taccel_lab.calibration.capture.folder import CaptureFolder
    from taccel_lab.calibration.material.options import MaterialOptions
    from taccel_lab.profile import SensorProfile


@dataclass(frozen=True, kw_only=True)
class MaterialWords(BlockWords):
    """Fit stiffness, Poisson's ratio and friction to force records and write a profile.

    Presses of the record's tool on the sensor's gel are simulated once and cached. The fit gives
    each parameter with its 95 % interval; the report names those that the records do not determine.
    """

    model: (
        Literal["neo_hookean", "stable_neo_hookean", "st_venant_kirchhoff", "mooney_rivlin"] | None
    ) = None
    """Material law of the gel. Default: the base profile's."""
    fix: tuple[str, ...] = ()
    """Parameters to hold, such as nu=0.48 or e=3e5: e [Pa], nu, mooney_ratio, friction."""
    touch_sigma_mm: float | None = None
    """Uncertainty of first touch in the records [mm]. Default: for few points 0.1 (ball) or 0.05
    (flat punch), for many 0.2. 0 trusts the records."""
    accuracy: Literal["fast", "default", "reference"] = "default"
    """Accuracy of the simulated presses, and of those that reproduce the records."""
    device: str = "cpu"
    """Device of the presses: cpu, or cuda:0."""

    def check(self) -> None:
        """Refuse an unknown device and parameters that cannot be held."""
        from taccel_lab.model.launches import require_device

        require_device(self.device)
        self.options(None)

    def options(self, base: SensorProfile | None) -> MaterialOptions:
        from taccel_lab.calibration.material.options import MaterialOptions
        from taccel_lab.presses.physics import PHYSICS, Accuracy

        return MaterialOptions(
            model=self.model,
            fixed=_parse_fixed(self.fix),
            touch_sigma_mm=self.touch_sigma_mm,
            physics=PHYSICS[Accuracy(self.accuracy)],
            device=self.device,
        )


def _parse_fixed(items: tuple[str, ...]) -> dict[str, float]:
    """Held parameters from ``name=value``; InputError says what is wrong."""
    fixed = {}
    for item in items:
        name, equals, value = item.partition("=")
        try:
            fixed[name.strip()] = float(value)
        except ValueError:
            equals = ""
        if not equals:
            raise InputError(f"--fix {item!r} is not understood; write name=value, as in nu=0.48")
    return fixed


def _needs(folder: CaptureFolder, _: bool | None) -> Needs:
    kinds = [record.entry.kind for record in folder.records]
    if not kinds:
        return Needs("", "force records: indentation (E)")
    return Needs(", ".join(f"{kinds.count(kind)} x {kind}" for kind in dict.fromkeys(kinds)))


def material_scores(left: Residuals) -> Iterator[Score]:
    """Score of forces."""
    if "indentation_held_out_worst_relative" in left:
        yield Score(
            f"{100 * left['indentation_held_out_worst_relative']:.2g}",
            "% of the force",
            "worst error of forces",
            "each measured point, predicted from the others",
        )


BLOCK = Block(
    name="material",
    home=__name__,
    words=MaterialWords,
    needs=_needs,
    checked_by="check:check_records",
    fitted_by="fit:calibrate_material",
    shown_by="material_page:material_page",
    choices="options:MaterialOptions",
    telling=3,
    key="material",
    scores=material_scores,
)
