# SPDX-License-Identifier: Apache-2.0
"""What a step knows about each environment, on the device: nothing here is read by the host until
the step is over."""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.model import Model
from taccel_lab.model.env_lists import EnvList
from taccel_lab.model.launches import launch
from taccel_lab.solvers.config import SolverConfig
from taccel_lab.solvers.step_report import ReportBlock

wp.set_module_options({"enable_backward": False})

FEW, SOME = 64, 512
"""Environments that have a list, and launches of their own size, once no more are left of a batch
twice as large."""


@wp.struct
class Rules:
    """Tolerances and limits of a solver, see ``SolverConfig``."""

    dhat: wp.float64
    relative_tolerance: wp.float64
    absolute_tolerance: wp.float64
    affine_rounding: wp.float64
    """Residual that rounding makes in stiff affine bodies [N]."""
    affine_energy_rounding: wp.float64
    """What it makes of their energy, over the root of the energy [J^(1/2)]."""
    joint_tolerance: wp.float64
    """Violation of a joint that counts as none [m]."""
    max_newton: wp.int32
    max_lags: wp.int32
    max_joint_rounds: wp.int32
    max_cuts: wp.int32
    has_joints: wp.int32
    has_friction: wp.int32
    is_held: wp.int32
    """Whether all that moves without being told to are gels at rest that touch no gels."""
    few: wp.int32
    some: wp.int32
    """Environments that stand on a list once no more are left."""


# Arrays of a part have shape [env_count] unless they say otherwise; masks are 0 or 1.


@wp.struct
class Roster:
    """Who is to take a step, and what has become of it: masks for the host and for the state."""

    who: wp.array(dtype=wp.int32)
    """Mask of the environments that are to take a step."""
    reads: wp.array(dtype=wp.int32)
    """Mask of those that are read from the user's state first."""
    writes: wp.array(dtype=wp.int32)
    """Mask of those that are written to it once their step has converged."""
    underway: wp.array(dtype=wp.int32)
    """Mask of those whose step is not closed: they go on with it in the next call."""
    done: wp.array(dtype=wp.int32)
    """Mask of those whose step has converged in this call."""
    failed: wp.array(dtype=wp.int32)
    """Mask of those whose step is rolled back in this call."""
    again: wp.array(dtype=wp.int32)
    """Mask of those that take the step before again: it begins where that began."""
    ahead: wp.array(dtype=wp.int32)
    """Mask of those that search from where the caller says, see ``SolverIPC.step``."""
    inverted_before: wp.array(dtype=wp.int32)
    """Mask of those with an inverted element at the start, in materials that bear it."""
    inverted_after: wp.array(dtype=wp.int32)
    """The same at the end."""
    refused: wp.array(dtype=wp.int32)
    """Mask of those in which BDF2 met an impact."""


@wp.struct
class Phases:
    """Where each environment stands in its step (``env_phase``)."""

    fresh: wp.array(dtype=wp.int32)
    """Mask of those that begin it in this call."""
    phase: wp.array(dtype=wp.int32)
    """``env_phase.EnvPhase``; the next four are what follows from it, as masks for kernels."""
    active: wp.array(dtype=wp.int32)
    """Mask of those that are at it: in any phase but RESTING."""
    stepping: wp.array(dtype=wp.int32)
    """Mask of those in phase STEPPING."""
    searching: wp.array(dtype=wp.int32)
    """Mask of those in phase SEARCHING."""
    inner: wp.array(dtype=wp.int32)
    """Mask of those that take part in what only some do: in any other phase."""
    flying: wp.array(dtype=wp.int32)
    """Mask of those whose start is free flight alone."""
    status: wp.array(dtype=wp.int32)
    """``EnvStatus``."""


@wp.struct
class Counts:
    """How often what was done in a step; for reports, and against limits."""

    newton: wp.array(dtype=wp.int32)
    cg: wp.array(dtype=wp.int32)
    lags: wp.array(dtype=wp.int32)
    joint_rounds: wp.array(dtype=wp.int32)
    searches: wp.array(dtype=wp.int32)
    """Searches for pairs in this step."""
    ccd_passes: wp.array(dtype=wp.int32)
    """Ways of this step that were checked for collisions."""
    starts_tried: wp.array(dtype=wp.int32)
    starts_taken: wp.array(dtype=wp.int32)
    """Starts away from where the environment is, of this step."""


