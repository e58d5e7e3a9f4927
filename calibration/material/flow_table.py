# SPDX-License-Identifier: Apache-2.0
"""Simulated motion of markers under a tool, over friction and Poisson's ratio.

Displacements do not depend on Young's modulus: the gel is one of 1 MPa.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev
from scipy.interpolate import CubicSpline
from scipy.spatial import Delaunay

from taccel_lab.calibration.material.candidates import Candidate, Reader, prepare, simulate
from taccel_lab.calibration.material.gel_presses import Stop
from taccel_lab.calibration.material.likelihood import Group, Likelihood, Parameter
from taccel_lab.calibration.material.response import NU_RANGE
from taccel_lab.calibration.material.setup import Gel, Tool, compared
from taccel_lab.envs import PressEnv
from taccel_lab.envs.physics import PHYSICS, Accuracy, PressPhysics
from taccel_lab.errors import InputError, SimulationError
from taccel_lab.geometry import Region

MU_NODES = (0.1, 0.14, 0.2, 0.28, 0.4, 0.56, 0.8, 1.1)
_CHECK_MU = 0.47
NU_NODES = 3
FRAMES = 8
"""Frames of a video that are fitted, evenly along the tool's path."""
LARGEST_STEP_MM = 0.2
LARGEST_STEP_DEG = 2.0


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
    """Root mean square difference to a press between the nodes, of another accuracy."""
    relative_error: float
    """What that difference does to friction, as a part of it."""
    nu_error: float
    """The same of Poisson's ratio."""
    seconds: float

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "_spline", CubicSpline(np.log(self.mus), self.coefficients, axis=1)
        )

    def displacement_mm(self, mu: float, poisson_ratio: float) -> np.ndarray:
        """Displacements [mm], shape [frame, marker, 2]."""
        by_nu = self._spline(math.log(mu))  # type: ignore[attr-defined]
        return np.tensordot(_nu_basis(poisson_ratio, self.nu_range, len(by_nu)), by_nu, (0, 0))


