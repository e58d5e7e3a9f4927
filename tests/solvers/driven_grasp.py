# SPDX-License-Identifier: Apache-2.0
"""A gripper whose fingers slide on a base that goes where it is told, and are pushed by drives.

Each carries a gel. A box stands between them, held by the scene or free.
"""

from __future__ import annotations

import numpy as np

from taccel_lab.geometry.block import block_mesh
from taccel_lab.scene import (
    AffineBody,
    Element,
    KinematicBody,
    Material,
    Plane,
    PositionDrive,
    PrismaticJoint,
    Scene,
    SoftBody,
    TimeStepping,
    box_mesh,
)
from tests.support.blocks import cube, everywhere, pose

SIDES = ("left", "right")
HALF = float(np.sqrt(0.5))
FORCE_N = 1.5
"""Largest force of each drive."""
HALF_BOX_M = 4e-3
GAP_M = 5e-5
"""Between gels and box at the start."""
PAD = block_mesh((3, 3, 2), (6e-3, 6e-3, 3e-3))
FINGER_M = 8e-3
START_M = HALF_BOX_M + GAP_M
BACK_M = 3e-3 + FINGER_M / 2
"""From the contact face to the centre of the finger."""


def toward(side: str) -> float:
    """1 for the left one, which pushes along x."""
    return 1.0 if side == "left" else -1.0


def face_pose(side: str, face_m: float, z_m: float = 0.0) -> np.ndarray:
    """world_from_gel, the contact face at a distance from the middle, looking at it."""
    return np.array([-toward(side) * face_m, 0, z_m, 0, toward(side) * HALF, 0, HALF])


def gels(elements: tuple[Element, Element], friction: float, driven: bool) -> list[SoftBody]:
    """On the fingers, whose frames are that of the world, or each on a frame of its own."""
    return [
        SoftBody(
            PAD,
            Material(1e5, 0.45),
            name=side,
            mount=f"{side} finger" if driven else f"{side} frame",
            mount_pose=face_pose(side, -BACK_M) if driven else None,
            element=element,
            friction_coefficient=friction,
        )
        for side, element in zip(SIDES, elements, strict=True)
    ]


def time_of(gravity: bool) -> TimeStepping:
    down = (0.0, 0.0, -9.81 if gravity else 0.0)
    return TimeStepping(quasi_static=False, dt_s=5e-3, gravity_m_s2=down)


def held_box() -> KinematicBody:
    side = 2 * HALF_BOX_M
    return KinematicBody(box_mesh((side, 2 * side, 2 * side)), name="box")


def driven_grasp(
    env_count: int = 2,
    elements: tuple[Element, Element] = (Element.LINEAR, Element.QUADRATIC),
) -> Scene:
    """The box is free, under gravity, on a table."""
    box = cube(2 * HALF_BOX_M, name="box", friction_coefficient=1.0)
    return _driven([box], [], env_count, elements, 1.0, time_of(True))


def driven_squeeze(elements: tuple[Element, Element], young_pa: float) -> Scene:
    """The box is held; neither friction nor gravity. ``young_pa``: of the fingers."""
    return _driven([], [held_box()], 1, elements, 0.0, time_of(False), young_pa)


def _driven(
    boxes: list[AffineBody],
    held: list[KinematicBody],
    env_count: int,
    elements: tuple[Element, Element],
    friction: float,
    time: TimeStepping,
    young_pa: float = 1e9,
) -> Scene:
    fingers, slides = [], []
    for side in SIDES:
        place, name = (-toward(side) * (START_M + BACK_M), 0, 0), f"{side} finger"
        shape = box_mesh((FINGER_M, 7e-3, 7e-3))
        fingers.append(
            AffineBody(shape, young_modulus_pa=young_pa, name=name, initial_pose=pose(*place))
        )
        drive = PositionDrive(1e4, damping=100.0, target=HALF_BOX_M, max_effort=FORCE_N)
        axis = (toward(side), 0, 0)
        slides.append(PrismaticJoint(name, "base", place, axis, name=side, drive=drive))
    table = Plane((0, 0, -HALF_BOX_M - GAP_M), friction_coefficient=0.5, name="table")
    return Scene(
        gels(elements, friction, driven=True),
        [KinematicBody(None, name="base"), *held],
        env_count,
        time,
        affine_bodies=[*fingers, *boxes],
        planes=[] if held else [table],
        joints=slides,
    )


def prescribed_squeeze(elements: tuple[Element, Element]) -> Scene:
    """``driven_squeeze`` with gels on frames in place of fingers."""
    frames = [KinematicBody(None, name=f"{side} frame") for side in SIDES]
    return Scene(gels(elements, 0.0, driven=False), [*frames, held_box()], 1, time_of(False))


def base_poses(env_count: int, z_m: float = 0.0) -> np.ndarray:
    return everywhere(env_count, pose(0, 0, z_m))
