# SPDX-License-Identifier: Apache-2.0
"""What a step knows about each environment, on the device: nothing here is read by the host until
the step is over."""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.model.env_rows import zero_rows
from taccel_lab.solvers.config import SolverConfig
from taccel_lab.solvers.report import ReportBlock


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


@wp.struct
class EnvProgress:
    """Arrays of shape [env_count]; masks are 0 or 1."""

    who: wp.array(dtype=wp.int32)
    """Mask of the environments that are to take a step."""
    reads: wp.array(dtype=wp.int32)
    """Mask of those that are read from the user's state first."""
    writes: wp.array(dtype=wp.int32)
    """Mask of those that are written to it once their step has converged."""
    fresh: wp.array(dtype=wp.int32)
    """Mask of those that begin it in this call."""
    underway: wp.array(dtype=wp.int32)
    """Mask of those whose step is not closed: they go on with it in the next call."""
    done: wp.array(dtype=wp.int32)
    """Mask of those whose step has converged in this call."""
    failed: wp.array(dtype=wp.int32)
    """Mask of those whose step is rolled back in this call."""
    again: wp.array(dtype=wp.int32)
    """Mask of those that take the step before again: it begins where that began."""
    phase: wp.array(dtype=wp.int32)
    """``env_phase.EnvPhase``; of what follows from it, the next two are masks for kernels."""
    active: wp.array(dtype=wp.int32)
    """Mask of those that are at it: in any phase but RESTING."""
    inner: wp.array(dtype=wp.int32)
    """Mask of those that take part in what only some do: in a phase beyond STEPPING."""
    moving: wp.array(dtype=wp.int32)
    """Mask of those whose frames are still on their way."""
    near: wp.array(dtype=wp.int32)
    """Mask of those whose way may meet something, and is checked by CCD."""
    flying: wp.array(dtype=wp.int32)
    """Mask of those whose start is free flight alone."""
    turning: wp.array(dtype=wp.int32)
    """Mask of those in which a frame turns in this step."""
    inverted_before: wp.array(dtype=wp.int32)
    """Mask of those with an inverted element at the start, in materials that bear it."""
    inverted_after: wp.array(dtype=wp.int32)
    """The same at the end."""
    refused: wp.array(dtype=wp.int32)
    """Mask of those in which BDF2 met an impact."""
    status: wp.array(dtype=wp.int32)
    """``EnvStatus``."""
    untouched: wp.array(dtype=wp.int32)
    """Mask of those that began the step without a contact."""
    newton: wp.array(dtype=wp.int32)
    cg: wp.array(dtype=wp.int32)
    lags: wp.array(dtype=wp.int32)
    joint_rounds: wp.array(dtype=wp.int32)
    cuts: wp.array(dtype=wp.int32)
    """Cuts of the present line search."""
    searches: wp.array(dtype=wp.int32)
    """Searches for pairs in this step."""
    ccd_passes: wp.array(dtype=wp.int32)
    """Ways of this step that were checked for collisions."""
    starts_tried: wp.array(dtype=wp.int32)
    starts_taken: wp.array(dtype=wp.int32)
    """Starts away from where the environment is, of this step."""
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
    contact_force: wp.array(dtype=wp.float64)
    """Sum of the contact forces on one side [N]."""
    min_distance: wp.array(dtype=wp.float64)
    """Smallest gap [m]."""
    violation: wp.array(dtype=wp.float64)
    """Largest violation of a joint [m]."""
    smallest_step: wp.array(dtype=wp.float64)
    progress: wp.array(dtype=wp.float64)
    """Part of the prescribed motion that is done."""
    goal: wp.array(dtype=wp.float64)
    """Progress that the present search direction aims at."""
    stride: wp.array(dtype=wp.float64)
    """Part of the remaining motion that the next one asks for."""
    trial_progress: wp.array(dtype=wp.float64)
    lag_change: wp.array(dtype=wp.float64)
    """Largest ``excess`` since friction was last frozen anew."""
    damping: wp.array(dtype=wp.float64)
    """Longest step while freezing alternates."""
    margin: wp.array(dtype=wp.float64)
    """Reach of the broad phase [m]."""
    rounding: wp.array(dtype=wp.float64)
    """Residual that rounding makes in joints [N]."""
    energy_rounding: wp.array(dtype=wp.float64)
    """Rounding of the elastic energy, however small it is [J]."""
    sharpness: wp.array(dtype=wp.float64)
    """How much of the curvature of friction the next direction counts, see ``friction_hessian``."""
    psd_mode: wp.array(dtype=wp.int32)
    """PSD_* of the next matrix: projected, or as it is."""
    projected: wp.array(dtype=wp.int32)
    """Iterations for which matrices are projected in any case."""
    boost: wp.array(dtype=wp.float64)
    """Multiple of Newton's direction that is searched along."""
    last_residual: wp.array(dtype=wp.float64)
    """``residual`` one iteration earlier; infinite after friction was frozen anew."""
    bend: wp.array(dtype=wp.float64)
    """Largest angle by which the search direction turns an affine body [rad]."""
    reach: wp.array(dtype=wp.float64)
    """Reach of the broad phase along the search direction [m]."""
    joint_energy_rounding: wp.array(dtype=wp.float64)
    """Rounding of the energy of joints [J]."""
    limit: wp.array(dtype=wp.float64)
    """Collision-free fraction of the search direction, or of a turning trial's path."""
    alpha: wp.array(dtype=wp.float64)
    """Fraction of the search direction that is tried."""
    slope: wp.array(dtype=wp.float64)
    """Derivative of the energy along the search direction [J]."""
    before: wp.array(dtype=wp.float64)
    """Energy where the search starts [J]."""
    after: wp.array(dtype=wp.float64)
    """Energy of the trial [J]."""
    base: wp.array(dtype=wp.float64)
    """Energy at the positions without friction [J]."""
    base_after: wp.array(dtype=wp.float64)
    """Energy of the trial without friction [J]."""
    turns: wp.array2d(dtype=wp.float64)
    """Angle by which each frame turns in the step [rad], shape [env_count, kinematic_count]."""
    radii: wp.array2d(dtype=wp.float64)
    """Reach of each frame [m], shape [env_count, kinematic_count]."""
    any_flight: wp.array(dtype=wp.int32)
    """Whether the start of any environment is free flight alone, shape [1] like all below."""
    rounds: wp.array(dtype=wp.int32)
    """Iterations of this call so far."""
    most_rounds: wp.array(dtype=wp.int32)
    """Iterations after which the call ends, whoever is underway."""
    running: wp.array(dtype=wp.int32)
    """Whether any environment is active and has rounds left."""
    searching: wp.array(dtype=wp.int32)
    """How many line searches go on."""
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
NO_LIMIT = 2**30
"""Rounds of a call that ends when all environments are through."""
_FOR_ALL = (
    "any_flight",
    "rounds",
    "most_rounds",
    "running",
    "searching",
    "freezing",
    "closing",
    "reopened",
)