@wp.struct
class Prescribed:
    """The prescribed motion of kinematic bodies, and how much of it is done."""

    moving: wp.array(dtype=wp.int32)
    """Mask of those whose frames are still on their way."""
    turning: wp.array(dtype=wp.int32)
    """Mask of those in which a frame turns in this step."""
    progress: wp.array(dtype=wp.float64)
    """Part of the prescribed motion that is done."""
    goal: wp.array(dtype=wp.float64)
    """Progress that the present search direction aims at."""
    stride: wp.array(dtype=wp.float64)
    """Part of the remaining motion that the next one asks for."""
    trial_progress: wp.array(dtype=wp.float64)
    turns: wp.array2d(dtype=wp.float64)
    """Angle by which each frame turns in the step [rad], shape [env_count, kinematic_count]."""
    radii: wp.array2d(dtype=wp.float64)
    """Reach of each frame [m], shape [env_count, kinematic_count]."""


@wp.struct
class Clearance:
    """How far the way ahead is free of collisions, and how far pairs are searched for."""

    near: wp.array(dtype=wp.int32)
    """Mask of those whose way may meet something, and is checked by CCD."""
    safe: wp.array(dtype=wp.float64)
    """Fraction up to which trials keep to the chords that were checked; longer ones are checked
    again."""
    limit: wp.array(dtype=wp.float64)
    """Collision-free fraction of the search direction."""
    margin: wp.array(dtype=wp.float64)
    """Reach of the broad phase [m]."""
    reach: wp.array(dtype=wp.float64)
    """Reach of the broad phase along the search direction [m]."""
    bend: wp.array(dtype=wp.float64)
    """Largest angle by which the search direction turns an affine body [rad]."""
    flight_turn_sq: wp.array(dtype=wp.float64)
    """Square of the largest angle by which an affine body turns in free flight."""


@wp.struct
class Balance:
    """Forces that are not in balance, what is allowed of them, and how friction settles."""

    body_residuals: wp.array2d(dtype=wp.float64)
    """Sum of the magnitudes of the force residual of each body [N], [env_count, body_count]."""
    body_forces: wp.array2d(dtype=wp.float64)
    """Sum of the magnitudes of the contact forces on the nodes of each body [N], the same shape."""
    carriers: wp.array(dtype=wp.int32)
    """Body that each soft body is mounted on, -1 for none, [soft_count]; empty where none is."""
    residual: wp.array(dtype=wp.float64)
    """Largest force residual of a body [N]."""
    excess: wp.array(dtype=wp.float64)
    """Largest force residual of a body over what is allowed that body."""
    last_residual: wp.array(dtype=wp.float64)
    """``residual`` one iteration earlier; infinite after friction was frozen anew."""
    contact_force: wp.array(dtype=wp.float64)
    """Sum of the contact forces on one side [N]."""
    min_distance: wp.array(dtype=wp.float64)
    """Smallest gap [m]."""
    violation: wp.array(dtype=wp.float64)
    """Largest violation of a joint [m]."""
    rounding: wp.array(dtype=wp.float64)
    """Residual that rounding makes in joints [N]."""
    lag_change: wp.array(dtype=wp.float64)
    """``excess`` when friction was last frozen anew; infinite before."""
    damping: wp.array(dtype=wp.float64)
    """Longest step while freezing alternates."""


@wp.struct
class Curvature:
    """What of the curvature the next matrix has."""

    sharpness: wp.array(dtype=wp.float64)
    """How much of the curvature of friction the next direction counts, see ``friction_hessian``."""
    psd_mode: wp.array(dtype=wp.int32)
    """PSD_* of the next matrix: projected, or as it is."""
    element_mode: wp.array(dtype=wp.int32)
    """The same of its elements."""
    projected: wp.array(dtype=wp.int32)
    """Iterations for which matrices are projected in any case."""


