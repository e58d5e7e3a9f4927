# SPDX-License-Identifier: Apache-2.0
"""What a material calibration found, as numbers and as the material block of a profile."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from taccel_lab.calibration.material.stiffness import Stiffness
from taccel_lab.calibration.result import BlockResult, Estimate, calibrated
from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import to_jsonable
from taccel_lab.presses.physics import PressPhysics
from taccel_lab.profile import FittedWith, SensorProfile
from taccel_lab.report.remark import Remark, judge


@dataclass(frozen=True, repr=False)
class MaterialCalibration(BlockResult):
    """Parameters that the captures determine; the others stay as they were."""

    source: str
    license: str
    model: str
    mooney_ratio: float
    """Ratio of the law ``mooney_rivlin``; 0 of others."""
    estimates: Mapping[str, Estimate]
    """What the captures determine, by the name of the block's field."""
    physics: PressPhysics
    stiffness: Stiffness
    """What the indentations say."""
    inputs: dict[str, str]
    remarks: tuple[Remark, ...]
    seconds: float
    """Time of the fit [s], without presses that were simulated before."""

    @property
    def used_friction(self) -> float:
        """Coefficient in the simulated presses."""
        return self.stiffness.friction

    def figures(self) -> dict[str, Any]:
        """Everything measured, ready for JSON."""
        return {
            "model": self.model,
            "verdict": judge(self.remarks),
            "estimates": {name: item.figures() for name, item in self.estimates.items()},
            "held": self.held(),
            "fitted_with": self.fitted_with().model_dump(exclude_none=True),
            "correlation": self.stiffness.correlation(),
            "residuals": self.stiffness.residuals(),
            "valid_region": self.stiffness.valid_region(),
            "inputs": self.inputs,
            "seconds": self.seconds,
            **self.stiffness.figures(),
        }

    def held(self) -> dict[str, float]:
        """Parameters of the law that were not fitted, with the values they were held at."""
        held = {"friction_coefficient": self.used_friction}
        if "poisson_ratio" not in self.estimates:
            held["poisson_ratio"] = self.stiffness.fit.poisson_ratio
        if self.model == "mooney_rivlin":
            held["mooney_ratio"] = self.mooney_ratio
        return held

    def fitted_with(self) -> FittedWith:
        """What the presses of the fit were, for the profile."""
        fit = self.stiffness.fit
        return FittedWith(
            physics=to_jsonable(self.physics.record()),
            friction_coefficient=self.used_friction,
            friction_measured=False,
            indenters=tuple(p.tool.description for p in fit.points),
            touch_shift_mm={p.name: fit.touch_mm(i) for i, p in enumerate(fit.points)},
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
        scale = values.get("young_modulus_pa", old.young_modulus_pa) / old.young_modulus_pa
        changes: dict[str, Any] = {
            "model": self.model,
            "mooney_ratio": 0.0,
            **values,
            **self.held(),
            "fitted_with": self.fitted_with(),
            "layers": tuple(
                layer.replace(young_modulus_pa=layer.young_modulus_pa * scale)
                for layer in old.layers
            ),
        }
        found = ", ".join(self.estimates)
        held = ", ".join(f"{name} = {value:g}" for name, value in self.held().items())
        provenance = calibrated(
            self.remarks,
            method=f"maximum likelihood around simulated presses: {found}"
            + (f"; held: {held}" if held else "")
            + "; density, and whatever is not named here, as before",
            source=self.source + (f" ({self.license})" if self.license else ""),
            inputs=self.inputs,
            residuals=self.stiffness.residuals(),
            spread={name: item.sigma for name, item in self.estimates.items()},
            interval={name: item.interval95 for name, item in self.estimates.items()}
            | self._touch_intervals(),
            correlation=self.stiffness.correlation(),
            valid_region=self.stiffness.valid_region(),
        )
        return profile.with_block(old.replace(**changes, provenance=provenance))

    def _touch_intervals(self) -> dict[str, tuple[float, float]]:
        """95 % interval of the zero of each record, where it was fitted."""
        fit = self.stiffness.fit
        return {
            f"touch_shift_mm of {item.name}": fit.touch_interval_mm(i)
            for i, item in enumerate(fit.points)
            if f"touch_{i}" in fit.solution.names
        }
