# SPDX-License-Identifier: Apache-2.0
"""Settings of the IPC solver, checked, and what a user asks of a step."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from taccel_lab.bodies.scene_description import SceneDescription
from taccel_lab.errors import InputError
from taccel_lab.guards import require_range
from taccel_lab.scene import TimeStepping
from taccel_lab.typed import typed

MOST_LEFT = 1e-6
"""Part of a gel's modulus times its size squared: a cube of a millimetre and 0.1 MPa has 1e-7 N of
it. Contacts that squeeze a gel by a hundredth have a hundredth, of which it is the relative
tolerance."""
LEAST_N = 1e-15


@typed
@dataclass(frozen=True)
class SolverConfig:
    """Tolerances and limits; lengths in metres, forces in newtons."""

    dhat_m: float = 2e-5
    """Gap at which contact begins."""
    kappa_pa: float | None = None
    """Contact pressure at about half of dhat, of all contacts; when None of each the larger
    Young's modulus of its soft bodies, between stiff bodies the largest of the scene, as they are
    in the environment, and 1 MPa in a scene without soft bodies."""
    relative_tolerance: float = 1e-4
    """Force residual of a body over its contact force at which it has converged, sums of magnitudes
    over its nodes both; a step has converged where all bodies have."""
    absolute_tolerance_n: float = 1e-7
    """Force residual of a body that is always good enough. Left at the default it is less in scenes
    with gels below a millimetre, see ``within``."""
    max_newton_iterations: int = 200
    max_cg_iterations: int = 2000
    max_line_search_cuts: int = 40
    friction_speed_m_s: float = 5e-5
    """Sliding speed below which friction is static, of a scene with inertia: times the length of a
    step the range of static friction, so that a step of half the length has half of it."""
    friction_eps_m: float = 1e-6
    """Sliding in a whole step below which friction is static, of a quasi-static scene, which knows
    no speed; a part of a step has this part of it."""
    friction_step_share: float = 0.01
    """Largest static range over the way of the tool that goes farthest in a step, of a quasi-static
    scene that tools alone move. What sticks creeps by up to the range in every step: any number of
    steps creeps by at most this part of the whole way. 0: ``friction_eps_m`` in all steps."""
    max_friction_lags: int = 100
    """How often friction may be frozen anew within a step."""
    max_substep_halvings: int = 8
    """How often a step that fails is halved, in the environments where it fails. With 5 one rough
    press in 1,000 (sharp edges, friction of 1, a range of 5 um) stayed unsolved."""
    max_step_iterations: int = 2000
    """Newton iterations of a step, its halves together, after which it is halved no more: eight
    halvings alone would leave it room for hundreds of attempts."""
    max_joint_rounds: int = 20
    """How often Newton may be repeated until the joints are closed."""
    max_collisions: int = 1 << 20
    """Contacts, and candidates for them, beyond which an environment is given up."""
    check_start: bool = True
    """Whether environments are searched for bodies that overlap before their first step."""
    linear_method: str = "auto"
    """How the Newton systems are solved, a key of ``ipc.linear.system.METHODS``; "auto" chooses by
    device and size."""
    capture: bool = True
    """Whether steps are captured as graphs and launched as a whole."""
    deterministic: bool = False
    """Whether two runs on a GPU give the same bits, as they always do on the CPU. What it costs is
    in docs/solver.md."""

    def __post_init__(self) -> None:
        for name, low, high in (
            ("dhat_m", 1e-8, 1e-2),
            ("relative_tolerance", 1e-12, 1.0),
            ("absolute_tolerance_n", LEAST_N, 1e3),
            ("friction_speed_m_s", 1e-12, 1e2),
            ("friction_eps_m", 1e-12, 1e-2),
            ("friction_step_share", 0, 1),
            ("max_newton_iterations", 1, math.inf),
            ("max_step_iterations", 1, math.inf),
            ("max_cg_iterations", 1, math.inf),
            ("max_line_search_cuts", 1, math.inf),
            ("max_friction_lags", 1, math.inf),
            ("max_joint_rounds", 1, math.inf),
            ("max_collisions", 1, math.inf),
            ("max_substep_halvings", 0, 20),
        ):
            require_range(name, getattr(self, name), low, high)
        if self.kappa_pa is not None:
            require_range("kappa_pa", self.kappa_pa, 1, 1e13, "Pa")

    def within(self, scene: SceneDescription) -> SolverConfig:
        """Return the settings for a scene: forces scale with Young's modulus times size squared,
        and by default no more than ``MOST_LEFT`` of that is left in any of its gels."""
        most_n = self.absolute_tolerance_n
        if most_n != SolverConfig.absolute_tolerance_n:
            return self
        for body in scene.soft_bodies:
            size_m = float(np.ptp(body.mesh.nodes_m, axis=0).max())
            most_n = min(most_n, MOST_LEFT * body.material.largest_young_modulus_pa * size_m**2)
        return replace(self, absolute_tolerance_n=max(most_n, LEAST_N))

    def static_range_m(self, time: TimeStepping) -> float:
        """Sliding in a whole step below which friction is static [m].

        Raises:
            InputError: the range of the other kind of scene was set.
        """
        kind, used, unused = "quasi-static", "friction_eps_m", "friction_speed_m_s"
        if not time.quasi_static:
            kind, used, unused = "dynamic", unused, used
        if getattr(self, unused) != getattr(SolverConfig, unused):
            raise InputError(
                f"{unused} means nothing in a {kind} scene; its static friction goes by {used}"
            )
        return self.friction_eps_m if time.quasi_static else self.friction_speed_m_s * time.dt_s


@dataclass
class Control:
    """Targets and loads of a step; what is None stays as it is.

    Arrays of numpy are checked. Arrays on the solver's device, such as torch tensors of float64
    (through DLPack) and arrays of Warp, are read where they are. Their values are not checked, as
    that would wait for the device.
    """

    target_poses: Any = None
    """Where the kinematic bodies are at the end of the step: position [m], quaternion x, y, z, w,
    [env_count, kinematic_count, 7]."""
    joint_targets: Any = None
    """Targets of the drives of joints [rad, m, rad/s or m/s], [env_count, joint_count], in the
    order of the scene; they stay until changed, as ``state.joints.targets``."""
    dt_s: float | None = None
    """Length of the step [s]; the scene's when None. Steps of a quasi-static scene have one only
    where a material relaxes."""
    forces: Any = None
    """Forces on nodes [N], [env_count, node_count, 3]; they stay until changed, see
    ``State.load``."""
    wrenches: Any = None
    """Forces [N] and torques [N m] on affine bodies, [env_count, affine_count, 2, 3]; they stay
    until changed."""
