# SPDX-License-Identifier: Apache-2.0
"""From captures to a material: which records say what, and in which order they are fitted."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

from taccel_lab.calibration.capture import CaptureFolder, ForceRecord
from taccel_lab.calibration.capture.schema import ToolEntry
from taccel_lab.calibration.material.agreement import friction_of, weighted_mean
from taccel_lab.calibration.material.flow import FlowFit, fit_flow
from taccel_lab.calibration.material.options import MaterialOptions
from taccel_lab.calibration.material.points import (
    IndentationPoints,
    points_of_presses,
    points_of_record,
    require_plausible,
)
from taccel_lab.calibration.material.relaxation import DampingFit, check_relaxation, fit_damping
from taccel_lab.calibration.material.response import ForceTable, force_table
from taccel_lab.calibration.material.result import MaterialCalibration
from taccel_lab.calibration.material.setup import Gel
from taccel_lab.calibration.material.sliding import SlideFit, fit_slide
from taccel_lab.calibration.material.stiffness import Law, Stiffness, fit_stiffness
from taccel_lab.calibration.material.tangential import TangentialFit, fit_tangential
from taccel_lab.calibration.material.video_flow import flows_of_folder, videos_with_path
from taccel_lab.calibration.material.viscous_gain import viscous_gain
from taccel_lab.calibration.result import Estimate, Remark, Severity
from taccel_lab.errors import InputError, SimulationError
from taccel_lab.profile import SensorProfile

Progress = Callable[[str, int, int], None]
"""What is simulated, how many presses are done, of how many."""


def calibrate_material(
    folder: CaptureFolder,
    base: SensorProfile,
    options: MaterialOptions | None = None,
    progress: Progress | None = None,
) -> MaterialCalibration:
    """Fit the material of ``base`` to the records of a capture folder.

    Raises:
        InputError: No record of forces, or one that cannot be used, with what is allowed.
        SimulationError: A press that did not converge.
    """
    options = options or MaterialOptions()
    gel = Gel.of_profile(base, options.model, options.device)
    if gel.material.model != "mooney_rivlin" and "mooney_ratio" in options.fixed:
        raise InputError("mooney_ratio belongs to the law mooney_rivlin: add --model mooney_rivlin")
    records = {kind: [r for r in folder.records if r.entry.kind == kind] for kind in _KINDS}
    job = _Job(folder, base, gel, options, progress)
    points = [points_of_record(r, gel, folder.ball_radius_mm) for r in records["indentation"]]
    points += points_of_presses(folder, gel)
    videos = videos_with_path(folder)
    if not points and not any(records.values()) and not videos:
        raise InputError(
            f"{folder.source}: nothing that tells the material; give [[records]] of kind "
            "indentation, slide, shear, twist or relaxation (docs/captures.md), presses with "
            "depth_mm and force_n, or marker videos with a path"
        )
    for record in records["relaxation"]:
        check_relaxation(record)
    slides = [fit_slide(record) for record in records["slide"]]
    started = time.perf_counter()
    sheared = (*records["shear"], *records["twist"])
    if sheared or slides or videos:
        # They tell friction with a modulus, and the modulus depends a little on friction.
        job.fit_stiffness(points, [job.options.fixed.get("friction", 0.0)])
        job.fit_friction(sheared, slides, bool(videos))
        job.fit_stiffness(points, job.press_frictions())
        before = job.press_frictions()
        job.fit_friction(sheared, slides, bool(videos))
        if job.press_frictions() != before:
            job.fit_stiffness(points, job.press_frictions())
    else:
        job.fit_stiffness(points, job.press_frictions())
    for record in records["relaxation"]:
        job.fit_damping(record)
    return job.result((*points, *slides), time.perf_counter() - started)


_KINDS = ("indentation", "slide", "shear", "twist", "relaxation")


class _Job:
    """One calibration on its way."""

    def __init__(
        self,
        folder: CaptureFolder,
        base: SensorProfile,
        gel: Gel,
        options: MaterialOptions,
        progress: Progress | None,
    ) -> None:
        self.folder, self.base, self.gel = folder, base, gel
        self.options, self._progress = options, progress
        self.nu = options.fixed.get("nu", base.material.poisson_ratio)
        self.ratio = options.fixed.get("mooney_ratio", gel.material.mooney_ratio)
        self.young: Estimate | None = None
        self.flow_nu: Estimate | None = None
        """Poisson's ratio that marker flow told."""
        self.friction: Estimate | None = None
        self.stiffness: Stiffness | None = None
        self.tangential: list[TangentialFit] = []
        self.flows: list[FlowFit] = []
        self.slides: list[SlideFit] = []
        self.damping: list[DampingFit] = []
        self._remarks: dict[str, list[Remark]] = {}
        """By the part of the fit that made them, which replaces them when it is done again."""

    @property
    def nu_estimate(self) -> Estimate | None:
        told = None if self.stiffness is None else self.stiffness.nu
        return told or self.flow_nu

    @property
    def shared_nu(self) -> float:
        """Poisson's ratio of presses beside the tables, rounded so that equal fits share them."""
        return round(self.nu, 3)

    def _told(self, what: str) -> Callable[[int, int], None] | None:
        if self._progress is None:
            return None
        progress = self._progress
        return lambda done, count: progress(what, done, count)

    # Indentation ---------------------------------------------------------------------------------

    def fit_stiffness(self, points: list[IndentationPoints], frictions: Sequence[float]) -> None:
        """E, and what else of the law the points tell; the rest is held. Presses had one of the
        coefficients of friction given."""
        if not points:
            return
        start, remarks = require_plausible(points, self.gel.thickness_mm, self.nu)
        free_nu = "nu" not in self.options.fixed and self.flow_nu is None
        stated = self.options.fixed.get("nu", self.base.material.poisson_ratio)
        law = Law(
            stated if self.flow_nu is None else self.flow_nu.value,
            self.options.fixed.get("mooney_ratio", self.gel.material.mooney_ratio),
            free_nu,
            self.gel.material.model == "mooney_rivlin" and "mooney_ratio" not in self.options.fixed,
            self.flow_nu,
        )
        tables: dict[float, list[ForceTable]] = {}
        for mu in frictions:
            try:
                tables[mu] = self._tables(points, mu, law)
            except SimulationError as error:
                if not tables:
                    raise
                remarks.append(
                    Remark(
                        Severity.WARNING,
                        "friction_unsimulated",
                        f"whether the tool rubs with the profile's coefficient of {mu:g} is not "
                        f"known, and presses with it could not be simulated: {error}",
                    )
                )
        self.stiffness = found = fit_stiffness(
            points, tables, law, start_pa=start, touch_sigma_mm=self.options.touch_sigma_mm
        )
        self.nu, self.ratio = found.fit.poisson_ratio, found.fit.mooney_ratio
        self.young = found.young
        self._remarks["stiffness"] = [*remarks, *found.remarks]

    def press_frictions(self) -> list[float]:
        """Coefficients that presses may have had: the one that is known, or 0 and the base's."""
        if self.friction is not None:
            return [self.friction.value]
        if "friction" in self.options.fixed:
            return [self.options.fixed["friction"]]
        stated = self.base.material.friction_coefficient
        return [0.0] if stated == 0 else [0.0, stated]

    def _tables(self, points: Sequence[IndentationPoints], mu: float, law: Law) -> list[ForceTable]:
        tables = []
        for i, item in enumerate(points):
            title = f"presses of {item.tool.description} ({i + 1} of {len(points)})"
            if mu:
                title += f", friction {mu:g}"
            tables.append(
                force_table(
                    self.gel,
                    item.tool,
                    (float(item.depth_mm.min()), item.deepest_mm),
                    fixed_nu=self.options.fixed.get("nu"),
                    fixed_ratio=None if law.free_ratio else law.mooney_ratio,
                    friction=mu,
                    physics=self.options.physics,
                    progress=self._told(title),
                )
            )
        return tables

    # The other records ---------------------------------------------------------------------------

    def fit_friction(
        self, sheared: Sequence[ForceRecord], slides: Sequence[SlideFit], videos: bool
    ) -> None:
        """One coefficient from shear, twist, marker flow and slides, unless it is held."""
        self.tangential, self.flows = [], []
        self._remarks["tangential"] = []
        for record in sheared:
            self.fit_tangential(record)
        if videos:
            self.fit_flows()
        self.slides = list(slides)
        if "friction" in self.options.fixed:
            return
        self.friction, self._remarks["friction"] = friction_of(
            self.gel, self.folder, slides, self.tangential, self.flows, self.young, self.shared_nu,
            self.ratio, self.options.physics, self._told("slides"),
        )  # fmt: skip

    def fit_tangential(self, record: ForceRecord) -> None:
        tool = self.gel.tool(record.entry.tool, self.folder.ball_radius_mm)
        young = None
        if "e" in self.options.fixed:
            young = (self.options.fixed["e"], 0.0)
        elif self.young is not None:
            young = (self.young.value, self.young.sigma / self.young.value)
        fit = fit_tangential(
            record, self.gel, tool, poisson_ratio=self.shared_nu, mooney_ratio=self.ratio,
            young_pa=young,
            physics=self.options.physics,
            progress=self._told(f"{record.entry.kind} of {tool.description}"),
        )  # fmt: skip
        self.tangential.append(fit)
        self._remarks["tangential"] += fit.remarks
        if self.young is None and "e" not in self.options.fixed:
            value = math.exp(fit.solution.value("ln_e"))
            relative = math.hypot(fit.solution.sigma_of("ln_e"), fit.table.error, 0.02)
            self.young = Estimate(value, relative * value, "Pa")
            self._remarks["young_of_shear"] = [
                Remark(
                    Severity.WARNING,
                    "young_of_shear",
                    f"Young's modulus of {value:.4g} Pa comes from the normal force of "
                    f"{fit.name} alone, at one depth; record an indentation",
                )
            ]

    def fit_flows(self) -> None:
        """Marker flow of videos with a path: friction, and Poisson's ratio where no press told."""
        flows, remarks = flows_of_folder(self.folder, self.base)
        self._remarks["flows"] = [*remarks]
        for item in flows:
            entry = ToolEntry(
                kind="sphere", radius_mm=self.folder.ball_radius_mm, center_mm=item.path.place_mm
            )
            known = self.nu_estimate is not None or "nu" in self.options.fixed
            fit = fit_flow(
                item.flow, item.path, self.gel, self.gel.tool(entry), name=item.name,
                sha256=item.sha256, fixed_nu=self.shared_nu if known else None,
                mooney_ratio=self.ratio,
                physics=self.options.physics, progress=self._told(f"flow of {item.name}"),
            )  # fmt: skip
            self.flows.append(fit)
            self._remarks["flows"] += fit.remarks
            if not known and fit.nu_told:
                self.flow_nu = fit.nu_estimate
                self.nu = self.flow_nu.value

    def fit_damping(self, record: ForceRecord) -> None:
        tool = self.gel.tool(record.entry.tool, self.folder.ball_radius_mm)
        depth = record.columns["depth_mm"]
        deepest = float(depth.max())
        table = force_table(
            self.gel, tool, (max(0.1 * deepest, float(depth.min())), deepest),
            fixed_nu=self.shared_nu, fixed_ratio=self.ratio, friction=self.used_friction(),
            physics=self.options.physics, progress=self._told(f"presses of {tool.description}"),
        )  # fmt: skip
        gain = viscous_gain(
            self.gel, tool, _rounded(deepest), self.shared_nu, self.ratio, self.options.physics
        )
        fit = fit_damping(record, tool, table, self.shared_nu, self.ratio, gain)
        self.damping.append(fit)
        said = self._remarks.setdefault("damping", [])
        said += fit.remarks
        if self.young is not None:
            ratio = fit.young_modulus_pa / self.young.value
            if not 0.8 < ratio < 1.25:
                said.append(
                    Remark(
                        Severity.WARNING,
                        "relaxation_modulus",
                        f"{fit.name} alone gives {fit.young_modulus_pa:.4g} Pa, {ratio:.2f} times "
                        "that of the indentations; speed, touch point or tool differ",
                    )
                )

    def used_friction(self) -> float:
        """Coefficient of the presses: what is known, or what the indentations fit best with."""
        if self.stiffness is not None:
            return self.stiffness.friction
        return self.press_frictions()[-1]

    def result(
        self, read: Sequence[IndentationPoints | SlideFit], seconds: float
    ) -> MaterialCalibration:
        damping = [f.damping_time_s for f in self.damping if f.damping_time_s is not None]
        fit = None if self.stiffness is None else self.stiffness.fit
        inputs = {}
        others = (*self.slides, *self.tangential, *self.flows, *self.damping)
        for item in (*(fit.points if fit else ()), *others):
            inputs[item.name] = item.sha256
        manifest = self.folder.provenance.get("manifest_sha256")
        if manifest:
            inputs["captures.toml"] = manifest
        correlation = {}
        if fit is not None:
            names = {"ln_e": "young_modulus_pa", "nu": "poisson_ratio"}
            law = [n for n in fit.solution.names if not n.startswith("touch")]
            for i, first in enumerate(law):
                for second in law[i + 1 :]:
                    value = fit.solution.correlation[i, fit.solution.names.index(second)]
                    key = f"{names.get(first, first)}*{names.get(second, second)}"
                    correlation[key] = float(value)
        young = None if "e" in self.options.fixed else self.young
        return MaterialCalibration(
            source=self.folder.provenance.get("source", self.folder.source),
            license=self.folder.provenance.get("license", ""),
            model=self.gel.material.model,
            young_modulus_pa=young,
            poisson_ratio=self.nu_estimate,
            mooney_ratio=None if self.stiffness is None else self.stiffness.ratio,
            friction=self.friction,
            damping_time_s=weighted_mean(damping),
            used_poisson_ratio=self.nu,
            used_mooney_ratio=self.ratio,
            used_friction=self.used_friction(),
            physics=self.options.physics,
            stiffness=self.stiffness,
            slides=tuple(self.slides),
            tangential=tuple(self.tangential),
            flows=tuple(self.flows),
            damping=tuple(self.damping),
            correlation=correlation,
            inputs=inputs,
            remarks=tuple(
                [r for item in read for r in item.remarks]
                + [r for part in self._remarks.values() for r in part]
            ),
            seconds=seconds,
        )


def _rounded(depth_mm: float) -> float:
    """A depth to two digits, so that similar records share presses."""
    return float(f"{depth_mm:.2g}")
