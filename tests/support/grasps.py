# SPDX-License-Identifier: Apache-2.0
"""Gels on two mounts that close from both sides, and a gel on a hand above a table."""

from __future__ import annotations

from typing import Any

import numpy as np

from taccel_lab.scene import (
    Element,
    KinematicBody,
    Material,
    MaxwellBranch,
    Scene,
    SoftBody,
    TimeStepping,
    box_mesh,
)
from tests.support.blocks import soft_block

SIDES = ("left", "right")
HALF = float(np.sqrt(0.5))
FALLING = TimeStepping(quasi_static=False, dt_s=4e-3, gravity_m_s2=(0.0, 0.0, -9.81))


def mounted_gels(
    cells: tuple[int, int, int], elements: tuple[Element, Element], material: Material | None = None
) -> tuple[list[SoftBody], list[KinematicBody]]:
    """Rough gels of 6 x 6 x 3 mm and the mounts that carry them."""
    gels = [
        soft_block(
            cells, (6e-3, 6e-3, 3e-3), material, element,
            name=side, mount=f"{side} mount", friction_coefficient=1.0,
        )
        for side, element in zip(SIDES, elements, strict=True)
    ]  # fmt: skip
    return gels, [KinematicBody(None, name=f"{side} mount") for side in SIDES]


def mount_poses(gaps_m: np.ndarray | list[float], lift_m: float = 0.0) -> np.ndarray:
    """Contact faces at these distances from the middle, one an environment, [env, 2, 7]."""
    return np.array(
        [[[-x, 0, lift_m, 0, HALF, 0, HALF], [x, 0, lift_m, 0, -HALF, 0, HALF]] for x in gaps_m]
    )


def gel_above_a_table(
    time: TimeStepping, env_count: int = 1, branches: tuple[MaxwellBranch, ...] = ()
) -> Scene:
    """A gel on a hand, face down, and a table below; move it with ``hand_poses``."""
    material = Material(1e5, 0.4, branches=branches)
    gel = soft_block(
        (3, 3, 2), (6e-3, 6e-3, 3e-3), material, mount="hand", friction_coefficient=0.3
    )
    table = KinematicBody(box_mesh((60e-3, 60e-3, 4e-3)), 0.3, name="table")
    return Scene([gel], [KinematicBody(None, name="hand"), table], env_count, time)


def hand_poses(places_m: Any) -> np.ndarray:
    """Of hand and table, for (x, z) of the hand in each environment, [env, 2, 7]."""
    return np.array([[[x, 0, z, 1, 0, 0, 0], [0, 0, -2e-3, 0, 0, 0, 1]] for x, z in places_m])
