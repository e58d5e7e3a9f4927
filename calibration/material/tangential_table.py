# SPDX-License-Identifier: Apache-2.0
"""Simulated shear and twist of a tool at held depth, over the motion and the friction.

While a tool is sheared, its contact slips from the rim inwards. By the similarity of Cattaneo and
Mindlin the tangential force over mu N is nearly one curve of the shift over mu, so presses at a few
coefficients, each stored over shift / mu, interpolate well between them. The same holds of the
torque and the angle.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.polynomial import chebyshev
from scipy.interpolate import CubicSpline

from taccel_lab.calibration.material.candidates import Candidate, prepare, simulate
from taccel_lab.calibration.material.gel_presses import Stop
from taccel_lab.calibration.material.setup import UNIT_MODULUS_PA, Gel, Tool, compared
from taccel_lab.envs import PressEnv
from taccel_lab.envs.physics import PHYSICS, Accuracy, PressPhysics
from taccel_lab.errors import SimulationError

GRID = 1.25
"""Coefficients are simulated at powers of this, so that similar records share presses."""
NODES = 4
"""Coefficients of a table: from below the largest ratio of the record to more than twice it."""
STEPS = 10
PRESS_STEPS = 4
FULL_SLIP_DEPTHS = 2.6
"""Shift over mu, in depths, up to which is simulated: at about 2 the whole contact of a ball
slips."""
LARGEST_MU = 2.4
LARGEST_STEP_MM = 0.2
MIN_STEPS = 5
"""Steps that all presses of a table have to reach."""

Motion = Literal["shear", "twist"]


@dataclass(frozen=True)
class TangentialTable:
    """ln of mu-scaled tangential and normal force of a gel of 1 Pa over scaled motion and mu."""

    motion: Motion
    depth_mm: float
    scaled: np.ndarray
    """Shift [mm] or angle [deg] over mu, rising from 0, shape [step]."""
    mu_range: tuple[float, float]
    tangential: np.ndarray
    """Chebyshev coefficients over ln mu of T / mu [N], torque [N mm] / mu; [node, step]."""
    normal: np.ndarray
    """The same of the normal force [N]."""
    error: float
    """Root mean square difference to a press between the nodes and of another accuracy, as a part
    of the largest force."""
    seconds: float

    def __post_init__(self) -> None:
        both = np.stack([self.tangential, self.normal])
        object.__setattr__(self, "_spline", CubicSpline(self.scaled, both, axis=2))

    def forces(self, motion: np.ndarray, mu: float) -> tuple[np.ndarray, np.ndarray]:
        """Tangential force (or torque [N mm]) and normal force of a gel of 1 Pa, shape [point]."""
        low, high = np.log(self.mu_range)
        z = float(np.clip((2 * math.log(mu) - low - high) / (high - low), -1.2, 1.2))
        basis = chebyshev.chebvander(np.array([z]), len(self.tangential) - 1)[0]
        scaled = np.clip(np.abs(motion) / mu, 0.0, self.scaled[-1])
        both = np.tensordot(basis, self._spline(scaled), (0, 1))  # type: ignore[attr-defined]
        return np.sign(motion) * mu * both[0], both[1]


def tangential_table(
    gel: Gel,
    tool: Tool,
    motion: Motion,
    depth_mm: float,
    least_mu: float,
    reach: float,
    poisson_ratio: float,
    mooney_ratio: float = 0.0,
    *,
    slipped: bool = False,
    physics: PressPhysics = PHYSICS[Accuracy.DEFAULT],
    progress: Callable[[int, int], None] | None = None,
) -> TangentialTable:
    """Simulate shear [mm] or twist [deg] up to ``reach`` at coefficients about ``least_mu``.

    ``least_mu`` is the largest ratio of the forces; a contact that has ``slipped`` as a whole has
    hardly more friction, and a little less on a ball, which leans on the gel before it.
    """
    first = math.floor(math.log((0.8 if slipped else 0.9) * least_mu, GRID))
    last = math.ceil(math.log((1.1 if slipped else 2.2) * least_mu, GRID))
    last = max(min(last, math.floor(math.log(LARGEST_MU, GRID))), first + 2)
    mu_range = (GRID**first, GRID**last)
    unit = np.cos(math.pi * (np.arange(NODES) + 0.5) / NODES)
    middle, half = (
        0.5 * math.log(mu_range[0] * mu_range[1]),
        0.5 * math.log(mu_range[1] / mu_range[0]),
    )
    mus = [*np.exp(middle + half * unit), math.exp(middle + 0.1 * half)]
    full = FULL_SLIP_DEPTHS * depth_mm
    if motion == "twist":
        # The rim of the contact moves by the angle times its radius.
        full = math.degrees(full / tool.contact_radius_mm(depth_mm))
    wanted = reach / mu_range[0]
    longest = min(full, GRID ** math.ceil(math.log(1.02 * wanted, GRID)))
    scaled = longest * np.linspace(0, 1, STEPS + 1) ** 1.3
    tangential, normal, seconds = [], [], 0.0
    nodes = [
        motion_candidate(
            gel, tool, motion, depth_mm, scaled, float(mu), poisson_ratio, mooney_ratio, physics
        )
        for mu in mus[:NODES]
    ]
    prepare(gel.bench(tool, depth_mm, physics), nodes, progress)
    for done, mu in enumerate(mus):
        if progress is not None:
            progress(done, len(mus))
        # The last one, between the nodes, tells the error.
        fineness = physics if done < NODES else compared(physics)
        found = simulate_motion(
            gel, tool, motion, depth_mm, scaled, float(mu), poisson_ratio, mooney_ratio, fineness
        )
        tangential.append(found["tangential"] / mu / UNIT_MODULUS_PA)
        normal.append(found["normal_n"] / UNIT_MODULUS_PA)
        seconds += float(found["seconds"])
    if progress is not None:
        progress(len(mus), len(mus))
    reached = int(np.isfinite(np.array(tangential)).sum(axis=1).min())
    if reached < MIN_STEPS:
        raise SimulationError(
            f"the {motion} of {tool.description} at {depth_mm:g} mm depth and friction of "
            f"{mu_range[0]:.2g} to {mu_range[1]:.2g} converges for {reached - 1} of {STEPS} steps; "
            "record less friction (a drop of oil or powder) or a shallower press"
        )
    tangential = [row[:reached] for row in tangential]
    normal = [row[:reached] for row in normal]
    scaled = scaled[:reached]
    inverse = np.linalg.inv(chebyshev.chebvander(unit, NODES - 1))
    check = chebyshev.chebvander(np.array([0.1]), NODES - 1)[0]
    along, pressed = (inverse @ np.array(rows)[:NODES] for rows in (tangential, normal))
    miss = np.array(tangential[-1]) - check @ along
    error = float(np.sqrt(np.mean(miss**2)) / np.abs(tangential[-1]).max())
    return TangentialTable(motion, depth_mm, scaled, mu_range, along, pressed, error, seconds)


def simulate_motion(
    gel: Gel,
    tool: Tool,
    motion: Motion,
    depth_mm: float,
    scaled: np.ndarray,
    mu: float,
    poisson_ratio: float,
    mooney_ratio: float,
    physics: PressPhysics,
) -> dict[str, np.ndarray]:
    """Forces of one press of 1 MPa that is sheared or turned in steps."""
    candidate = motion_candidate(
        gel, tool, motion, depth_mm, scaled, mu, poisson_ratio, mooney_ratio, physics
    )
    return simulate(gel.bench(tool, depth_mm, physics), candidate)


def motion_candidate(
    gel: Gel,
    tool: Tool,
    motion: Motion,
    depth_mm: float,
    scaled: np.ndarray,
    mu: float,
    poisson_ratio: float,
    mooney_ratio: float,
    physics: PressPhysics,
) -> Candidate:
    """The press of ``simulate_motion``.

    With much friction the gel folds up behind the tool; what follows is NaN.
    """
    recipe = {
        "what": motion,
        "gel": gel.recipe(),
        "tool": tool.description,
        "at_mm": list(tool.at_mm),
        "depth_mm": depth_mm,
        "scaled": scaled,
        "mu": mu,
        "nu": poisson_ratio,
        "ratio": mooney_ratio,
        "physics": physics.record(),
    }
    return Candidate(
        recipe,
        poisson_ratio,
        mooney_ratio,
        mu,
        motion_stops(tool, motion, depth_mm, scaled * mu),
        reader=lambda env, _: lambda: tangential_and_normal(env, motion),
        arrays=lambda rows: {"tangential": rows[:, 0] - rows[0, 0], "normal_n": rows[:, 1]},
        must_reach=1,
    )


def motion_stops(tool: Tool, motion: Motion, depth_mm: float, way: np.ndarray) -> list[Stop]:
    """Down to a depth, then sideways [mm] or about the axis [deg] to the values of ``way``, of
    which the first is 0; each is read."""
    stops = [
        Stop(depth_mm * (i + 1) / PRESS_STEPS, read=i + 1 == PRESS_STEPS)
        for i in range(PRESS_STEPS)
    ]
    step = LARGEST_STEP_MM
    if motion == "twist":
        step = math.degrees(step / tool.contact_radius_mm(depth_mm))
    for before, value in pairwise(way.tolist()):
        count = math.ceil((value - before) / step)
        for i, part in enumerate(np.linspace(before, value, count + 1)[1:].tolist()):
            shift = (part, 0.0) if motion == "shear" else (0.0, 0.0)
            angle = part if motion == "twist" else 0.0
            stops.append(Stop(depth_mm, shift, angle, read=i + 1 == count))
    return stops


def tangential_and_normal(env: PressEnv, motion: Motion) -> np.ndarray:
    """Resistance to the motion ([N], or [N mm] about the tool's axis) and normal force [N], shape
    [env, 2]."""
    force = env.press_force
    if motion == "shear":
        return np.column_stack([-force[:, 0], force[:, 2]])
    x, y = env.poses[:, 0, :2].T
    wrench = env.wrench
    about = wrench[:, 5] - (x * wrench[:, 1] - y * wrench[:, 0])
    return np.column_stack([-about * 1e3, force[:, 2]])
