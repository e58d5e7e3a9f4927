# SPDX-License-Identifier: Apache-2.0
"""Friction and Poisson's ratio from how markers move under a tool of known path.

Displacements do not depend on Young's modulus. Where the tool sticks, markers go along with it;
where it slips they stay behind: that pattern tells friction. How far the gel swells beside the
contact tells Poisson's ratio.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev
from scipy.interpolate import CubicSpline
from scipy.spatial import Delaunay

from calibration.markers.flow import MarkerFlow
from calibration.material.likelihood import Group, Likelihood, Parameter, Solution
from calibration.material.response import NU_RANGE
from calibration.material.setup import FRICTION_CONFIG, QUICK, Effort, Gel, Tool
from calibration.material.store import kept
from calibration.result import Remark, Severity
from taccel_lab.envs import PressEnv
from taccel_lab.errors import InputError, SimulationError
from taccel_lab.geometry import Region

MU_NODES = (0.1, 0.18, 0.32, 0.56, 0.8, 1.1)
_CHECK_MU = 0.42
NU_NODES = 3
FRAMES = 8
"""Frames of a video that are fitted, evenly along the tool's path."""
LARGEST_STEP_MM = 0.2
LARGEST_STEP_DEG = 2.0
MIN_MARKERS = 6


@dataclass(frozen=True)
class ToolPath:
    """Where the tool is in each frame."""

    depth_mm: np.ndarray
    """Past first touch, 0 above the gel, shape [frame]."""
    shift_mm: np.ndarray
    """From the place of first touch, shape [frame, 2]."""
    angle_deg: np.ndarray
    """Turn about +z, shape [frame]."""
    place_mm: tuple[float, float] = (0.0, 0.0)
    """Gel xy of first touch [mm]."""

    @classmethod
    def of_poses(cls, poses: dict[str, np.ndarray], source: str) -> ToolPath:
        """From the columns of a path file: z_mm is 0 at first touch and negative in the gel; x_mm
        and y_mm are gel coordinates; missing columns are 0."""
        if "z_mm" not in poses:
            raise InputError(f"{source}: the path needs z_mm (0 at first touch, negative below)")
        count = len(poses["z_mm"])
        zero = np.zeros(count)
        depth = np.maximum(-poses["z_mm"], 0.0)
        if depth.max() <= 0:
            raise InputError(
                f"{source}: z_mm never falls below 0, so the tool never touches; z points out of "
                "the gel and is 0 at first touch"
            )
        shift = np.stack([poses.get("x_mm", zero), poses.get("y_mm", zero)], axis=1)
        place = shift[int(np.argmax(depth > 0))]
        angle = poses.get("angle_deg", zero)
        return cls(depth, shift - place, angle - angle[0], (float(place[0]), float(place[1])))

    def chosen(self, count: int = FRAMES) -> np.ndarray:
        """Frames evenly along the path up to its end; those before the first touch are left out."""
        touching = np.flatnonzero(self.depth_mm > 0)
        way = np.zeros(len(self.depth_mm))
        way[1:] = np.abs(np.diff(self.depth_mm))
        way[1:] += np.linalg.norm(np.diff(self.shift_mm, axis=0), axis=1)
        way[1:] += np.abs(np.radians(np.diff(self.angle_deg)))
        way = np.cumsum(way)
        goals = np.linspace(way[touching[0]], way[touching[-1]], count + 1)[1:]
        return np.unique([touching[np.argmin(np.abs(way[touching] - goal))] for goal in goals])


@dataclass(frozen=True)
class FlowTable:
    """Simulated displacements of markers over friction and Poisson's ratio."""

    mus: np.ndarray
    nu_range: tuple[float, float]
    coefficients: np.ndarray
    """Chebyshev over sqrt(1 - 2 nu); [nu, mu, frame, marker, 2], mm."""
    error_mm: float
    """Root mean square difference to a press between the nodes."""
    seconds: float

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "_spline", CubicSpline(np.log(self.mus), self.coefficients, axis=1)
        )

    def displacement_mm(self, mu: float, poisson_ratio: float) -> np.ndarray:
        """Displacements [mm], shape [frame, marker, 2]."""
        by_nu = self._spline(math.log(mu))  # type: ignore[attr-defined]
        return np.tensordot(_nu_basis(poisson_ratio, self.nu_range, len(by_nu)), by_nu, (0, 0))


