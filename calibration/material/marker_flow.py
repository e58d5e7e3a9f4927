# SPDX-License-Identifier: Apache-2.0
"""Friction and Poisson's ratio from how markers move under a tool of known path.

Displacements do not depend on Young's modulus. Where the tool sticks, markers go along with it;
where it slips they stay behind: that pattern tells friction. How far the gel swells beside the
contact tells Poisson's ratio.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from taccel_lab.calibration.markers.flow import MarkerFlow
from taccel_lab.calibration.material.friction import FrictionFit
from taccel_lab.calibration.material.gel import Gel, Tool
from taccel_lab.calibration.material.likelihood import Solution, widened
from taccel_lab.calibration.material.marker_flow_table import (
    FlowTable,
    flow_likelihood,
    flow_table,
)
from taccel_lab.calibration.material.remarks import (
    FLOW_FRICTION_UNDETERMINED,
    FLOW_MISFIT,
    FLOW_NU_UNDETERMINED,
)
from taccel_lab.calibration.material.tool_path import ToolPath
from taccel_lab.calibration.result import NORMAL_95, Estimate
from taccel_lab.errors import InputError
from taccel_lab.progress import Progress, silent
from taccel_lab.report.remark import Remark

MIN_MARKERS = 6


@dataclass(frozen=True)
class FlowFit(FrictionFit):
    """What one marker flow tells."""

    name: str
    sha256: str
    tool: Tool
    depth_mm: float
    frames: np.ndarray
    """Frames fitted."""
    points_mm: np.ndarray
    measured_mm: np.ndarray
    """[frame, marker, 2] of the frames fitted; NaN where not seen."""
    fitted_mm: np.ndarray
    solution: Solution
    """Parameters ``ln_mu`` and, where free, ``nu``."""
    poisson_ratio: float
    table: FlowTable
    rms_mm: float
    """Root mean square of what the fit leaves of a component of a displacement."""
    moved_mm: float
    """Root mean square of the displacements themselves."""
    remarks: tuple[Remark, ...]

    @property
    def table_error(self) -> float:
        """Relative error of the simulated table."""
        return self.table.mu_error

    @property
    def nu_estimate(self) -> Estimate:
        """Poisson's ratio with its 95 % interval, the error of the table included."""
        nu, error = self.poisson_ratio, self.table.nu_error
        interval = self.solution.profiles["nu"].interval
        sigma = math.hypot(self.solution.sigma_of("nu"), error)
        return Estimate(nu, sigma, "", widened(interval, nu, NORMAL_95 * error))

    @property
    def nu_determined(self) -> bool:
        """Whether the markers end the interval of Poisson's ratio on both sides."""
        profile = self.solution.profiles.get("nu")
        return profile is not None and profile.closed

    group = "flows"

    def residuals(self) -> dict[str, float]:
        """Of a component of a displacement [mm]."""
        return {"flow_rms_mm": self.rms_mm}

    def valid_region(self) -> dict[str, tuple[float, float]]:
        """The largest depth."""
        return {"flow_depth_mm": (self.depth_mm, self.depth_mm)}

    def figures(self) -> dict[str, Any]:
        """What was found, ready for JSON."""
        return {
            "name": self.name,
            "friction": self.friction,
            "friction_interval95": self.friction_interval,
            "friction_determined": self.friction_determined,
            "poisson_ratio": self.poisson_ratio,
            "poisson_ratio_determined": self.nu_determined,
            "rms_mm": self.rms_mm,
            "moved_mm": self.moved_mm,
            "table_error_mm": self.table.error_mm,
        }


def fit_flow(
    flow: MarkerFlow,
    path: ToolPath,
    gel: Gel,
    tool: Tool,
    *,
    name: str = "marker flow",
    sha256: str = "0" * 64,
    free_nu: bool = True,
    progress: Progress = silent,
) -> FlowFit:
    """Fit friction, and Poisson's ratio where it is free, to the motion of markers.

    Args:
        flow: Places at rest and displacements, gel frame.
        path: Tool's path, one entry a frame.
        gel: The pad and the law.
        tool: What touches.
        name: For remarks.
        sha256: Of the video.
        free_nu: Whether Poisson's ratio is fitted; else it is that of the gel.
        progress: Told how many presses are done, and of how many.

    Raises:
        InputError: Frames and path that differ in number, or too few markers.
        SimulationError: Presses that do not converge even with little friction.
    """
    if len(path.depth_mm) != flow.frame_count:
        raise InputError(
            f"{name}: the path has {len(path.depth_mm)} rows, the video {flow.frame_count} frames"
        )
    frames = path.chosen()
    seen = flow.seen[frames]
    if seen.any(axis=0).sum() < MIN_MARKERS:
        raise InputError(
            f"{name}: {int(seen.any(axis=0).sum())} markers are seen under the tool; at least "
            f"{MIN_MARKERS} are needed"
        )
    points, inside = _on_pad(gel, flow.points_mm)
    table = flow_table(gel, tool, path, frames, points, free_nu=free_nu, progress=progress)
    measured = flow.displacement_mm[frames][:, inside]
    use = np.broadcast_to(seen[:, inside, None], measured.shape)
    sigma = flow.sigma_mm[frames][:, inside][use]
    target = measured[use]
    solution = flow_likelihood(table, use, target, sigma).solve(drawn=True)
    nu = solution.value("nu") if free_nu else gel.material.poisson_ratio
    fitted = table.displacement_mm(math.exp(solution.value("ln_mu")), nu)
    rms = float(np.sqrt(np.mean((fitted[use] - target) ** 2)))
    moved = float(np.sqrt(np.mean(target**2)))
    return FlowFit(
        name, sha256, tool, float(path.depth_mm.max()), frames, points,
        np.where(use, measured, np.nan), fitted, solution, nu, table, rms, moved,
        tuple(_remarks(name, solution, rms, moved)),
    )  # fmt: skip


def _remarks(name: str, solution: Solution, rms_mm: float, moved_mm: float) -> list[Remark]:
    remarks = []
    kinds = {"ln_mu": FLOW_FRICTION_UNDETERMINED, "nu": FLOW_NU_UNDETERMINED}
    for key, kind in kinds.items():
        profile = solution.profiles.get(key)
        if profile is None or profile.closed:
            continue
        if profile.bound is None:
            remarks.append(kind(name=name, verb="does not determine", bounds=""))
        else:
            end = math.exp(profile.bound) if key == "ln_mu" else profile.bound
            bounds = f" is {'above' if profile.open_high else 'below'} {end:.3g}"
            remarks.append(kind(name=name, verb="only shows that", bounds=bounds))
    if rms_mm > 0.3 * moved_mm:
        remarks.append(FLOW_MISFIT(name=name, rms_mm=rms_mm, moved_mm=moved_mm))
    return remarks


def _on_pad(gel: Gel, points_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Markers that lie on the pad, half a millimetre or more from its edge, and which they are."""
    inside = gel.pad.inside_distance_mm(points_mm) > 0.5
    if inside.sum() < MIN_MARKERS:
        raise InputError(
            f"{int(inside.sum())} of {len(points_mm)} markers lie on the pad; check the scale and "
            "where the image's centre is on the gel"
        )
    return points_mm[inside], inside