def flow_likelihood(
    table: FlowTable,
    use: np.ndarray,
    target_mm: np.ndarray,
    sigma_mm: np.ndarray,
    fixed_nu: float | None,
) -> Likelihood:
    """Misfit of the table over friction, and over Poisson's ratio unless it is fixed."""
    low, high = math.log(table.mus[0]), math.log(table.mus[-1])
    parameters = [Parameter("ln_mu", math.log(0.4), low, high, 0.3)]
    if fixed_nu is None:
        parameters.append(Parameter("nu", 0.47, *NU_RANGE, 0.02))

    def values(theta: np.ndarray) -> np.ndarray:
        nu = float(theta[1]) if fixed_nu is None else fixed_nu
        return (table.displacement_mm(math.exp(theta[0]), nu)[use] - target_mm) / sigma_mm

    def residuals(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        shifts = 1e-5 * np.eye(len(theta))
        columns = [(values(theta + h) - values(theta - h)) / 2e-5 for h in shifts]
        return values(theta), np.stack(columns, axis=1)

    return Likelihood(parameters, [Group(len(target_mm), True)], residuals)


def flow_table(
    gel: Gel,
    tool: Tool,
    path: ToolPath,
    frames: np.ndarray,
    points_mm: np.ndarray,
    *,
    fixed_nu: float | None = None,
    mooney_ratio: float = 0.0,
    physics: PressPhysics = PHYSICS[Accuracy.DEFAULT],
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

    def press(nu: float, mu: float, fineness: PressPhysics = physics) -> np.ndarray:
        nonlocal seconds, done
        if progress is not None:
            progress(done, count)
        done += 1
        found = path_displacements(
            gel, tool, path, frames, points_mm, nu, mooney_ratio, mu, fineness
        )
        seconds += float(found["seconds"])
        return found["displacement_mm"]

    depth = float(path.depth_mm[frames].max())
    prepare(
        gel.bench(tool, depth, physics),
        [
            path_candidate(gel, tool, path, frames, points_mm, float(nu), mooney_ratio, mu, physics)
            for nu in nus
            for mu in MU_NODES
        ],
        progress,
    )
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
    nodes = np.array(MU_NODES[:mus])
    table = FlowTable(nodes, NU_RANGE, coefficients, 0.0, 0.0, 0.0, seconds)
    check_nu = 0.485 if fixed_nu is None else fixed_nu
    check_mu = _CHECK_MU if MU_NODES[mus - 1] > _CHECK_MU else 0.24
    check = press(check_nu, check_mu, compared(physics))
    if progress is not None:
        progress(count, count)
    if not np.isfinite(check).all():
        raise SimulationError(
            f"the path of {tool.description} does not converge with friction of {check_mu:g} and "
            f"accuracy {compared(physics).accuracy}; use a shorter or shallower path"
        )
    # What the mesh does to the estimates: those of the other press, whose parameters are known.
    everywhere = np.ones(check.shape, dtype=bool)
    size = np.full(check.size, float(np.sqrt(np.mean(check**2))))
    seen = flow_likelihood(table, everywhere, check.ravel(), size, fixed_nu).solve(())
    miss = check - table.displacement_mm(check_mu, check_nu)
    return FlowTable(
        nodes,
        NU_RANGE,
        coefficients,
        float(np.sqrt(np.mean(miss**2))),
        abs(seen.value("ln_mu") - math.log(check_mu)),
        abs(seen.value("nu") - check_nu) if fixed_nu is None else 0.0,
        seconds,
    )


def path_displacements(
    gel: Gel,
    tool: Tool,
    path: ToolPath,
    frames: np.ndarray,
    points_mm: np.ndarray,
    poisson_ratio: float,
    mooney_ratio: float,
    mu: float,
    physics: PressPhysics,
) -> dict[str, np.ndarray]:
    """Motion of points of the contact face [mm], [frame, point, 2]; NaN if it did not converge."""
    candidate = path_candidate(
        gel, tool, path, frames, points_mm, poisson_ratio, mooney_ratio, mu, physics
    )
    return simulate(gel.bench(tool, float(path.depth_mm[frames].max()), physics), candidate)


def path_candidate(
    gel: Gel,
    tool: Tool,
    path: ToolPath,
    frames: np.ndarray,
    points_mm: np.ndarray,
    poisson_ratio: float,
    mooney_ratio: float,
    mu: float,
    physics: PressPhysics,
) -> Candidate:
    """The press of ``path_displacements``."""
    depth, shift, angle = path.depth_mm[frames], path.shift_mm[frames], path.angle_deg[frames]
    way = np.column_stack([depth, shift, angle])
    recipe = {
        "what": "flow",
        "gel": gel.recipe(),
        "tool": tool.description,
        "at_mm": list(tool.at_mm),
        "path": way,
        "points_mm": points_mm,
        "nu": poisson_ratio,
        "ratio": mooney_ratio,
        "mu": mu,
        "physics": physics.record(),
    }

    def reader(env: PressEnv, _: Sequence[Candidate]) -> Reader:
        nodes, corners, weights = face_weights(env, points_mm)
        rest = env.mesh.nodes_m[nodes, :2]

        def read() -> np.ndarray:
            change = (env.positions[:, nodes, :2] - rest) * 1e3
            return np.einsum("pc,epcx->epx", weights, change[:, corners])

        return read

    return Candidate(
        recipe,
        poisson_ratio,
        mooney_ratio,
        mu,
        path_stops(way),
        reader,
        arrays=lambda rows: {"displacement_mm": rows},
    )


def path_stops(way: np.ndarray) -> list[Stop]:
    """Stops on a path of rows depth [mm], shift x and y [mm], angle [deg]; the rows are read."""
    stops, before = [], np.zeros(4)
    for goal in way:
        largest = max(
            np.abs(goal - before)[:3].max() / LARGEST_STEP_MM,
            abs(goal[3] - before[3]) / LARGEST_STEP_DEG,
        )
        count = max(1, math.ceil(largest - 1e-9))
        for i in range(1, count + 1):
            depth, x, y, angle = (before + (goal - before) * (i / count)).tolist()
            stops.append(Stop(depth, (x, y), angle, read=i == count))
        before = goal
    return stops


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


def _nu_basis(poisson_ratio: float, nu_range: tuple[float, float], count: int) -> np.ndarray:
    if count == 1:
        return np.ones(1)
    s, high, low = (math.sqrt(1 - 2 * nu) for nu in (poisson_ratio, *nu_range))
    return chebyshev.chebvander(np.array([(2 * s - high - low) / (high - low)]), count - 1)[0]
