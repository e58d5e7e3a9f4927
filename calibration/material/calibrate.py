# SPDX-License-Identifier: Apache-2.0
"""From captures to a material: which records say what, and in which order they are fitted."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

from calibration.capture import CaptureFolder, ForceRecord
from calibration.capture.schema import ToolEntry
from calibration.material.agreement import (
    SECOND_BALL,
    friction_of,
    press_friction_remark,
    records_disagree,
    residual_remarks,
    weighted_mean,
)
from calibration.material.calibration import MaterialCalibration
from calibration.material.flow import FlowFit, fit_flow
from calibration.material.indentation import IndentationFit, fit_indentation
from calibration.material.likelihood import Profile, require_nlopt
from calibration.material.options import MaterialOptions
from calibration.material.points import (
    IndentationPoints,
    points_of_presses,
    points_of_record,
    require_plausible,
)
from calibration.material.relaxation import DampingFit, check_relaxation, fit_damping
from calibration.material.response import NU_RANGE, ForceTable, force_table
from calibration.material.setup import Gel
from calibration.material.sliding import SlideFit, fit_slide
from calibration.material.tangential import TangentialFit, fit_tangential
from calibration.material.video_flow import flows_of_folder, videos_with_path
from calibration.material.viscous_gain import viscous_gain
from calibration.result import NORMAL_95, Estimate, Remark, Severity
from taccel_lab.errors import InputError
from taccel_lab.profile import SensorProfile

USUAL_NU = (0.45, 0.495)
"""Poisson's ratios of gels, over which an untold one is varied to see what it does to E."""

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
    require_nlopt()
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
    for read in (*points, *slides):
        job.remarks += read.remarks
    started = time.perf_counter()
    if points:
        job.fit_indentation(points)
    for record in (*records["shear"], *records["twist"]):
        job.fit_tangential(record)
    if videos:
        job.fit_flows()
    for record in records["relaxation"]:
        job.fit_damping(record)
    job.fit_friction(slides)
    job.remark_press_friction()
    return job.result(slides, time.perf_counter() - started)


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
        self.remarks: list[Remark] = []
        self.nu = options.fixed.get("nu", base.material.poisson_ratio)
        self.ratio = options.fixed.get("mooney_ratio", gel.material.mooney_ratio)
        self.young: Estimate | None = None
        self.nu_estimate: Estimate | None = None
        self.ratio_estimate: Estimate | None = None
        self.friction: Estimate | None = None
        self.fit: IndentationFit | None = None
        self.profiled: IndentationFit | None = None
        self.tangential: list[TangentialFit] = []
        self.flows: list[FlowFit] = []
        self.damping: list[DampingFit] = []

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

    def fit_indentation(self, points: list[IndentationPoints]) -> None:
        """E, and what else of the law the points tell; the rest is held."""
        start, remarks = require_plausible(points, self.gel.thickness_mm, self.nu)
        self.remarks += remarks
        free_nu = "nu" not in self.options.fixed
        free_ratio = (
            self.gel.material.model == "mooney_rivlin" and "mooney_ratio" not in self.options.fixed
        )
        tables = self._tables(points, free_nu, free_ratio)

        def fit(nu: bool, ratio: bool, at: float | None = None) -> IndentationFit:
            return fit_indentation(
                points, tables, start_pa=start, poisson_ratio=self.nu if at is None else at,
                mooney_ratio=self.ratio, free_nu=nu, free_ratio=ratio,
                touch_sigma_mm=self.options.touch_sigma_mm, drawn=at is None,
            )  # fmt: skip

        found = fit(free_nu, free_ratio)
        self.profiled = found
        tells_nu = free_nu and self._tells(found.solution.profiles["nu"], "nu", tables[0].nu_range)
        tells_ratio = free_ratio and self._tells(
            found.solution.profiles["mooney_ratio"], "mooney_ratio", (0.0, 1.0)
        )
        if free_nu and not tells_nu:
            self.nu = self._held_nu(found.solution.profiles["nu"])
        if (tells_nu, tells_ratio) != (free_nu, free_ratio):
            found = fit(tells_nu, tells_ratio)
        if free_nu and not tells_nu:
            low, high = (fit(False, tells_ratio, nu).young_modulus_pa for nu in USUAL_NU)
            self.remarks.append(
                Remark(
                    Severity.INFO,
                    "young_given_nu",
                    f"Young's modulus holds for nu = {self.nu:g}: it is {low:.4g} Pa for "
                    f"{USUAL_NU[0]:g} and {high:.4g} Pa for {USUAL_NU[1]:g}. Nu is told by "
                    f"{SECOND_BALL}",
                )
            )
        self.fit, self.nu, self.ratio = found, found.poisson_ratio, found.mooney_ratio
        self._keep(found, tells_nu, tells_ratio)
        self.remarks += residual_remarks(found)
        self.remarks += records_disagree(found)

    def _tables(
        self, points: Sequence[IndentationPoints], free_nu: bool, free_ratio: bool
    ) -> list[ForceTable]:
        tables = []
        for i, item in enumerate(points):
            title = f"presses of {item.tool.description} ({i + 1} of {len(points)})"
            tables.append(
                force_table(
                    self.gel,
                    item.tool,
                    (float(item.depth_mm.min()), item.deepest_mm),
                    fixed_nu=None if free_nu else self.nu,
                    fixed_ratio=None if free_ratio else self.ratio,
                    friction=self.options.press_friction,
                    effort=self.options.effort,
                    progress=self._told(title),
                )
            )
        return tables

    def _tells(self, profile: Profile, name: str, bounds: tuple[float, float]) -> bool:
        """Whether the data end the interval of a parameter; says so where they do not."""
        if not (profile.open_low or profile.open_high):
            return True
        low, high = profile.interval
        title = {"nu": "Poisson's ratio", "mooney_ratio": "the Mooney ratio"}[name]
        if profile.open_low and profile.open_high:
            text = f"the records do not tell {title} (any from {bounds[0]:g} to {bounds[1]:g} fits)"
        elif profile.open_high:
            text = f"the records only tell that {title} is above {low:.3g}"
        else:
            text = f"the records only tell that {title} is below {high:.3g}"
        self.remarks.append(
            Remark(Severity.INFO, f"{name}_untold", f"{text}; it is held, not calibrated")
        )
        return False

    def _held_nu(self, profile: Profile) -> float:
        """The base's Poisson's ratio, moved into the interval where the data exclude it."""
        low, high = profile.interval
        held = min(max(self.nu, low), high)
        if held != self.nu:
            self.remarks.append(
                Remark(
                    Severity.WARNING,
                    "nu_excluded",
                    f"nu = {self.nu:g} of the base profile lies outside the interval {low:.3g} to "
                    f"{high:.3g} that the records leave; {held:.3g} is used",
                )
            )
        return held

    def _keep(self, fit: IndentationFit, tells_nu: bool, tells_ratio: bool) -> None:
        value = fit.young_modulus_pa
        self.young = Estimate(value, value * fit.relative_sigma, "Pa", fit.young_interval_pa)
        solution = fit.solution
        if tells_nu:
            self.nu_estimate = Estimate(
                fit.poisson_ratio, solution.sigma_of("nu"), "", solution.profiles["nu"].interval
            )
        if tells_ratio:
            self.ratio_estimate = Estimate(
                fit.mooney_ratio,
                solution.sigma_of("mooney_ratio"),
                "",
                solution.profiles["mooney_ratio"].interval,
            )

    # The other records ---------------------------------------------------------------------------

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
            effort=self.options.friction_effort,
            progress=self._told(f"{record.entry.kind} of {tool.description}"),
        )  # fmt: skip
        self.tangential.append(fit)
        self.remarks += fit.remarks
        if self.young is None and "e" not in self.options.fixed:
            value = math.exp(fit.solution.value("ln_e"))
            relative = math.hypot(fit.solution.sigma_of("ln_e"), fit.table.error, 0.02)
            self.young = Estimate(value, relative * value, "Pa")
            self.remarks.append(
                Remark(
                    Severity.WARNING,
                    "young_of_shear",
                    f"Young's modulus of {value:.4g} Pa comes from the normal force of "
                    f"{fit.name} alone, at one depth; record an indentation",
                )
            )

    def fit_flows(self) -> None:
        """Marker flow of videos with a path: friction, and Poisson's ratio where no press told."""
        flows, remarks = flows_of_folder(self.folder, self.base)
        self.remarks += remarks
        for item in flows:
            entry = ToolEntry(
                kind="sphere", radius_mm=self.folder.ball_radius_mm, center_mm=item.path.place_mm
            )
            known = self.nu_estimate is not None or "nu" in self.options.fixed
            fit = fit_flow(
                item.flow, item.path, self.gel, self.gel.tool(entry), name=item.name,
                sha256=item.sha256, fixed_nu=self.shared_nu if known else None,
                mooney_ratio=self.ratio,
                effort=self.options.friction_effort, progress=self._told(f"flow of {item.name}"),
            )  # fmt: skip
            self.flows.append(fit)
            self.remarks += fit.remarks
            if not known and fit.nu_told:
                self._take_nu(fit.nu_estimate)

    def _take_nu(self, estimate: Estimate) -> None:
        """Poisson's ratio from marker flow; Young's modulus of the indentations follows it."""
        self.nu, self.nu_estimate = estimate.value, estimate
        self.remarks = [r for r in self.remarks if r.code not in ("nu_untold", "young_given_nu")]
        if self.fit is None:
            return
        old, start = self.fit, self.fit.young_modulus_pa

        def fit(nu: float) -> IndentationFit:
            return fit_indentation(
                old.points, old.tables, start_pa=start, poisson_ratio=nu,
                mooney_ratio=old.mooney_ratio, free_nu=False,
                touch_sigma_mm=self.options.touch_sigma_mm, drawn=nu == estimate.value,
            )  # fmt: skip

        self.fit = found = fit(estimate.value)
        low, high = (max(min(nu, NU_RANGE[1]), NU_RANGE[0]) for nu in estimate.interval95)
        slope = abs(math.log(fit(high).young_modulus_pa / fit(low).young_modulus_pa))
        relative = math.hypot(found.relative_sigma, slope / (2 * NORMAL_95))
        value, half = found.young_modulus_pa, NORMAL_95 * relative
        interval = (value * math.exp(-half), value * math.exp(half))
        self.young = Estimate(value, value * relative, "Pa", interval)

    def fit_damping(self, record: ForceRecord) -> None:
        tool = self.gel.tool(record.entry.tool, self.folder.ball_radius_mm)
        depth = record.columns["depth_mm"]
        deepest = float(depth.max())
        table = force_table(
            self.gel, tool, (max(0.1 * deepest, float(depth.min())), deepest),
            fixed_nu=self.shared_nu, fixed_ratio=self.ratio, friction=self.options.press_friction,
            effort=self.options.effort, progress=self._told(f"presses of {tool.description}"),
        )  # fmt: skip
        gain = viscous_gain(
            self.gel,
            tool,
            _rounded(deepest),
            self.shared_nu,
            self.ratio,
            self.options.friction_effort,
        )
        fit = fit_damping(record, tool, table, self.shared_nu, self.ratio, gain)
        self.damping.append(fit)
        self.remarks += fit.remarks
        if self.young is not None:
            ratio = fit.young_modulus_pa / self.young.value
            if not 0.8 < ratio < 1.25:
                self.remarks.append(
                    Remark(
                        Severity.WARNING,
                        "relaxation_modulus",
                        f"{fit.name} alone gives {fit.young_modulus_pa:.4g} Pa, {ratio:.2f} times "
                        "that of the indentations; speed, touch point or tool differ",
                    )
                )

    def fit_friction(self, slides: Sequence[SlideFit]) -> None:
        if "friction" in self.options.fixed:
            return
        self.friction, remarks = friction_of(
            self.gel, self.folder, slides, self.tangential, self.flows, self.young, self.shared_nu,
            self.ratio, self.options.friction_effort, self._told("slides"),
        )  # fmt: skip
        self.remarks += remarks

    def remark_press_friction(self) -> None:
        """What the modulus would be if the presses had rubbed as the gel is now known to."""
        if self.fit is None or self.options.press_friction != 0:
            return
        mu = self.options.fixed.get("friction", self.base.material.friction_coefficient)
        mu = mu if self.friction is None else self.friction.value
        self.remarks += press_friction_remark(
            self.gel, self.fit, mu, self.options.friction_effort, self._told("press with friction")
        )

    def result(self, slides: Sequence[SlideFit], seconds: float) -> MaterialCalibration:
        damping = [f.damping_time_s for f in self.damping if f.damping_time_s is not None]
        fit = self.fit
        inputs = {}
        for item in (
            *(fit.points if fit else ()), *slides, *self.tangential, *self.flows, *self.damping,
        ):  # fmt: skip
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
            mooney_ratio=self.ratio_estimate,
            friction=self.friction,
            damping_time_s=weighted_mean(damping),
            used_poisson_ratio=self.nu,
            used_mooney_ratio=self.ratio,
            press_friction=self.options.press_friction,
            indentation=fit,
            profiled=self.profiled,
            slides=tuple(slides),
            tangential=tuple(self.tangential),
            flows=tuple(self.flows),
            damping=tuple(self.damping),
            correlation=correlation,
            inputs=inputs,
            remarks=tuple(self.remarks),
            seconds=seconds,
        )


def _rounded(depth_mm: float) -> float:
    """A depth to two digits, so that similar records share presses."""
    return float(f"{depth_mm:.2g}")
