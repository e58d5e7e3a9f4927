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
from typing import Literal

import numpy as np
from numpy.polynomial import chebyshev
from scipy.interpolate import CubicSpline

from calibration.material.setup import (
    FRICTION_CONFIG,
    QUICK,
    REFEREE,
    UNIT_MODULUS_PA,
    Effort,
    Gel,
    Tool,
)
from calibration.material.store import kept
from taccel_lab.envs import PressEnv
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
    """Root mean square difference to a press between the nodes and on a finer mesh, as a part of
    the largest force; the table is corrected by it, so it bounds what is left."""
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
    effort: Effort = QUICK,
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
    for done, mu in enumerate(mus):
        if progress is not None:
            progress(done, len(mus))
        # The last one, between the nodes, is the referee.
        fineness = effort if done < NODES else REFEREE[effort.name]
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
    correction = np.array(tangential[-1]) - check @ along
    error = float(np.sqrt(np.mean(correction**2)) / np.abs(tangential[-1]).max())
    along[0] += correction
    pressed[0] += np.array(normal[-1]) - check @ pressed
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
    effort: Effort,
) -> dict[str, np.ndarray]:
    """Forces of one press of 1 MPa that is sheared or turned in steps."""

    def simulate() -> dict[str, np.ndarray]:
        mesh = gel.mesh(tool, depth_mm, effort)
        env = gel.environment(tool, mesh, poisson_ratio, mooney_ratio, mu)
        seconds = 0.0
        for i in range(PRESS_STEPS):
            seconds += env.move_to(depth_mm * (i + 1) / PRESS_STEPS).seconds
        rows = [tangential_and_normal(env, motion)]
        step = LARGEST_STEP_MM
        if motion == "twist":
            step = math.degrees(step / tool.contact_radius_mm(depth_mm))
        before = 0.0
        for value in scaled[1:] * mu:
            count = math.ceil((value - before) / step)
            for part in np.linspace(before, value, count + 1)[1:]:
                shear = (float(part), 0.0) if motion == "shear" else (0.0, 0.0)
                report = env.try_to(depth_mm, shear, float(part) if motion == "twist" else 0.0)
                seconds += report.seconds
                if not report.converged[0]:
                    break
            else:
                rows.append(tangential_and_normal(env, motion))
                before = value
                continue
            # With much friction the gel folds up behind the tool; no equilibrium is near then.
            break
        rows += [(math.nan, math.nan)] * (len(scaled) - len(rows))
        found = np.array(rows)
        return {
            "tangential": found[:, 0] - found[0, 0],
            "normal_n": found[:, 1],
            "seconds": np.array(seconds),
        }

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
        "effort": effort.recipe(),
        "dhat_m": FRICTION_CONFIG.dhat_m,
    }
    return kept(recipe, simulate)


def tangential_and_normal(env: PressEnv, motion: Motion) -> tuple[float, float]:
    """Resistance to the motion ([N], or [N mm] about the tool's axis) and normal force [N]."""
    force = env.press_force[0]
    if motion == "shear":
        return -float(force[0]), float(force[2])
    x, y = env.poses[0, 0, :2]
    wrench = env.wrench[0]
    about = wrench[5] - (x * wrench[1] - y * wrench[0])
    return -float(about) * 1e3, float(force[2])
