# SPDX-License-Identifier: Apache-2.0
"""What a material calibration found, as numbers and as the material block of a profile."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from taccel_lab.calibration.material.flow import FlowFit
from taccel_lab.calibration.material.indentation import IndentationFit
from taccel_lab.calibration.material.relaxation import DampingFit
from taccel_lab.calibration.material.sliding import SlideFit
from taccel_lab.calibration.material.stiffness import Stiffness
from taccel_lab.calibration.material.tangential import TangentialFit
from taccel_lab.calibration.result import Estimate, Remark, judge
from taccel_lab.envs.physics import PressPhysics
from taccel_lab.errors import InputError
from taccel_lab.output import to_jsonable
from taccel_lab.profile import FittedWith, Provenance, SensorProfile

PREDICTED = 5
"""Depths of each tool at which a predicted force is reported."""
Fit = SlideFit | TangentialFit | DampingFit


@dataclass(frozen=True)
class Predicted:
    """What a tool is predicted to feel at a depth."""

    depth_mm: float
    press_n: float
    """Of a press of the profile so far past first touch."""
    press_interval95_n: tuple[float, float]
    reading_n: float
    """Of a reading where the record, whose zero may be off, calls the depth this."""
    reading_interval95_n: tuple[float, float]


@dataclass(frozen=True)
class MaterialCalibration:
    """Parameters that the captures tell; the others stay as they were."""

    source: str
    license: str
    model: str
    young_modulus_pa: Estimate | None
    poisson_ratio: Estimate | None
    mooney_ratio: Estimate | None
    friction: Estimate | None
    damping_time_s: Estimate | None
    used_poisson_ratio: float
    """The fitted ratio, or the one that was held."""
    used_mooney_ratio: float
    used_friction: float
    """Coefficient in the simulated presses."""
    physics: PressPhysics
    stiffness: Stiffness | None
    """What the indentations say; None without any."""
    slides: tuple[SlideFit, ...]
    tangential: tuple[TangentialFit, ...]
    flows: tuple[FlowFit, ...]
    damping: tuple[DampingFit, ...]
    correlation: dict[str, float]
    inputs: dict[str, str]
    remarks: tuple[Remark, ...]
    seconds: float
    """Of the fit, without presses that were simulated before."""

    @property
    def indentation(self) -> IndentationFit | None:
        """The fit of the indentations, with what they do not tell held."""
        return None if self.stiffness is None else self.stiffness.fit

    @property
    def estimates(self) -> dict[str, Estimate]:
        """What was told, by the name of the block's field."""
        named = {
            "young_modulus_pa": self.young_modulus_pa,
            "poisson_ratio": self.poisson_ratio,
            "mooney_ratio": self.mooney_ratio,
            "friction_coefficient": self.friction,
            "damping_time_s": self.damping_time_s,
        }
        return {name: value for name, value in named.items() if value is not None}

    def residuals(self) -> dict[str, float]:
        """What the fits left over, as parts of the forces; of points that were held out first."""
        found: dict[str, float] = {}
        fit = self.indentation
        if fit is not None and self.stiffness is not None:
            miss = [
                abs(item.relative)
                for item in self.stiffness.held_out
                if item.force_n >= 0.1 * fit.points[item.index].force_n.max()
            ]
            if miss:
                found["indentation_held_out_worst_relative"] = max(miss)
                found["indentation_held_out_rms_relative"] = math.sqrt(
                    sum(value**2 for value in miss) / len(miss)
                )
            each = [fit.relative_residuals(i) for i in range(len(fit.points))]
            deep = [
                r[item.force_n >= 0.1 * item.force_n.max()]
                for r, item in zip(each, fit.points, strict=True)
            ]
            found["indentation_worst_relative"] = max(float(abs(r).max()) for r in deep)
            found["indentation_rms_relative"] = max(float((r**2).mean() ** 0.5) for r in deep)
        if self.slides:
            slid = [item.relative_residual for item in self.slides if item.slid]
            if slid:
                found["slide_rms_relative"] = max(slid)
        if self.tangential:
            found["tangential_rms_relative"] = max(i.relative_residual for i in self.tangential)
        if self.flows:
            found["flow_rms_mm"] = max(item.rms_mm for item in self.flows)
        if self.damping:
            found["relaxation_rms_relative"] = max(i.relative_residual for i in self.damping)
        return found

    def valid_region(self) -> dict[str, tuple[float, float]]:
        """Depths, forces and speeds of the captures."""
        region: dict[str, tuple[float, float]] = {}
        fit = self.indentation
        if fit is not None:
            depths = [item.depth_mm for item in fit.points]
            forces = [item.force_n for item in fit.points]
            region["depth_mm"] = (min(d.min() for d in depths), max(d.max() for d in depths))
            region["force_n"] = (min(f.min() for f in forces), max(f.max() for f in forces))
        if self.slides:
            loads = [item.normal_range_n for item in self.slides]
            region["slide_normal_n"] = (min(a for a, _ in loads), max(b for _, b in loads))
        for item in self.tangential:
            region[f"{item.motion}_depth_mm"] = (item.depth_mm, item.depth_mm)
        for item in self.flows:
            region["flow_depth_mm"] = (item.depth_mm, item.depth_mm)
        if self.damping:
            region["rate_mm_s"] = (0.0, max(item.max_rate_mm_s for item in self.damping))
        return {name: (float(a), float(b)) for name, (a, b) in region.items()}

    def mooney_rivlin_pa(self) -> dict[str, float]:
        """c10, c01 and the bulk modulus of small strains [Pa]; c01 is 0 of other laws."""
        if self.young_modulus_pa is None:
            return {}
        e, nu = self.young_modulus_pa.value, self.used_poisson_ratio
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
            "estimates": {
                name: {
                    "value": item.value,
                    "sigma": item.sigma,
                    "interval95": item.interval95,
                }
                for name, item in self.estimates.items()
            },
            "held": self.held(),
            "fitted_with": self.fitted_with().model_dump(exclude_none=True),
            "constants": self.mooney_rivlin_pa(),
            "correlation": self.correlation,
            "residuals": self.residuals(),
            "valid_region": self.valid_region(),
            "inputs": self.inputs,
            "seconds": self.seconds,
        }
        stiffness = self.stiffness
        if stiffness is not None:
            fit = stiffness.fit
            figures["indentation"] = [
                {
                    "name": item.name,
                    "tool": item.tool.description,
                    "depth_mm": item.depth_mm,
                    "force_n": item.force_n,
                    "fitted_n": fit.predicted_n(i, item.depth_mm),
                    "relative_residual": fit.relative_residuals(i),
                    "touch_mm": fit.touch_mm(i),
                    "touch_interval95_mm": fit.touch_interval_mm(i),
                    "predicted": [vars(item) for item in self.predicted(i)],
                }
                for i, item in enumerate(fit.points)
            ]
            figures["held_out"] = [
                {
                    "name": fit.points[item.index].name,
                    "depth_mm": item.depth_mm,
                    "force_n": item.force_n,
                    "predicted_n": item.predicted_n,
                    "interval95_n": item.interval_n,
                    "relative": item.relative,
                }
                for item in stiffness.held_out
            ]
            figures["noise"] = {
                "kind": fit.noise,
                "scale": fit.solution.noise,
                "chi2_per_dof": fit.solution.chi2_per_dof,
                "model_relative": fit.model_error,
            }
            figures["simulated"] = {
                "presses": sum(table.press_count for table in fit.tables),
                "seconds": sum(table.seconds for table in fit.tables),
                "interpolation_relative": max(t.error.interpolation for t in fit.tables),
            }
            figures["profiles"] = {
                name: {
                    "values": profile.values,
                    "excess": profile.excess,
                    "threshold": profile.threshold,
                    "interval": profile.interval,
                    "open": [profile.open_low, profile.open_high],
                }
                for name, profile in stiffness.profiled.solution.profiles.items()
                if not name.startswith("touch")
            }
        figures["slides"] = [
            {
                "name": item.name,
                "friction": item.friction.value,
                "sigma": item.friction.sigma,
                "slid": item.slid,
                "static_friction": item.static_friction,
                "offset_n": item.offset_n,
            }
            for item in self.slides
        ]
        figures["tangential"] = [
            {
                "name": item.name,
                "motion": item.motion,
                "friction": item.friction,
                "interval95": item.friction_interval,
                "told": item.friction_told,
                "relative_residual": item.relative_residual,
            }
            for item in self.tangential
        ]
        figures["flows"] = [item.figures() for item in self.flows]
        figures["damping"] = [
            {
                "name": item.name,
                "damping_time_s": item.damping_time_s.value if item.damping_time_s else None,
                "relaxation": vars(item.relaxation) if item.relaxation else None,
                "young_modulus_pa": item.young_modulus_pa,
            }
            for item in self.damping
        ]
        return figures

    def held(self) -> dict[str, float]:
        """Parameters of the law that were not fitted, with the values they were held at."""
        held = {}
        if self.poisson_ratio is None:
            held["poisson_ratio"] = self.used_poisson_ratio
        if self.model == "mooney_rivlin" and self.mooney_ratio is None:
            held["mooney_ratio"] = self.used_mooney_ratio
        if self.friction is None and self.stiffness is not None:
            held["friction_coefficient"] = self.used_friction
        return held

    def predicted(self, index: int) -> list[Predicted]:
        """Forces of the tool of a record at depths up to its deepest."""
        if self.stiffness is None:
            return []
        fit = self.stiffness.fit
        depths = fit.points[index].deepest_mm * np.linspace(0.2, 1.0, PREDICTED)
        forces = fit.tables[index].force_n(
            depths, fit.young_modulus_pa, fit.poisson_ratio, fit.mooney_ratio
        )
        return [
            Predicted(
                depth,
                float(force),
                self.stiffness.force_interval_n(index, depth),
                float(fit.predicted_n(index, np.array([depth]))[0]),
                self.stiffness.reading_interval_n(index, depth),
            )
            for depth, force in zip(depths.tolist(), forces, strict=True)
        ]

    def fitted_with(self) -> FittedWith:
        """What the presses of the fit were, for the profile."""
        fit = self.indentation
        return FittedWith(
            physics=to_jsonable(self.physics.record()),
            friction_coefficient=self.used_friction,
            friction_measured=self.friction is not None,
            indenters=() if fit is None else tuple(p.tool.description for p in fit.points),
            touch_shift_mm={}
            if fit is None
            else {p.name: fit.touch_mm(i) for i, p in enumerate(fit.points)},
        )

    def apply_to(self, profile: SensorProfile) -> SensorProfile:
        """``profile`` with the told parameters; layers keep their stiffness beside the gel's."""
        if not self.estimates:
            raise InputError("the captures tell no parameter of the material; nothing to write")
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
        told = ", ".join(self.estimates)
        held = ", ".join(f"{name} = {value:g}" for name, value in self.held().items())
        provenance = Provenance(
            kind="calibrated",
            method=f"maximum likelihood around simulated presses: {told}"
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
        fit = self.indentation
        if fit is None:
            return {}
        return {
            f"touch_shift_mm of {item.name}": fit.touch_interval_mm(i)
            for i, item in enumerate(fit.points)
            if f"touch_{i}" in fit.solution.names
        }
