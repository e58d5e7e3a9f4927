# SPDX-License-Identifier: Apache-2.0
"""Joints with drives and limits, mounts that jump, environments that must not disturb others."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from taccel_lab.benchmarks.stress.case import (
    Draw,
    StressCase,
    bonded_block,
    friction,
    glued_gel,
    in_time,
    material,
    maybe_in_time,
    settings,
    soft_body,
    stiff_body,
)
from taccel_lab.benchmarks.stress.shapes import STIFF_SHAPES, about, after, pose, reach, stiff_shape
from taccel_lab.bodies.bodies import Surface
from taccel_lab.model import Model
from taccel_lab.scene import (
    AffineBody,
    Element,
    FixedJoint,
    Joint,
    KinematicBody,
    Plane,
    PositionDrive,
    PrismaticJoint,
    RevoluteJoint,
    Scene,
    SoftBody,
    TimeStepping,
    VelocityDrive,
    box_mesh,
)
from taccel_lab.solvers import SolverIPC
from taccel_lab.state import State

LINK = (4e-3, 1.5e-3, 1.5e-3)


def _drive(draw: Draw, name: str, turning: bool) -> PositionDrive | VelocityDrive | None:
    kind = draw.choose(f"{name} drive", ("none", "position", "velocity"))
    if kind == "none":
        return None
    strong = draw.chance(f"{name} is strong", 0.5)
    effort = math.inf if strong else draw.decades(f"{name} effort", 1e-6, 1.0)
    # A torque of 1e-5 N m turns a link of some grams at once; a force of 1 N moves it.
    scale, rate, reach = (1e-5, 200.0, 4.0) if turning else (10.0, 1.0, 5e-3)
    stiffness = scale * draw.decades(f"{name} stiffness", 1e-2, 1e4)
    if kind == "velocity":
        return VelocityDrive(1e-2 * stiffness, draw.between(f"{name} rate", -rate, rate), effort)
    target = draw.between(f"{name} target", -reach, reach)
    return PositionDrive(stiffness, 1e-3 * stiffness, target, effort)


MOVING: dict[str, tuple[type[RevoluteJoint] | type[PrismaticJoint], str, float, float]] = {
    "hinge": (RevoluteJoint, "limits_deg", 2, 150),
    "slider": (PrismaticJoint, "limits_mm", 0.1, 3),
}
"""Joints that move, and their limits: how they are given, the least and the most."""


def mechanism(draw: Draw) -> StressCase:
    """A chain of links on hinges, sliders and welds; drives push it into limits and the floor."""
    config, stepping = settings(draw, (2e-5, 2e-4)), in_time(draw, dt_s=(1e-4, 5e-2))
    count = draw.whole("links", 1, 4)
    bodies: list[AffineBody] = []
    joints: list[Joint] = []
    second: str | None = None
    for number in range(count):
        name = f"link {number}"
        x = (number + 0.5) * 1.2 * LINK[0]
        density, at = draw.decades(f"density {number}", 100.0, 2e4), pose((x, 0, 0))
        bodies.append(stiff_body(box_mesh(LINK), density, 0.3, at, name=name))
        anchor = np.array([number * 1.2 * LINK[0], 0.0, 0.0])
        kind = draw.choose(f"joint {number}", ("hinge", "hinge", "slider", "weld"))
        title = f"joint {number}"
        axis = draw.direction(f"axis {number}")
        if kind == "weld":
            joints.append(FixedJoint(name, second, anchor, name=title))
        else:
            joint, limits, least, most = MOVING[kind]
            half = draw.between(f"limit {number}", least, most)
            limited = draw.chance(f"limited {number}", 0.6)
            given = {
                limits: (-half, half) if limited else None,
                "drive": _drive(draw, title, kind == "hinge"),
            }
            joints.append(joint(name, second, anchor, axis, name=title, **given))
        second = name
    floor = Plane((0.0, 0.0, -draw.between("floor", 1.2e-3, 8e-3)), friction_coefficient=0.5)
    scene = Scene(affine_bodies=bodies, joints=joints, planes=floor, time=stepping)
    flips = draw.chance("targets change sides", 0.3)
    starts: list[np.ndarray] = []

    def prepare(solver: SolverIPC, state: State, step: int) -> None:
        assert state.joints is not None
        if step == 0:
            starts.append(state.joints.targets.numpy().copy())
        if flips and step:
            state.joints.targets.assign((1 if step % 2 == 0 else -1) * starts[-1])

    def expect(model: Model, state: State, step: int) -> str | None:
        return _open_anchor(model, state, joints, [body.name for body in bodies])

    return StressCase(scene, config, 8, prepare=prepare, expect=expect)


def _open_anchor(model: Model, state: State, joints: list[Joint], names: list[str]) -> str | None:
    """Where the anchors of hinges and welds are, on both bodies: the referee of joints."""
    x = state.positions.numpy()[0]
    first_control, lengths = model.affine.first_control, model.affine.lengths.numpy()
    rest = {name: np.array([(k + 0.5) * 1.2 * LINK[0], 0, 0]) for k, name in enumerate(names)}

    def carried(name: str | None, anchor: np.ndarray) -> np.ndarray:
        if name is None:
            return anchor
        index = names.index(name)
        y = x[first_control + 4 * index : first_control + 4 * index + 4]
        local = model.affine.properties[index].to_principal(anchor - rest[name])
        return y[0] + (y[1:].T / lengths[index]) @ local

    for joint in joints:
        if isinstance(joint, PrismaticJoint):
            continue
        anchor = np.asarray(joint.anchor_m)
        off = carried(joint.first, anchor) - carried(joint.second, anchor)
        if np.linalg.norm(off) > 1e-8 * LINK[0]:
            return f"{joint.name} is open by {np.linalg.norm(off):.3g} m"
    return None


def jump(draw: Draw) -> StressCase:
    """A gel on a mount that jumps and turns at random, by up to its own size, onto what rests."""
    config, stepping = settings(draw), maybe_in_time(draw)
    gel = glued_gel(draw, (5e-3, 5e-3, 2e-3), stuff="material", young_pa=(1e3, 1e8))
    gel = replace(gel, mount="hand")
    rest = KinematicBody(
        stiff_shape(draw.choose("shape", STIFF_SHAPES), 4e-3),
        friction(draw, "friction of rest"),
        name="rest",
    )
    turn = draw.rotation("turn of rest")
    _, high = reach(rest.shape, turn)  # type: ignore[arg-type]
    over = about((1, 0, 0), np.pi)
    fixed = pose((0, 0, -high), turn)
    path = [np.stack([pose((0, 0, 2e-4), over), fixed])]
    press = draw.between("press", 0, 0.3) * 2e-3
    for number in range(6):
        side = draw.direction(f"jump {number}") * draw.decades(f"size of jump {number}", 1e-5, 5e-3)
        lean = about(draw.direction(f"axis {number}"), draw.between(f"turn {number}", 0, 1.0))
        # Never deeper than a part of the gel: the target itself has an answer.
        z = -press if number % 2 == 0 else 1e-3 + abs(side[2])
        hand = pose((side[0], side[1], z), over if number % 2 == 0 else after(lean, over))
        if number % 2:
            low, _ = reach(gel.mesh, after(lean, over))
            hand[2] = z - low
        path.append(np.stack([hand, fixed]))
    scene = Scene(gel, [KinematicBody(None, name="hand"), rest], time=stepping)
    return StressCase.along(path, scene, config)


def no_way(draw: Draw) -> StressCase:
    """Targets beyond a gel's glued back, or a body between a pusher and the floor: no answer."""
    config = settings(draw)
    kind = draw.choose("kind", ("through the gel", "against the floor"))
    shape = stiff_shape(draw.choose("shape", STIFF_SHAPES), 1.5e-3)
    turn = draw.rotation("turn")
    low, high = reach(shape, turn)
    x = draw.between("x", -5e-4, 5e-4)
    pusher = KinematicBody(shape, friction(draw), name="pusher")
    if kind == "through the gel":
        mesh = bonded_block(draw, "gel", (5e-3, 5e-3, 2e-3))
        gel = SoftBody(mesh, material(draw, young_pa=(1e3, 1e7)), element=Element.LINEAR)
        scene = Scene(gel, pusher, time=maybe_in_time(draw))
        path = [pose((x, 0, z), turn) for z in (2e-4 - low, -5e-3 - high)]
    else:
        cube = AffineBody(box_mesh((1e-3, 1e-3, 1e-3)), initial_pose=pose((0, 0, 6e-4)))
        time = TimeStepping(quasi_static=False, dt_s=draw.decades("dt", 1e-4, 1e-1))
        scene = Scene((), pusher, affine_bodies=cube, planes=Plane(), time=time)
        # The pusher itself passes the plane: both are prescribed.
        path = [pose((0, 0, z), turn) for z in (1.3e-3 - low, -5e-3 - high)]
    return StressCase.along(path, scene, config, possible=False)