@dataclass(frozen=True)
class FlowFit:
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
    def friction(self) -> float:
        return math.exp(self.solution.value("ln_mu"))

    @property
    def friction_interval(self) -> tuple[float, float]:
        low, high = self.solution.profiles["ln_mu"].interval
        return math.exp(low), math.exp(high)

    @property
    def friction_told(self) -> bool:
        """Whether the flow ends the interval of friction on both sides."""
        profile = self.solution.profiles["ln_mu"]
        return not (profile.open_low or profile.open_high)

    @property
    def nu_told(self) -> bool:
        """Whether it ends that of Poisson's ratio."""
        profile = self.solution.profiles.get("nu")
        return profile is not None and not (profile.open_low or profile.open_high)

    def figures(self) -> dict[str, Any]:
        return {
            "name": self.name,
            "friction": self.friction,
            "friction_interval95": self.friction_interval,
            "friction_told": self.friction_told,
            "poisson_ratio": self.poisson_ratio,
            "poisson_ratio_told": self.nu_told,
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
    fixed_nu: float | None = None,
    mooney_ratio: float = 0.0,
    effort: Effort = QUICK,
    progress: Callable[[int, int], None] | None = None,
) -> FlowFit:
    """Fit friction, and Poisson's ratio unless it is fixed, to the motion of markers.

    Args:
        flow: Places at rest and displacements, gel frame.
        path: Tool's path, one entry a frame.
        gel: The pad and the law.
        tool: What touches.
        name: For remarks.
        sha256: Of the video.
        fixed_nu: Poisson's ratio where it is known.
        mooney_ratio: Of the gel.
        effort: Mesh of the presses.
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
    table = flow_table(
        gel, tool, path, frames, points, fixed_nu=fixed_nu, mooney_ratio=mooney_ratio,
        effort=effort, progress=progress,
    )  # fmt: skip
    measured = flow.displacement_mm[frames][:, inside]
    use = np.broadcast_to(seen[:, inside, None], measured.shape)
    sigma = np.hypot(flow.sigma_mm[frames][:, inside], table.error_mm)[use]
    target = measured[use]
    parameters = [
        Parameter("ln_mu", math.log(0.4), math.log(table.mus[0]), math.log(table.mus[-1]), 0.3)
    ]
    if fixed_nu is None:
        parameters.append(Parameter("nu", 0.47, *NU_RANGE, 0.02))

    def values(theta: np.ndarray) -> np.ndarray:
        nu = float(theta[1]) if fixed_nu is None else fixed_nu
        return (table.displacement_mm(math.exp(theta[0]), nu)[use] - target) / sigma

    def residuals(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        steps = np.full(len(theta), 1e-5)
        columns = []
        for i, h in enumerate(steps):
            up, down = theta.copy(), theta.copy()
            up[i] += h
            down[i] -= h
            columns.append((values(up) - values(down)) / (up[i] - down[i]))
        return values(theta), np.stack(columns, axis=1)

    solution = Likelihood(parameters, [Group(len(target), True)], residuals).solve(drawn=True)
    nu = solution.value("nu") if fixed_nu is None else fixed_nu
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
    for key, title in (("ln_mu", "friction"), ("nu", "Poisson's ratio")):
        profile = solution.profiles.get(key)
        if profile is None or not (profile.open_low or profile.open_high):
            continue
        low, high = (math.exp(v) if key == "ln_mu" else v for v in profile.interval)
        if profile.open_low and profile.open_high:
            text = f"does not tell {title}"
        else:
            text = f"only tells that {title} is " + (
                f"above {low:.3g}" if profile.open_high else f"below {high:.3g}"
            )
        remarks.append(
            Remark(Severity.INFO, f"flow_{key}_untold", f"{name} {text}; move the tool farther")
        )
    if rms_mm > 0.3 * moved_mm:
        remarks.append(
            Remark(
                Severity.WARNING,
                "flow_misfit",
                f"{name}: the simulated motion of the markers leaves {rms_mm:.3f} mm of "
                f"{moved_mm:.3f} mm; check path, tool, scale and the gel's shape",
            )
        )
    return remarks


def flow_table(
    gel: Gel,
    tool: Tool,
    path: ToolPath,
    frames: np.ndarray,
    points_mm: np.ndarray,
    *,
    fixed_nu: float | None = None,
    mooney_ratio: float = 0.0,
    effort: Effort = QUICK,
    progress: Callable[[int, int], None] | None = None,
) -> FlowTable:
    """Simulate the tool's path at several coefficients and Poisson's ratios."""
    high, low = (math.sqrt(1 - 2 * nu) for nu in NU_RANGE)
    unit = np.cos(math.pi * (np.arange(NU_NODES) + 0.5) / NU_NODES)
    s = 0.5 * (high + low) + 0.5 * (high - low) * unit
    nus = 0.5 * (1 - s**2) if fixed_nu is None else np.array([fixed_nu])
    count = len(nus) * len(MU_NODES) + 1
    fields: list[list[np.ndarray]] = []
    seconds, done, mus = 0.0, 0, len(MU_NODES)

    def press(nu: float, mu: float) -> np.ndarray:
        nonlocal seconds, done
        if progress is not None:
            progress(done, count)
        done += 1
        found = _path_displacements(
            gel, tool, path, frames, points_mm, nu, mooney_ratio, mu, effort
        )
        seconds += float(found["seconds"])
        return found["displacement_mm"]

    for nu in nus:
        row = []
        for mu in MU_NODES[:mus]:
            field = press(float(nu), mu)
            if not np.isfinite(field).all():
                break  # with this much friction the gel folds up; less is all that can be told
            row.append(field)
        mus = len(row)
        fields.append(row)
    if mus < 3:
        raise SimulationError(
            f"the path of {tool.description} does not converge with friction above "
            f"{MU_NODES[max(mus - 1, 0)]:g}; use a shorter or shallower path"
        )
    values = np.array([row[:mus] for row in fields])
    inverse = np.linalg.inv(chebyshev.chebvander(unit, NU_NODES - 1))
    coefficients = np.tensordot(inverse, values, (1, 0)) if fixed_nu is None else values
    table = FlowTable(np.array(MU_NODES[:mus]), NU_RANGE, coefficients, 0.0, seconds)
    check_nu = 0.485 if fixed_nu is None else fixed_nu
    check_mu = _CHECK_MU if MU_NODES[mus - 1] > _CHECK_MU else 0.24
    check = press(check_nu, check_mu)
    error = table.displacement_mm(check_mu, check_nu) - check
    if progress is not None:
        progress(count, count)
    return FlowTable(table.mus, NU_RANGE, coefficients, float(np.sqrt(np.mean(error**2))), seconds)


def _path_displacements(
    gel: Gel,
    tool: Tool,
    path: ToolPath,
    frames: np.ndarray,
    points_mm: np.ndarray,
    poisson_ratio: float,
    mooney_ratio: float,
    mu: float,
    effort: Effort,
) -> dict[str, np.ndarray]:
    """Motion of points of the contact face [mm], [frame, point, 2]; NaN if it did not converge."""
    depth, shift, angle = path.depth_mm[frames], path.shift_mm[frames], path.angle_deg[frames]

    def simulate() -> dict[str, np.ndarray]:
        mesh = gel.mesh(tool, float(depth.max()), effort)
        env = gel.environment(tool, mesh, poisson_ratio, mooney_ratio, mu)
        nodes, corners, weights = face_weights(env, points_mm)
        rest = env.mesh.nodes_m[nodes, :2]
        moved = np.full((len(frames), len(points_mm), 2), np.nan)
        seconds, before = 0.0, np.zeros(4)
        for k in range(len(frames)):
            goal = np.array([depth[k], *shift[k], angle[k]])
            largest = max(
                np.abs(goal - before)[:3].max() / LARGEST_STEP_MM,
                abs(goal[3] - before[3]) / LARGEST_STEP_DEG,
            )
            steps = max(1, math.ceil(largest - 1e-9))
            for i in range(1, steps + 1):
                at = before + (goal - before) * (i / steps)
                report = env.try_to(float(at[0]), at[1:3], float(at[3]))
                seconds += report.seconds
                if not report.converged[0]:
                    return {"displacement_mm": moved, "seconds": np.array(seconds)}
            change = (env.positions[0][nodes, :2] - rest) * 1e3
            moved[k] = np.einsum("pc,pcx->px", weights, change[corners])
            before = goal
        return {"displacement_mm": moved, "seconds": np.array(seconds)}

    recipe = {
        "what": "flow",
        "gel": gel.recipe(),
        "tool": tool.description,
        "at_mm": list(tool.at_mm),
        "path": np.column_stack([depth, shift, angle]),
        "points_mm": points_mm,
        "nu": poisson_ratio,
        "ratio": mooney_ratio,
        "mu": mu,
        "effort": effort.name,
        "dhat_m": FRICTION_CONFIG.dhat_m,
    }
    return kept(recipe, simulate)


def face_weights(env: PressEnv, points_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes of the contact face, and for each point three of them with barycentric weights.

    Returns:
        Node numbers [node], places in that list [point, 3], weights [point, 3].
    """
    nodes = np.unique(env.mesh.region_faces(Region.CONTACT))
    triangles = Delaunay(env.mesh.nodes_m[nodes, :2] * 1e3)
    simplex = triangles.find_simplex(points_mm)
    if (simplex < 0).any():
        x, y = points_mm[int(np.argmax(simplex < 0))]
        raise InputError(f"the marker at ({x:.2f}, {y:.2f}) mm lies beside the contact face")
    transform = triangles.transform[simplex]
    two = np.einsum("pij,pj->pi", transform[:, :2], points_mm - transform[:, 2])
    weights = np.column_stack([two, 1 - two.sum(axis=1)])
    return nodes, triangles.simplices[simplex], weights


def _on_pad(gel: Gel, points_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Markers that lie on the pad, half a millimetre or more from its edge, and which they are."""
    from sensors.registry import sensor_family

    family = sensor_family(gel.family)
    pad = family.pad(family.parameters(gel.parameters))
    inside = pad.inside_distance_mm(points_mm) > 0.5
    if inside.sum() < MIN_MARKERS:
        raise InputError(
            f"{int(inside.sum())} of {len(points_mm)} markers lie on the pad; check the scale and "
            "where the image's centre is on the gel"
        )
    return points_mm[inside], inside


def _nu_basis(poisson_ratio: float, nu_range: tuple[float, float], count: int) -> np.ndarray:
    if count == 1:
        return np.ones(1)
    s, high, low = (math.sqrt(1 - 2 * nu) for nu in (poisson_ratio, *nu_range))
    return chebyshev.chebvander(np.array([(2 * s - high - low) / (high - low)]), count - 1)[0]
