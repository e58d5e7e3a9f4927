# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate material``: force records in, a profile with the gel's material out."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

from taccel_lab.cli.calibrate.base import BlockCommand, Fitted
from taccel_lab.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.calibration.capture.folder import CaptureFolder
    from taccel_lab.calibration.material.options import MaterialOptions
    from taccel_lab.calibration.material.result import MaterialCalibration
    from taccel_lab.progress import Progress


@dataclass(frozen=True)
class CalibrateMaterial(BlockCommand):
    """Fit stiffness, Poisson's ratio, friction and damping to force records and write a profile.

    Presses of the record's tool on the sensor's gel are simulated once and kept; the fit gives
    each parameter with its 95 % interval, and the report says which ones the records leave open.
    """

    captures: Positional[Path]
    """Capture folder with captures.toml whose [[records]] name force records (docs/captures.md)."""
    model: (
        Literal["neo_hookean", "stable_neo_hookean", "st_venant_kirchhoff", "mooney_rivlin"] | None
    ) = None
    """Law of the gel; that of the base profile when left out."""
    fix: tuple[str, ...] = ()
    """Parameters that are held, as in nu=0.48 or e=3e5; of e [Pa], nu, mooney_ratio, friction."""
    touch_sigma_mm: float | None = None
    """How well the records know first touch [mm]; for few points 0.1 of a ball and 0.05 of a flat
    punch, for many 0.2 when left out, 0 to trust them."""
    accuracy: Literal["fast", "default", "reference"] = "default"
    """How closely presses are simulated: as those that are to reproduce the records."""
    device: str = "cpu"
    """Device of the presses: cpu, or cuda:0, which takes those of a table together."""

    def check(self) -> None:
        """Refuse an unknown device and parameters that cannot be held."""
        from taccel_lab.model.devices import require_device

        require_device(self.device)
        self._options()

    def fit(self, folder: CaptureFolder, progress: Progress) -> Fitted:
        """Fit the law, friction and damping."""
        from taccel_lab.calibration.material.fit import calibrate_material
        from taccel_lab.calibration.material.report import material_page

        base = self.profile_to_extend(folder)
        result = calibrate_material(folder, base, self._options(), progress)
        return Fitted(
            "material", base, result, material_page(result), partial(_print_estimates, result)
        )

    def _options(self) -> MaterialOptions:
        from taccel_lab.calibration.material.options import MaterialOptions
        from taccel_lab.envs.physics import PHYSICS, Accuracy

        return MaterialOptions(
            model=self.model,
            fixed=parse_fixed(self.fix),
            touch_sigma_mm=self.touch_sigma_mm,
            physics=PHYSICS[Accuracy(self.accuracy)],
            device=self.device,
        )


def parse_fixed(items: tuple[str, ...]) -> dict[str, float]:
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


def _print_estimates(result: MaterialCalibration, console: Console) -> None:
    from rich.table import Table

    table = Table("parameter", "value", "sigma", "95 % from", "to", title_justify="left")
    for name, item in result.estimates.items():
        low, high = item.interval95
        table.add_row(name, *(f"{number:.4g}" for number in (item.value, item.sigma, low, high)))
    for name, value in result.held().items():
        table.add_row(name, f"{value:.4g}", "held", "", "")
    console.print(table)
    for name, value in result.residuals().items():
        console.print(f"{name}: {value:.3g}")
