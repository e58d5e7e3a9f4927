# SPDX-License-Identifier: Apache-2.0
"""One undivided step: projected Newton with CCD and line search, each environment for itself.

Kinematic bodies carry no degrees of freedom. While they are on their way to this step's target,
their remaining motion enters the right-hand side through the contact stiffness, and that of bonded
nodes on a mount through the elastic stiffness, so that the gel moves along with them; the
collision-free fraction of the common motion is taken, and the rest follows in the next iterations.
Only then does the energy have to decrease, to a force residual in newtons.

All of it is launches: what an environment does next is decided on the device, by the stage that it
is in, and loops and branches are conditional nodes, so that the whole step can be one captured
graph.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.solvers.assemble_and_solve import assemble_and_solve
from taccel_lab.solvers.begin_and_end import begin_step, end_step
from taccel_lab.solvers.convergence import measure_and_judge
from taccel_lab.solvers.find_pairs import find_pairs
from taccel_lab.solvers.limit_step import limit_step
from taccel_lab.solvers.search_line import (
    bend_direction,
    energies_at_start,
    find_turning_points,
    search_line,
)
from taccel_lab.solvers.start_step import start_step
from taccel_lab.solvers.step_launches import StepLaunches


def take_step(run: StepLaunches) -> None:
    """Goes from the state at the start of the step to that at its end, in
    ``progress.roster.who``."""
    begin_step(run)
    start_step(run)
    measure_and_judge(run, run.p.phases.fresh)
    wp.capture_while(run.p.flags.running, lambda: _iterate(run))
    end_step(run)


def _iterate(run: StepLaunches) -> None:
    assemble_and_solve(run, beside=find_turning_points(run))
    bend_direction(run)
    find_pairs(run, run.p.phases.active, run.s.target_poses, run.p.clearance.reach)
    limit_step(run, run.p.phases.active, beside=energies_at_start(run))
    search_line(run)
    measure_and_judge(run, run.p.phases.active, take_trial=True)
