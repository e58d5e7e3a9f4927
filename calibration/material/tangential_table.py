# SPDX-License-Identifier: Apache-2.0
"""Simulated shear and twist of a tool at held depth, over the motion and the friction.

While a tool is sheared, its contact slips from the rim inwards. By the similarity of Cattaneo and
Mindlin the tangential force over mu N is nearly one curve of the shift over mu, so presses at a few
coefficients, each stored over shift / mu, interpolate well between them. The same holds of the
torque and the angle.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from taccel_lab.calibration.material.gel import (
    UNIT_MODULUS_PA,
    Gel,
    Tool,
)
from taccel_lab.calibration.material.gel_presses import Stop
from taccel_lab.calibration.material.interpolation import Axis, ResponseTable
from taccel_lab.calibration.material.press_plans import GelBench, PressPlan, simulate, simulate_each
from taccel_lab.envs import PressEnv
from taccel_lab.errors import SimulationError
from taccel_lab.progress import Progress, silent

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
_NONE = Axis(0.0, 0.0)


@dataclass(frozen=True)
class TangentialTable:
    """Tangential and normal force of a gel of 1 Pa over motion and mu."""

    responses: ResponseTable
    """Tangential force [N] or torque [N mm] over mu, and normal force [N]; over mu and over the
    shift [mm] or angle [deg] over mu, which rises from 0."""
    error: float
    """Root mean square difference to a press between the nodes and of another accuracy, as a part
    of the largest force."""

    @property
    def mu_range(self) -> tuple[float, float]:
        """Coefficients of friction of the table."""
        return self.responses.second.low, self.responses.second.high

    @property
    def reach(self) -> float:
        """Motion [mm] or [deg] that is simulated at the least coefficient."""
        return float(self.responses.way[-1]) * self.mu_range[0]

    def forces(self, motion: np.ndarray, mu: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Tangential force (or torque [N mm]) and normal force of a gel of 1 Pa at motions >= 0,
        and their derivatives by the motion and by ln mu; each of shape [2, point]."""
        low, high = self.mu_range
        scaled = motion / mu
        value, _, by_mu, by_scaled = self.responses.at(0.0, min(max(mu, low), high), scaled)
        # The tangential force is mu times what is stored, the normal one is stored as it is.
        factor = np.array([[mu], [1.0]])
        by_ln_mu = factor * (mu * by_mu - scaled * by_scaled)
        by_ln_mu[0] += mu * value[0]
        return factor * value, factor * by_scaled / mu, by_ln_mu


def tangential_table(
    gel: Gel,
    tool: Tool,
    motion: Motion,
    depth_mm: float,
    least_mu: float,
    reach: float,
    *,
    slipped: bool = False,
    progress: Progress = silent,
) -> TangentialTable:
    """Simulate shear [mm] or twist [deg] up to ``reach`` at coefficients about ``least_mu``.

    ``least_mu`` is the largest ratio of the forces; a contact that has ``slipped`` as a whole has
    hardly more friction, and a little less on a ball, which leans on the gel before it.

    Raises:
        SimulationError: Presses that do not converge for long enough.
    """
    first = math.floor(math.log((0.8 if slipped else 0.9) * least_mu, GRID))
    last = math.ceil(math.log((1.1 if slipped else 2.2) * least_mu, GRID))
    last = max(min(last, math.floor(math.log(LARGEST_MU, GRID))), first + 2)
    axis = Axis(GRID**first, GRID**last, "logarithm")
    # Between the nodes.
    check_mu = math.sqrt(axis.low * axis.high) * (axis.high / axis.low) ** 0.05
    full = FULL_SLIP_DEPTHS * depth_mm
    if motion == "twist":
        # The rim of the contact moves by the angle times its radius.
        full = math.degrees(full / tool.contact_radius_mm(depth_mm))
    longest = min(full, GRID ** math.ceil(math.log(1.02 * reach / axis.low, GRID)))
    scaled = longest * np.linspace(0, 1, STEPS + 1) ** 1.3
    mus = [*axis.nodes(NODES).tolist(), check_mu]
    benches = [GelBench(gel, tool, depth_mm), GelBench(gel.for_comparison(), tool, depth_mm)]
    plans = [motion_plan(benches[i >= NODES], motion, scaled, mu) for i, mu in enumerate(mus)]
    task = f"{motion} of {tool.description}"
    found = [
        *simulate_each(benches[0], plans[:NODES], progress, task),
        simulate(benches[1], plans[NODES]),
    ]
    forces = np.array(
        [[f["tangential"] / mu, f["normal_n"]] for f, mu in zip(found, mus, strict=True)]
    )
    reached = int(np.isfinite(forces[:, 0]).sum(axis=1).min())
    if reached < MIN_STEPS:
        raise SimulationError(
            f"the {motion} of {tool.description} at {depth_mm:g} mm depth and friction of "
            f"{axis.low:.2g} to {axis.high:.2g} converges for {reached - 1} of {STEPS} steps; "
            "record less friction (a drop of oil or powder) or a shallower press"
        )
    forces, scaled = forces[..., :reached] / UNIT_MODULUS_PA, scaled[:reached]
    responses = ResponseTable.through(_NONE, axis, scaled, forces[None, :NODES])
    own = forces[NODES, 0]
    miss = own - responses.at(0.0, check_mu, scaled).value[0]
    return TangentialTable(responses, float(np.sqrt(np.mean(miss**2)) / np.abs(own).max()))


def motion_plan(
    bench: GelBench,
    motion: Motion,
    scaled: np.ndarray,
    mu: float,
) -> PressPlan:
    """A press to the depth of the bench that is sheared or turned in steps, ``scaled`` times mu.

    Gives ``tangential``, the resistance to the motion less that at its start, and ``normal_n``.
    With much friction the gel folds up behind the tool; what follows is NaN.
    """
    return bench.plan(
        motion,
        bench.gel,
        mu,
        {"depth_mm": bench.depth_mm, "scaled": scaled, "mu": mu},
        _motion_stops(bench.tool, motion, bench.depth_mm, scaled * mu),
        read=lambda env, _: tangential_and_normal(env, motion),
        arrays=lambda rows: {"tangential": rows[:, 0] - rows[0, 0], "normal_n": rows[:, 1]},
        must_reach=1,
    )


def _motion_stops(tool: Tool, motion: Motion, depth_mm: float, way: np.ndarray) -> Sequence[Stop]:
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