@wp.func
def lower_flags(p: EnvProgress):
    """No environment has asked for anything yet; a kernel that does this raises none of them."""
    p.running[0] = 0
    p.searching[0] = 0
    p.freezing[0] = 0
    p.closing[0] = 0
    p.reopened[0] = 0


class EnvProgressArrays:
    """The arrays of an ``EnvProgress``."""

    def __init__(
        self,
        env_count: int,
        body_count: int,
        carriers: list[int],
        radii_m: np.ndarray,
        device: wp.Device,
    ) -> None:
        self.data = EnvProgress()
        """For kernels."""
        self.report = ReportBlock.zeros(env_count, device)
        """What a report needs, on the memory of ``data``."""
        reported = {_REPORTED.get(name, name): a for name, a in self.report.arrays.items()}
        for name, array in reported.items():
            setattr(self.data, name, array)
        given = (*reported, *_FOR_ALL, "carriers")
        for name, member in EnvProgress.vars.items():
            if name not in given and member.type.ndim == 1:
                zeros = wp.zeros(env_count, dtype=member.type.dtype, device=device)
                setattr(self.data, name, zeros)
        radii = np.tile(radii_m, (env_count // len(radii_m), 1))
        self.data.radii = wp.array(radii, dtype=wp.float64, device=device)
        self.data.turns = wp.zeros_like(self.data.radii)
        for name in ("body_residuals", "body_forces"):
            sums = wp.zeros((env_count, body_count), dtype=wp.float64, device=device)
            setattr(self.data, name, sums)
        self.data.carriers = wp.array(carriers, dtype=wp.int32, device=device)
        for name in _FOR_ALL:
            setattr(self.data, name, wp.zeros(1, dtype=wp.int32, device=device))
        self.data.most_rounds.fill_(NO_LIMIT)
        self.underway = np.zeros(env_count, dtype=bool)
        """Environments whose step goes on in the next call (``ready_steps``), on the host."""
        self.again = np.zeros(env_count, dtype=bool)
        """Of these, those that begin it anew: there was no room for their contacts."""

    def drop(self, who: np.ndarray, mask: wp.array) -> None:
        """Environments of ``who`` (bool, and ``mask`` on the device) are in no step any more."""
        for mine in (self.data.underway, self.data.active, self.data.inner, self.data.phase):
            zero_rows(mask, mine)
        self.underway &= ~who
        self.again &= ~who


def make_rules(
    config: SolverConfig,
    affine_rounding_n: float,
    affine_energy_rounding: float,
    joint_tolerance_m: float | None,
    has_friction: bool,
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
    return rules
