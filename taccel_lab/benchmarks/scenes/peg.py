# SPDX-License-Identifier: Apache-2.0
"""The peg insertion of Taccel as published, ``tasks.peg_scene``, as a benchmark."""

from __future__ import annotations

import numpy as np

from taccel_lab.benchmarks.scenes.base import BenchScene, SceneOptions, make_config
from taccel_lab.solvers import SolverConfig
from taccel_lab.tasks.peg_scene import (
    DHAT_M,
    FRICTION_SPEED_M_S,
    STEPS,
    peg_parts,
    peg_scene,
    targets,
)


def peg_config(**options: float) -> SolverConfig:
    """The published gap and friction speed; converged to 1e-4 of the contact force by default."""
    return make_config({"dhat_m": DHAT_M, "friction_speed_m_s": FRICTION_SPEED_M_S}, options)


def build(options: SceneOptions) -> BenchScene:
    """The published insertion, of the published meshes where they are."""
    parts, source = peg_parts(options.source)
    scene = peg_scene(parts, env_count=options.env_count)
    # The first step stays at the start: the gels move from the second one on.
    one = peg_scene(parts)
    times = [0, *range(STEPS)]
    return BenchScene(
        "peg",
        "two gels of 139 nodes carry a free peg over the rim of a hole and push it in",
        scene,
        peg_config(**options.config),
        np.array([targets(one, step)[0] for step in times]),
        source,
    )
