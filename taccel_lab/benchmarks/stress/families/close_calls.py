# SPDX-License-Identifier: Apache-2.0
"""Starts that are nearly contact, and edges that are nearly parallel."""

from __future__ import annotations

import numpy as np

from taccel_lab.benchmarks.stress.case import Draw, StressCase
from taccel_lab.benchmarks.stress.families.common import (
    ELEMENTS,
    FREE,
    bonded_block,
    friction,
    in_time,
    material,
    settings,
    thrown_body,
)
from taccel_lab.benchmarks.stress.shapes import about, after, pose, soft_box, stiff_shape, wedge
from taccel_lab.scene import AffineBody, Element, KinematicBody, Plane, Scene, SoftBody

SMALLEST_GAP = 1e-9


def thin_gap(draw: Draw) -> StressCase:
    """A body starts a nanometre and more over a gel, a plate or the floor, face to face."""
    config, stepping = settings(draw), in_time(draw)
    gap = draw.decades("gap", SMALLEST_GAP, 1e-6)
    side = 3e-3
    onto = draw.choose("onto", ("floor", "plate", "gel"))
    place = (draw.between("x", -1e-3, 1e-3), draw.between("y", -1e-3, 1e-3), gap + side / 2)
    heading = about((0, 0, 1), draw.between("heading", 0, np.pi))
    mu = friction(draw)
    down = -draw.decades("speed", 1e-4, 1.0)
    soft, stiff, kinematic, planes = [], [], [], []
    if draw.chance("soft", 0.5):
        soft.append(
            SoftBody(
                soft_box((2, 2, 2), (side, side, side), 0.1, draw.seed("seed")),
                material(draw),
                FREE,
                name="body",
                element=draw.choose("element", ELEMENTS),
                friction_coefficient=mu,
                initial_pose=pose(place, heading),
                initial_velocity_m_s=(0.0, 0.0, down),
            )
        )
    else:
        stiff.append(
            AffineBody(
                stiff_shape("box", side),
                draw.decades("density", 100.0, 2e4),
                name="body",
                friction_coefficient=mu,
                initial_pose=pose(place, heading),
                initial_velocity_m_s=(0.0, 0.0, down),
            )
        )
    start = None
    if onto == "floor":
        planes.append(Plane(friction_coefficient=0.5))
    elif onto == "plate":
        kinematic.append(KinematicBody(stiff_shape("box", 2 * side), 0.5, name="plate"))
        start = pose((0, 0, -side))[None, None]
    else:
        mesh = bonded_block(draw, "gel", (8e-3, 8e-3, 3e-3))
        soft.append(
            SoftBody(
                mesh,
                material(draw, "gel"),
                name="gel",
                friction_coefficient=0.5,
                element=Element.LINEAR,
            )
        )
    scene = Scene(soft, kinematic, affine_bodies=stiff, planes=planes, time=stepping)
    return StressCase(scene, config, 4, start, closed=True)


def parallel_edges(draw: Draw) -> StressCase:
    """A ridge falls on a ridge, down to a nanoradian from parallel, exactly above it or beside."""
    config, stepping = settings(draw), in_time(draw, dt_s=(1e-4, 1e-2))
    angle = 0.0 if draw.chance("exactly parallel", 0.15) else draw.decades("angle", 1e-9, 1e-1)
    gap = draw.decades("gap", SMALLEST_GAP, 1e-4)
    shift = 0.0 if draw.chance("exactly above", 0.3) else draw.decades("shift", 1e-9, 1e-4)
    height, half = 1e-3, draw.decades("half width", 1e-4, 2e-3)
    lower = wedge(half, height, draw.between("length", 2e-3, 8e-3))
    upper = wedge(half, height, 4e-3)
    down = -draw.decades("speed", 1e-3, 3.0)
    heading = after(
        about((1, 0, 0), draw.choose("pitch", (0.0, 1e-7, 1e-4))), about((0, 0, 1), angle)
    )
    body = AffineBody(
        upper,
        draw.decades("density", 100.0, 2e4),
        name="upper",
        friction_coefficient=friction(draw),
        initial_pose=pose((shift, 0, gap + 2.5e-7), heading),
        initial_velocity_m_s=(0.0, 0.0, down),
    )
    over = about((1, 0, 0), np.pi)
    rest = KinematicBody(lower, 0.5, name="lower")
    start = pose((0, 0, 0), over)[None, None]
    scene = Scene((), rest, affine_bodies=body, time=stepping)
    return StressCase(scene, config, 6, start, closed=True)


def soft_edges(draw: Draw) -> StressCase:
    """A soft roof falls on another one, their ridges nearly parallel."""
    config, stepping = settings(draw), in_time(draw, dt_s=(1e-4, 2e-2))
    angle = 0.0 if draw.chance("exactly parallel", 0.15) else draw.decades("angle", 1e-9, 1.0)
    gap = draw.decades("gap", 1e-8, 1e-4)
    cells = (2, 2, 2)
    mesh = soft_box(cells, (3e-3, 3e-3, 3e-3))
    down = draw.decades("speed", 1e-3, 3.0)
    edge_up = about((0, 1, 0), np.pi / 4)
    half = 1.5e-3 * 2**0.5
    bodies = []
    for name, side in (("upper", 1), ("lower", -1)):
        heading = after(about((0, 0, 1), angle if side > 0 else 0.0), edge_up)
        at = pose((0, 0, side * (half + gap / 2)), heading)
        bodies.append(thrown_body(draw, name, mesh, at, (0.0, 0.0, -side * down / 2)))
    scene = Scene(bodies, time=stepping)
    return StressCase(scene, config, 5, closed=True)