@wp.struct
class Search:
    """The line search: its energies and the fraction that it tries."""

    alpha: wp.array(dtype=wp.float64)
    """Fraction of the search direction that is tried."""
    cuts: wp.array(dtype=wp.int32)
    """Cuts of the present line search."""
    strays: wp.array(dtype=wp.int32)
    """Mask of those whose trial may leave the chords that were checked, and is checked itself."""
    free: wp.array(dtype=wp.float64)
    """Collision-free fraction of the path of such a trial."""
    smallest_step: wp.array(dtype=wp.float64)
    derivative: wp.array(dtype=wp.float64)
    """Directional derivative of the energy along the search direction [J]."""
    before: wp.array(dtype=wp.float64)
    """Energy where the search starts [J]."""
    after: wp.array(dtype=wp.float64)
    """Energy of the trial [J]."""
    base: wp.array(dtype=wp.float64)
    """Energy at the positions without friction [J]."""
    base_after: wp.array(dtype=wp.float64)
    """Energy of the trial without friction [J]."""
    energy_rounding: wp.array(dtype=wp.float64)
    """Rounding of the elastic energy, however small it is [J]."""
    joint_energy_rounding: wp.array(dtype=wp.float64)
    """Rounding of the energy of joints [J]."""


@wp.struct
class Gain:
    """What the iterations of a step have gained, see ``env_phase.gains``."""

    least_excess: wp.array(dtype=wp.float64)
    """Least ``Balance.excess`` since all frames arrived."""
    least_energy: wp.array(dtype=wp.float64)
    """Least energy since then [J]."""
    counted: wp.array(dtype=wp.float64)
    """Part of the prescribed motion that was last counted as a gain."""
    idle: wp.array(dtype=wp.int32)
    """Iterations since the last gain."""


@wp.struct
class Flags:
    """What holds for all environments of a call together: arrays of shape [1]."""

    any_flight: wp.array(dtype=wp.int32)
    """Whether the start of any environment is free flight alone."""
    rounds: wp.array(dtype=wp.int32)
    """Rounds of this call so far: each a direction where one is wanted, and a trial."""
    most_rounds: wp.array(dtype=wp.int32)
    """Rounds after which the call ends, whoever is underway."""
    going: wp.array(dtype=wp.int32)
    """How many environments are active and have rounds left."""
    running: wp.array(dtype=wp.int32)
    """Whether any is; ``some_running``: more than ``few``; ``many_running``: more than ``some``."""
    some_running: wp.array(dtype=wp.int32)
    many_running: wp.array(dtype=wp.int32)
    search_goes_on: wp.array(dtype=wp.int32)
    """Whether any line search goes on of environments that step together."""
    freezing: wp.array(dtype=wp.int32)
    """Whether friction is frozen anew anywhere."""
    closing: wp.array(dtype=wp.int32)
    """Whether Newton has converged in any environment whose joints may be open."""
    reopened: wp.array(dtype=wp.int32)
    """Whether the joints of any environment were open."""


_REPORTED = {
    "newton_iterations": "newton",
    "cg_iterations": "cg",
    "friction_lags": "lags",
    "residual_n": "residual",
    "residual_ratio": "excess",
    "contact_force_n": "contact_force",
    "min_distance_m": "min_distance",
    "joint_violation_m": "violation",
}
"""Names of the figures of a report here, where they differ."""
NO_LIMIT = wp.constant(2**30)
"""Rounds of a call that ends when all environments have finished."""


@wp.struct
class Progress:
    """All of it, for kernels: what the host has by the same names in ``EnvProgress``."""

    roster: Roster
    phases: Phases
    counts: Counts
    prescribed: Prescribed
    clearance: Clearance
    balance: Balance
    curvature: Curvature
    search: Search
    gain: Gain
    flags: Flags
    rules: Rules


@wp.func
def lower_flags(p: Progress):
    """No environment has asked for anything yet; a kernel that does this raises none of them."""
    p.flags.going[0] = 0
    p.flags.running[0] = 0
    p.flags.some_running[0] = 0
    p.flags.many_running[0] = 0
    p.flags.search_goes_on[0] = 0
    p.flags.freezing[0] = 0
    p.flags.closing[0] = 0
    p.flags.reopened[0] = 0


