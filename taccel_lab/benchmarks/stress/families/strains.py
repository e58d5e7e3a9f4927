# SPDX-License-Identifier: Apache-2.0
"""Soft bodies twisted, squeezed, swung and pulled as far as they go."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from taccel_lab.benchmarks.stress.case import (
    FREE,
    Draw,
    StressCase,
    free_block,
    friction,
    in_time,
    material,
    maybe_in_time,
    settings,
    soft_body,
)
from taccel_lab.benchmarks.stress.shapes import about, after, pose, reach, soft_box
from taccel_lab.scene import Element, KinematicBody, Plane, Scene, SoftBody, box_mesh
from taccel_lab.solvers import SolverIPC
from taccel_lab.state import State

TWIST_DEG = 720.0


def twist(draw: Draw) -> StressCase:
    """A strip held at one end, gripped between two jaws at the other, is twisted by 720 degrees."""
    config = settings(draw, (1e-5, 4e-5))
    long, wide, high = 8e-3, draw.between("width", 1.5e-3, 4e-3), 0.4e-3
    cells = (draw.whole("cells", 8, 12), draw.whole("cells across", 2, 4), 1)
    mesh = soft_box(cells, (long, wide, high), draw.between("jitter", 0, 0.15), draw.seed("seed"))
    held = np.flatnonzero(mesh.nodes_m[:, 0] < -long / 2 + 1e-9)
    jaw = box_mesh((1.2e-3, 1.2 * wide, 0.5e-3))
    jaws = [
        KinematicBody(jaw, draw.between(f"friction {k}", 1, 5), name=f"jaw {k}") for k in (0, 1)
    ]
    strip = SoftBody(
        mesh, material(draw, young_pa=(1e4, 1e7)), held, self_contact=True, element=Element.LINEAR
    )
    turns = draw.choose("deg a step", (15.0, 30.0, 45.0, 60.0))

    def gripped(gap: float, deg: float) -> np.ndarray:
        angle = np.deg2rad(deg)
        normal = np.array([0, -np.sin(angle), np.cos(angle)]) * (0.25e-3 + high / 2 + gap)
        middle = np.array([long / 2 - 0.6e-3, 0, 0])
        turn = about((1, 0, 0), angle)
        return np.stack([pose(middle + side * normal, turn) for side in (1, -1)])

    grip = -draw.between("grip", 0.1, 0.25) * high
    path = [gripped(1.5 * config.dhat_m, 0), gripped(grip / 2, 0), gripped(grip, 0)]
    path += [gripped(grip, deg) for deg in np.arange(turns, TWIST_DEG + 1e-6, turns)]
    scene = Scene(strip, jaws, time=maybe_in_time(draw))
    return StressCase.along(path, scene, config)


def swing(draw: Draw) -> StressCase:
    """A bar on a mount that turns by 720 degrees in a few steps, so that its free end whips, while
    the mount also jumps."""
    config = settings(draw)
    mesh = soft_box((6, 2, 2), (8e-3, 1.5e-3, 1.5e-3), 0.1, draw.seed("seed"))
    held = np.flatnonzero(mesh.nodes_m[:, 0] < -4e-3 + 1e-9)
    bar = soft_body(draw, mesh, held, (1e4, 1e9))
    bar = replace(bar, mount="mount", self_contact=draw.chance("self-contact", 0.5))
    stepping = maybe_in_time(draw)
    axis = draw.direction("axis")
    jump = draw.direction("jump") * draw.decades("jump size", 1e-5, 1e-2)
    steps = draw.choose("steps", (5, 9, 16))
    path = [
        pose(np.sin(5.0 * part) * jump, about(axis, np.deg2rad(TWIST_DEG) * part))
        for part in np.linspace(0, 1, steps + 1)
    ]
    scene = Scene(bar, KinematicBody(None, name="mount"), time=stepping)
    return StressCase.along(path, scene, config)


def squeeze(draw: Draw) -> StressCase:
    """A free block with self-contact is flattened between a plate and the floor, and let go."""
    config = settings(draw, (1e-5, 5e-5))
    side = 2e-3
    mesh = free_block(draw, "block", (side, side, side))
    stepping = in_time(draw)
    block, at = (
        soft_body(draw, mesh, FREE, (1e3, 1e8)),
        pose((0, 0, side / 2 + 1.5 * config.dhat_m)),
    )
    block = replace(block, self_contact=True, friction_coefficient=friction(draw), initial_pose=at)
    lowest, steps = draw.between("lowest part", 0.25, 0.8), draw.whole("steps", 2, 8)
    plate = KinematicBody(box_mesh((8e-3, 8e-3, 0.5e-3)), friction(draw, "friction of plate"))
    top = side + 3 * config.dhat_m + 0.25e-3
    heights = np.linspace(top, lowest * side + 0.25e-3, steps + 1).tolist()
    heights += [heights[-1], top, top]
    path = [pose((0, 0, z)) for z in heights]
    scene = Scene(block, plate, planes=Plane(friction_coefficient=0.5), time=stepping)
    return StressCase.along(path, scene, config)


def fold(draw: Draw) -> StressCase:
    """A thin strip, glued by half, is folded over itself by a bar that sweeps its other end."""
    config = settings(draw, (1e-5, 5e-5))
    long, high = 8e-3, 0.4e-3
    mesh = soft_box((14, 2, 1), (long, 1.5e-3, high), 0.1, draw.seed("seed"))
    held = np.flatnonzero(mesh.nodes_m[:, 0] < -2e-3)
    strip = soft_body(draw, mesh, held, (1e3, 1e7))
    strip = replace(strip, self_contact=True, friction_coefficient=friction(draw))
    bar = KinematicBody(box_mesh((0.6e-3, 3e-3, 0.6e-3)), friction(draw, "friction of bar"))
    # About the end of the glued part, from below to nearly flat.
    steps, last = draw.whole("steps", 6, 14), draw.between("last angle", 1.5, 2.7)
    arm, hinge = draw.between("arm", 3e-3, 5e-3), np.array([-1.8e-3, 0, 0])
    down = -(high / 2 + 0.3e-3 + 1.5 * config.dhat_m)
    path = []
    for angle in np.linspace(0, last, steps + 1):
        turn = about((0, 1, 0), -angle)
        c, s = np.cos(angle), np.sin(angle)
        place = hinge + np.array([c * arm - s * down, 0, s * arm + c * down])
        path.append(pose(place, turn))
    scene = Scene(strip, bar, time=maybe_in_time(draw))
    return StressCase.along(path, scene, config)


def pull(draw: Draw) -> StressCase:
    """Forces of up to many times what a bar bears pull, shear and crush its free end."""
    config = settings(draw)
    mesh = soft_box((5, 2, 2), (6e-3, 1.5e-3, 1.5e-3), 0.15, draw.seed("seed"))
    held = np.flatnonzero(mesh.nodes_m[:, 0] < -3e-3 + 1e-9)
    body = soft_body(draw, mesh, held)
    stepping = in_time(draw)
    strain = draw.decades("force over stiffness", 1e-3, 3.0)
    total = strain * body.material.young_modulus_pa * 1.5e-3**2 * draw.direction("direction")

    def prepare(solver: SolverIPC, state: State, step: int) -> None:
        x = solver.model.rest_positions.numpy()[0]
        end = np.flatnonzero(x[:, 0] > 3e-3 - 1e-9)
        forces = np.zeros((1, len(x), 3))
        forces[0, end] = (1 if step % 2 == 0 else -1) * total / len(end)
        state.load(solver.model, forces)

    scene = Scene(body, planes=Plane(point_m=(0, 0, -2e-3)), time=stepping)
    return StressCase(scene, config, 5, prepare=prepare)


def roll_over(draw: Draw) -> StressCase:
    """A soft block is rubbed and rolled between two plates that slide against each other."""
    config = settings(draw, (1e-5, 1e-4))
    side = 3e-3
    mesh = free_block(draw, "block", (side, side, side))
    block, at = (
        soft_body(draw, mesh, FREE, (1e3, 1e8)),
        pose((0, 0, side / 2 + 0.5 * config.dhat_m)),
    )
    block = replace(block, friction_coefficient=friction(draw), initial_pose=at)
    tilt = about(draw.direction("tilt axis"), draw.between("tilt", 0, 0.1))
    shape = box_mesh((9e-3, 9e-3, 0.5e-3))
    plate = KinematicBody(shape, draw.between("friction of plate", 0, 2), name="plate")
    low, _ = reach(shape, tilt)
    top, pressed = side + 2 * config.dhat_m - low, draw.between("pressed", 0.02, 0.3) * side
    slide, steps = draw.between("slide", 0, 4e-3), draw.whole("steps", 2, 6)
    spin = draw.between("spin", 0, 1.5)
    path = [pose((0, 0, top), tilt), pose((0, 0, top - pressed), tilt)]
    path += [
        pose((part * slide, 0, top - pressed), after(about((0, 0, 1), part * spin), tilt))
        for part in np.linspace(0, 1, steps + 1)[1:]
    ]
    floor = Plane(friction_coefficient=draw.between("friction of floor", 0, 2))
    scene = Scene(block, plate, planes=floor, time=in_time(draw))
    return StressCase.along(path, scene, config)
