# SPDX-License-Identifier: Apache-2.0
"""What a material calibration found, as numbers and as the material block of a profile."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from taccel_lab.calibration.material.stiffness import Stiffness
from taccel_lab.calibration.result import Estimate, ResultSummary
from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import to_jsonable
from taccel_lab.presses.physics import PressPhysics
from taccel_lab.profile import FittedWith, Provenance, SensorProfile
from taccel_lab.report.remark import Remark, judge


class RecordFit(Protocol):
    """What one record of another kind than indentation says."""

    @property
    def group(self) -> str:
        """Under which name its figures stand."""
        ...

    def figures(self) -> dict[str, Any]:
        """What was found, ready for JSON."""
        ...

    def residuals(self) -> dict[str, float]:
        """What the fit leaves over."""
        ...

    def valid_region(self) -> dict[str, tuple[float, float]]:
        """Depths, forces or speeds of the record."""
        ...


GROUPS = ("slides", "damping")


@dataclass(frozen=True, repr=False)
class MaterialCalibration(ResultSummary):
    """Parameters that the captures determine; the others stay as they were."""

    source: str
    license: str
    model: str
    estimates: Mapping[str, Estimate]
    """What the captures determine, by the name of the block's field."""
    used_poisson_ratio: float
    """The fitted ratio, or the one that was held."""
    used_mooney_ratio: float
    used_friction: float
    """Coefficient in the simulated presses."""
    physics: PressPhysics
    stiffness: Stiffness | None
    """What the indentations say; None without any."""
    fits: Sequence[RecordFit]
    """Of the other records."""
    inputs: dict[str, str]
    remarks: tuple[Remark, ...]
    seconds: float
    """Of the fit, without presses that were simulated before."""

    @property
    def correlation(self) -> dict[str, float]:
        """Of the parameters of the law that were fitted together."""
        return {} if self.stiffness is None else self.stiffness.correlation()

    def residuals(self) -> dict[str, float]:
        """What the fits left over, as parts of the forces, the largest of each kind; of points that
        were held out first."""
        found: dict[str, float] = {}
        for part in self._parts():
            for name, value in part.residuals().items():
                found[name] = max(value, found.get(name, value))
        return found

    def valid_region(self) -> dict[str, tuple[float, float]]:
        """Depths, forces and speeds of the captures."""
        found: dict[str, tuple[float, float]] = {}
        for part in self._parts():
            for name, (low, high) in part.valid_region().items():
                least, most = found.get(name, (low, high))
                found[name] = float(min(low, least)), float(max(high, most))
        return found

    def _parts(self) -> list[Stiffness | RecordFit]:
        return [*([] if self.stiffness is None else [self.stiffness]), *self.fits]

    def mooney_rivlin_pa(self) -> dict[str, float]:
        """c10, c01 and the bulk modulus of small strains [Pa]; c01 is 0 of other laws."""
        if "young_modulus_pa" not in self.estimates:
            return {}
        e, nu = self.estimates["young_modulus_pa"].value, self.used_poisson_ratio
        shear = e / (2 * (1 + nu))
        return {
            "c10_pa": 0.5 * shear * (1 - self.used_mooney_ratio),
            "c01_pa": 0.5 * shear * self.used_mooney_ratio,
            "bulk_modulus_pa": e / (3 * (1 - 2 * nu)),
        }

    def figures(self) -> dict[str, Any]:
        """Everything measured, ready for JSON."""
        figures: dict[str, Any] = {
            "model": self.model,
            "verdict": judge(self.remarks),
            "estimates": {name: item.figures() for name, item in self.estimates.items()},
            "held": self.held(),
            "fitted_with": self.fitted_with().model_dump(exclude_none=True),
            "constants": self.mooney_rivlin_pa(),
            "correlation": self.correlation,
            "residuals": self.residuals(),
            "valid_region": self.valid_region(),
            "inputs": self.inputs,
            "seconds": self.seconds,
        }
        if self.stiffness is not None:
            figures |= self.stiffness.figures()
        for group in GROUPS:
            figures[group] = [fit.figures() for fit in self.fits if fit.group == group]
        return figures

    def held(self) -> dict[str, float]:
        """Parameters of the law that were not fitted, with the values they were held at."""
        held = {}
        if "poisson_ratio" not in self.estimates:
            held["poisson_ratio"] = self.used_poisson_ratio
        if self.model == "mooney_rivlin" and "mooney_ratio" not in self.estimates:
            held["mooney_ratio"] = self.used_mooney_ratio
        if "friction_coefficient" not in self.estimates and self.stiffness is not None:
            held["friction_coefficient"] = self.used_friction
        return held

    def fitted_with(self) -> FittedWith:
        """What the presses of the fit were, for the profile."""
        fit = None if self.stiffness is None else self.stiffness.fit
        return FittedWith(
            physics=to_jsonable(self.physics.record()),
            friction_coefficient=self.used_friction,
            friction_measured="friction_coefficient" in self.estimates,
            indenters=() if fit is None else tuple(p.tool.description for p in fit.points),
            touch_shift_mm={}
            if fit is None
            else {p.name: fit.touch_mm(i) for i, p in enumerate(fit.points)},
        )

    def apply_to(self, profile: SensorProfile) -> SensorProfile:
        """``profile`` with the parameters that were determined; layers keep their stiffness beside
        the gel's."""
        if not self.estimates:
            raise InputError(
                "the captures determine no parameter of the material; nothing to write"
            )
        old = profile.material
        values = {name: item.value for name, item in self.estimates.items()}
        changes: dict[str, Any] = {"model": self.model, **values}
        changes.update(self.held())
        changes["fitted_with"] = self.fitted_with()
        if self.model != "mooney_rivlin":
            changes["mooney_ratio"] = 0.0
        scale = values.get("young_modulus_pa", old.young_modulus_pa) / old.young_modulus_pa
        changes["layers"] = tuple(
            layer.replace(young_modulus_pa=layer.young_modulus_pa * scale) for layer in old.layers
        )
        found = ", ".join(self.estimates)
        held = ", ".join(f"{name} = {value:g}" for name, value in self.held().items())
        provenance = Provenance(
            kind="calibrated",
            method=f"maximum likelihood around simulated presses: {found}"
            + (f"; held: {held}" if held else "")
            + "; density, and whatever is not named here, as before",
            source=self.source + (f" ({self.license})" if self.license else ""),
            inputs=self.inputs,
            residuals=self.residuals(),
            spread={name: item.sigma for name, item in self.estimates.items()},
            interval={name: item.interval95 for name, item in self.estimates.items()}
            | self._touch_intervals(),
            correlation=self.correlation,
            valid_region=self.valid_region(),
            verdict=judge(self.remarks).value,
            remarks=tuple(remark.message for remark in self.remarks),
        )
        return profile.with_block(old.replace(**changes, provenance=provenance))

    def _touch_intervals(self) -> dict[str, tuple[float, float]]:
        """95 % interval of the zero of each record, where it was fitted."""
        if self.stiffness is None:
            return {}
        fit = self.stiffness.fit
        return {
            f"touch_shift_mm of {item.name}": fit.touch_interval_mm(i)
            for i, item in enumerate(fit.points)
            if f"touch_{i}" in fit.solution.names
        }