@wp.kernel
def _drop_kernel(mask: wp.array(dtype=wp.int32), p: Progress):
    env = wp.tid()
    if mask[env] != 0:
        p.roster.underway[env] = 0
        p.phases.phase[env] = 0
        p.phases.active[env] = 0
        p.phases.stepping[env] = 0
        p.phases.searching[env] = 0
        p.phases.inner[env] = 0


class EnvProgress:
    """The parts, on the device, with what the host knows of them."""

    def __init__(
        self,
        env_count: int,
        body_count: int,
        carriers: list[int],
        radii_m: np.ndarray,
        rules: Rules,
        told: dict[str, wp.array],
        device: wp.Device,
    ) -> None:
        """Make them; ``told`` are the masks of the roster that the host sets (``step_orders``)."""
        self.roster, self.phases, self.counts = Roster(), Phases(), Counts()
        self.prescribed, self.clearance, self.balance = Prescribed(), Clearance(), Balance()
        self.curvature, self.search = Curvature(), Search()
        self.gain, self.flags = Gain(), Flags()
        self.rules = rules
        self.report = ReportBlock.zeros(env_count, device)
        """What a report needs, on the memory of the parts."""
        reported = {_REPORTED.get(name, name): a for name, a in self.report.arrays.items()}
        radii = np.tile(radii_m, (env_count // len(radii_m), 1))
        sums = (env_count, body_count)
        given = (
            reported
            | told
            | {
                "carriers": wp.array(carriers, dtype=wp.int32, device=device),
                "radii": wp.array(radii, dtype=wp.float64, device=device),
                "turns": wp.zeros(radii.shape, dtype=wp.float64, device=device),
                "body_residuals": wp.zeros(sums, dtype=wp.float64, device=device),
                "body_forces": wp.zeros(sums, dtype=wp.float64, device=device),
            }
        )
        self.struct = Progress()
        """The parts for kernels."""
        for part, member in Progress.vars.items():
            mine = getattr(self, part)
            for name, entry in member.type.vars.items() if part != "rules" else ():
                array = given.get(name)
                if array is None:
                    length = 1 if part == "flags" else env_count
                    array = wp.zeros(length, dtype=entry.type.dtype, device=device)
                setattr(mine, name, array)
            setattr(self.struct, part, mine)
        self.flags.most_rounds.fill_(NO_LIMIT)
        self.underway = np.zeros(env_count, dtype=bool)
        """Environments whose step goes on in the next call (``ready_steps``), on the host."""
        self.again = np.zeros(env_count, dtype=bool)
        """Environments of these that begin it anew: there was no room for their contacts."""

    def drop(self, who: np.ndarray, mask: wp.array) -> None:
        """Environments of ``who`` (bool, and ``mask`` on the device) are in no step any more."""
        launch(_drop_kernel, len(mask), mask, self.struct)
        self.underway &= ~who
        self.again &= ~who


def list_places(model: Model) -> tuple[EnvList | None, EnvList | None]:
    """Places for the environments of a step when few are left, and when some are."""
    few, some = (
        EnvList(size, model.device) if model.env_count >= 2 * size else None for size in (FEW, SOME)
    )
    return few, some


def make_rules(
    config: SolverConfig,
    affine_rounding_n: float,
    affine_energy_rounding: float,
    joint_tolerance_m: float | None,
    has_friction: bool,
    is_held: bool,
) -> Rules:
    """The rules of a solver; ``joint_tolerance_m`` is None without joints."""
    rules = Rules()
    rules.dhat = config.dhat_m
    rules.relative_tolerance = config.relative_tolerance
    rules.absolute_tolerance = config.absolute_tolerance_n
    rules.affine_rounding = affine_rounding_n
    rules.affine_energy_rounding = affine_energy_rounding
    rules.joint_tolerance = joint_tolerance_m or 0.0
    rules.max_newton = config.max_newton_iterations
    rules.max_lags = config.max_friction_lags
    rules.max_joint_rounds = config.max_joint_rounds
    rules.max_cuts = config.max_line_search_cuts
    rules.has_joints = int(joint_tolerance_m is not None)
    rules.has_friction = int(has_friction)
    rules.is_held = int(is_held)
    rules.few, rules.some = FEW, SOME
    return rules
