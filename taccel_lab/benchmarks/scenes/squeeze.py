# SPDX-License-Identifier: Apache-2.0
"""Two gels grasp a soft bear by its trunk and lift it: soft bodies that touch soft bodies."""

from __future__ import annotations

import numpy as np

from taccel_lab.benchmarks.scenes.base import BenchScene, SceneOptions, make_config
from taccel_lab.benchmarks.scenes.frames import facing, mounted, pose
from taccel_lab.benchmarks.scenes.pads import pad
from taccel_lab.benchmarks.scenes.teddy import PARTS_M, teddy_mesh
from taccel_lab.scene import Element, Material, Plane, Scene, SoftBody, TimeStepping
from taccel_lab.tasks.peg_scene import GRAVITY

DT_S = 1 / 50
TEDDY = Material(young_modulus_pa=2e4, poisson_ratio=0.4, density_kg_m3=250.0)
FRICTION = 0.8
CLEARANCE_M = 0.15e-3
"""Over the ground at the start."""
GRIP_M = 33e-3
"""Height of the middle of the gels."""
GAP_M, SQUEEZE_M, LIFT_M = 1e-3, 4e-3, 30e-3
STEPS = (16, 24)
"""Closing, lifting."""


def build(options: SceneOptions) -> BenchScene:
    """With the published pads of 239 nodes where they are; the bear is always ours."""
    gel, source = pad(239, options.source)
    bear = teddy_mesh()
    gels, mounts = mounted({"front": gel, "back": gel}, FRICTION)
    scene = Scene(
        [
            SoftBody(
                bear,
                TEDDY,
                name="bear",
                friction_coefficient=FRICTION,
                initial_pose=np.array([0, 0, CLEARANCE_M, 0, 0, 0, 1.0]),
                element=Element.LINEAR,
            ),
            *gels,
        ],
        mounts,
        options.env_count,
        TimeStepping(quasi_static=False, dt_s=DT_S, gravity_m_s2=GRAVITY),
        planes=Plane(friction_coefficient=FRICTION, name="ground"),
    )
    return BenchScene(
        "squeeze",
        f"two gels lift a soft bear of {bear.node_count:,} nodes",
        scene,
        make_config({"dhat_m": 1e-4, "friction_speed_m_s": 1e-2}, options.config),
        gel_path(),
        source,
    )


def gel_path() -> np.ndarray:
    """Poses of both mounts, [steps + 1, 2, 7]."""
    close, lift = STEPS
    moments = np.arange(close + lift + 1)
    half = PARTS_M[0, 1, 1]
    gaps = half + np.interp(moments, [0, close], [GAP_M, -SQUEEZE_M])
    part = np.clip((moments - close) / lift, 0, 1)
    heights = GRIP_M + LIFT_M * part**2 * (3 - 2 * part)
    frames = [facing(np.array([0.0, -side, 0.0]), np.array([1.0, 0.0, 0.0])) for side in (1, -1)]
    return np.array(
        [
            [
                pose(frame, np.array([0.0, side * gap, z]))
                for frame, side in zip(frames, (1, -1), strict=True)
            ]
            for gap, z in zip(gaps, heights, strict=True)
        ]
    )
