# SPDX-License-Identifier: Apache-2.0
"""One undivided step: projected Newton with CCD and line search, each environment for itself.

Kinematic bodies carry no degrees of freedom. While they are on their way to this step's target,
their remaining motion enters the right-hand side through the contact stiffness, and that of bonded
nodes on a mount through the elastic stiffness, so that the gel moves along with them; the
collision-free fraction of the common motion is taken, and the rest follows in the next iterations.
Only then does the energy have to decrease, to a force residual in newtons.

All of it is launches: what an environment does next is decided on the device, by the stage that it
is in, and loops and branches are conditional nodes, so that the whole step is one captured
graph: recorded once for a solver's arrays, then launched as a whole.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.model.env_lists import EnvList
from taccel_lab.model.launches import CapturedWork
from taccel_lab.solvers.assemble_and_solve import assemble_and_solve
from taccel_lab.solvers.begin_and_end import begin_step, end_step
from taccel_lab.solvers.convergence import measure_and_judge
from taccel_lab.solvers.limit_step import find_pairs, limit_step
from taccel_lab.solvers.search_line import (
    bend_direction,
    energies_at_start,
    find_turning_points,
    open_search,
    try_fraction,
)
from taccel_lab.solvers.solver_parts import SolverParts
from taccel_lab.solvers.start_step import start_step
from taccel_lab.solvers.step_launches import StepLaunches


def take_step(run: StepLaunches) -> None:
    """Goes from the state at the start of the step to that at its end, in
    ``progress.roster.who``."""
    begin_step(run)
    start_step(run)
    measure_and_judge(run, run.p.phases.fresh)
    some, few = run.s.some_places, run.s.few_places
    if some is not None:
        wp.capture_while(run.p.flags.many_running, lambda: _iterate(run))
    if few is not None:
        places = _listed(run, some)
        wp.capture_while(run.p.flags.some_running, lambda: _iterate(places))
    places = _listed(run, few)
    wp.capture_while(run.p.flags.running, lambda: _iterate(places))
    end_step(run)


def _listed(run: StepLaunches, places: EnvList | None) -> StepLaunches:
    """The environments that are active, on the list of ``places``."""
    if places is None:
        return run
    places.fill(run.p.phases.active)
    return StepLaunches(run.s, places)


def _iterate(run: StepLaunches) -> None:
    """One round: environments that want a direction get one, each line search has a trial, and what
    was accepted is judged. A graph's branch around a part that nobody wants would cost more than
    launches that find nobody."""
    assemble_and_solve(run, beside=find_turning_points(run))
    bend_direction(run)
    find_pairs(run, run.stepping, run.s.target_poses, run.p.clearance.reach)
    limit_step(run, run.stepping, beside=energies_at_start(run))
    open_search(run)
    try_fraction(run)
    if run.places is run.s.few_places:
        # Few wait, and a trial alone takes less than a round of launches that find nobody.
        wp.capture_while(run.p.flags.search_goes_on, lambda: try_fraction(run))
    measure_and_judge(run, run.active, take_trial=True)


def launch_step(graph: CapturedWork, solver: SolverParts) -> None:
    """Take a step of the environments in ``progress.roster.who`` to ``end_poses``."""
    # Arrays of lists may have got other memory since, whoever made room in them.
    moves = (part.moves for part in solver.lists)
    kernels = (
        solver.load is not None,
        solver.orders.looks_ahead,
        *(part.capacity > 0 for part in solver.lists),
    )
    arrays = (solver.model.moves, kernels, *moves)
    graph.launch(arrays, lambda: take_step(StepLaunches(solver)), kernels)