def batch(draw: Draw) -> StressCase:
    """Four environments with one scene: one is pressed, one hardly, one is asked for what cannot
    be, one rests; a stiff body is present in half of them."""
    config, stepping = settings(draw), in_time(draw, dt_s=(1e-3, 2e-2))
    gel = glued_gel(draw, (5e-3, 5e-3, 2e-3), stuff="material", young_pa=(1e4, 1e7))
    turn = draw.rotation("turn")
    shape = stiff_shape(draw.choose("shape", STIFF_SHAPES), 2e-3)
    low, high = reach(shape, turn)
    at = pose((1.8e-3, 1.8e-3, 5.1e-4))
    cube = stiff_body(box_mesh((1e-3, 1e-3, 1e-3)), 1000.0, 0.5, at, name="cube")
    cube = replace(cube, surface=Surface(environments=(0, 2)))
    depth = draw.between("depth", 0.05, 0.3) * 2e-3
    top = 1.1 * config.dhat_m - low
    ends = [-depth - low, top - 1e-4, -5e-3 - high, top]

    def poses(step: int) -> np.ndarray:
        part = (step + 1) / 4
        return np.stack([pose((-5e-4, 0, top + part * (end - top)), turn)[None] for end in ends])

    scene = Scene(gel, KinematicBody(shape, 0.5), 4, stepping, affine_bodies=cube)
    return StressCase(scene, config, 4, poses(-1), poses, possible=False)


def resting(draw: Draw) -> StressCase:
    """A gel as soft as pudding, with slivers, sags under its own weight for some large steps."""
    config = settings(draw)
    stepping = in_time(draw, dt_s=(1e-2, 1e-1))
    mesh = bonded_block(draw, "gel", (2e-2, 2e-2, 1e-2))
    gel = soft_body(draw, mesh, young_pa=(1e3, 1e4), density=(1e3, 1e4))
    plane = Plane((0.0, 0.0, -1.2e-2))
    return StressCase(Scene(gel, planes=plane, time=stepping), config, 6, closed=True)
