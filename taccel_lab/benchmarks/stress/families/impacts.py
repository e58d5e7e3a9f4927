# SPDX-License-Identifier: Apache-2.0
"""Bodies that fly at one another and at what rests, also from starts that are nearly contact, and
edges that are nearly parallel.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from taccel_lab.benchmarks.stress.case import (
    ELEMENTS,
    FREE,
    WORLD,
    Draw,
    StressCase,
    bonded_block,
    free_body,
    friction,
    glued_gel,
    in_time,
    material,
    settings,
    soft_body,
    stiff_body,
    thrown_body,
)
from taccel_lab.benchmarks.stress.shapes import (
    STIFF_SHAPES,
    about,
    after,
    pose,
    reach,
    soft_box,
    stiff_shape,
    wedge,
)
from taccel_lab.model import Model
from taccel_lab.scene import (
    AffineBody,
    Element,
    KinematicBody,
    Plane,
    Scene,
    SoftBody,
    TriangleMesh,
)
from taccel_lab.state import State

FASTEST = 10.0
"""Speed of an impact [m/s]."""


def _fall(draw: Draw) -> tuple[float, float, float]:
    """A velocity that points down."""
    speed = draw.decades("speed", 0.1, FASTEST)
    x, y = draw.between("velocity x", -0.5, 0.5), draw.between("velocity y", -0.5, 0.5)
    down = np.array([x, y, -1.0])
    vx, vy, vz = speed * down / np.linalg.norm(down)
    return float(vx), float(vy), float(vz)


def _spin(draw: Draw) -> tuple[float, float, float]:
    x, y, z = draw.direction("axis of spin") * draw.decades("spin", 0.1, 300.0)
    return float(x), float(y), float(z)


def _steps(draw: Draw, gap: float, speed: float, dt: float) -> int:
    """Enough for it to arrive, and some more."""
    return min(int(np.ceil(gap / (speed * dt))) + 5, 12)


def soft_impact(draw: Draw) -> StressCase:
    """A soft body is thrown at the floor, at a ridge or at a point, with up to 10 m/s."""
    config = settings(draw)
    stepping = in_time(draw)
    size, turn, velocity = 4e-3, draw.rotation("turn"), _fall(draw)
    mesh = free_body(draw, "body", size)
    gap = draw.decades("gap", 1e-5, 2e-3)
    low, _ = reach(mesh, turn)
    body = soft_body(draw, mesh, FREE)
    mu, at = friction(draw), pose((0, 0, gap - low), turn)
    body = replace(body, name="body", friction_coefficient=mu, initial_pose=at)
    folds = draw.chance("self-contact", 0.3)
    body = replace(body, initial_velocity_m_s=velocity, self_contact=folds)
    onto = draw.choose("onto", ("floor", "ridge", "point"))
    steps = _steps(draw, gap, -velocity[2], stepping.dt_s)
    if onto == "floor":
        scene = Scene(body, planes=Plane(), time=stepping)
        return StressCase(scene, config, steps, closed=True)
    shape = wedge(2e-3, 4e-3, 8e-3) if onto == "ridge" else stiff_shape("needle", 4e-3)
    upside = after(about((1, 0, 0), np.pi), about((0, 0, 1), draw.between("heading", 0, np.pi)))
    _, high = reach(shape, upside)
    rest = KinematicBody(shape, 0.5, name="rest")
    start = pose((0, 0, -high), upside)[None, None]
    return StressCase(Scene(body, rest, time=stepping), config, steps, start, closed=True)


def _stiff(draw: Draw, size: float, low_density: float = 100.0) -> AffineBody:
    shape = stiff_shape(draw.choose("shape", STIFF_SHAPES), size, draw.seed("shape seed"))
    density = draw.decades("density", low_density, 2e4)
    young = draw.decades("young of body", 1e6, 1e11)
    return stiff_body(shape, density, friction(draw), None, _fall(draw), _spin(draw), young)


def _placed(body: AffineBody, gap: float, turn: np.ndarray) -> AffineBody:
    low, _ = reach(body.shape, turn)
    return replace(body, initial_pose=pose((0, 0, gap - low), turn))


def stiff_on_plane(draw: Draw) -> StressCase:
    """A stiff body of any shape is thrown at the floor and spins."""
    config, stepping = settings(draw), in_time(draw)
    gap = draw.decades("gap", 1e-6, 2e-3)
    body = _placed(_stiff(draw, 4e-3), gap, draw.rotation("turn"))
    steps = _steps(draw, gap, -body.initial_velocity_m_s[2], stepping.dt_s)
    scene = Scene(affine_bodies=body, planes=Plane(friction_coefficient=0.5), time=stepping)
    return StressCase(scene, config, steps, closed=True)


def stiff_on_gel(draw: Draw) -> StressCase:
    """A stiff body is thrown into a gel: tips and edges first, up to 10 m/s and ten times heavier
    or a hundred times lighter than what it meets."""
    config, stepping = settings(draw), in_time(draw)
    gel = glued_gel(draw, (8e-3, 8e-3, 3e-3), rubs="friction of gel")
    gap = draw.decades("gap", 1e-6, 2e-3)
    body = _placed(_stiff(draw, 3e-3, 10.0), gap, draw.rotation("turn"))
    steps = _steps(draw, gap, -body.initial_velocity_m_s[2], stepping.dt_s)
    scene = Scene(gel, affine_bodies=body, time=stepping)
    return StressCase(scene, config, steps, closed=True)


def soft_on_soft(draw: Draw) -> StressCase:
    """Two free bodies collide in the air, a million times unlike in stiffness and a hundred times
    in density."""
    config, stepping = settings(draw), in_time(draw, gravity=0.0)
    speed, gap = draw.decades("speed", 0.1, FASTEST), draw.decades("gap", 1e-6, 1e-3)
    bodies, size = [], 4e-3
    shift = draw.between("offset", -1.5e-3, 1.5e-3)
    for name, side in (("first", 1), ("second", -1)):
        mesh, turn = free_body(draw, name, size), draw.rotation(f"turn of {name}")
        low, high = reach(mesh, turn)
        z = gap / 2 - low if side > 0 else -gap / 2 - high
        at = pose((side * shift, 0, z), turn)
        bodies.append(thrown_body(draw, name, mesh, at, (0.0, 0.0, -side * speed / 2)))
    steps = _steps(draw, gap, speed, stepping.dt_s)
    scene = Scene(bodies, time=stepping)
    return StressCase(scene, config, steps, closed=True)


def bullet_at_sheet(draw: Draw) -> StressCase:
    """A small body flies many times its own size a step at a sheet without volume, or at a thin
    gel: it must not be beyond."""
    config = settings(draw)
    stepping = in_time(draw, dt_s=(1e-3, 1e-1), gravity=0.0)
    sheet_mesh = stiff_shape("box", 8e-3)
    corners, faces = sheet_mesh.vertices_m[:4] + [0, 0, 4e-3], sheet_mesh.faces[:2]
    body = _placed(_stiff(draw, 1e-3), draw.decades("gap", 1e-5, 5e-3), draw.rotation("turn"))
    vx, vy, vz = body.initial_velocity_m_s
    # Straight at it, so that it cannot miss.
    body = replace(body, initial_velocity_m_s=(0.02 * vx, 0.02 * vy, vz))
    sheet = KinematicBody(TriangleMesh(corners, faces), 0.3, name="sheet")
    scene = Scene((), sheet, time=stepping, affine_bodies=body)

    def expect(model: Model, state: State, step: int) -> str | None:
        node = model.affine.first_control
        z = float(state.positions.numpy()[0, node, 2])
        return None if z > 0 else f"it is {-z:.3g} m beyond the sheet after step {step}"

    start = WORLD[None, None]
    return StressCase(scene, config, 4, start, expect=expect, closed=True)


SMALLEST_GAP = 1e-9


def thin_gap(draw: Draw) -> StressCase:
    """A body starts a nanometre and more over a gel, a plate or the floor, face to face."""
    config, stepping = settings(draw), in_time(draw)
    gap = draw.decades("gap", SMALLEST_GAP, 1e-6)
    side = 3e-3
    onto = draw.choose("onto", ("floor", "plate", "gel"))
    place = (draw.between("x", -1e-3, 1e-3), draw.between("y", -1e-3, 1e-3), gap + side / 2)
    heading = about((0, 0, 1), draw.between("heading", 0, np.pi))
    thrown: dict[str, Any] = {
        "name": "body",
        "friction_coefficient": friction(draw),
        "initial_pose": pose(place, heading),
        "initial_velocity_m_s": (0.0, 0.0, -draw.decades("speed", 1e-4, 1.0)),
    }
    soft, stiff, kinematic, planes = [], [], [], []
    if draw.chance("soft", 0.5):
        mesh = soft_box((2, 2, 2), (side, side, side), 0.1, draw.seed("seed"))
        stuff, element = material(draw), draw.choose("element", ELEMENTS)
        soft.append(SoftBody(mesh, stuff, FREE, element=element, **thrown))
    else:
        density = draw.decades("density", 100.0, 2e4)
        stiff.append(AffineBody(stiff_shape("box", side), density, **thrown))
    start = None
    if onto == "floor":
        planes.append(Plane(friction_coefficient=0.5))
    elif onto == "plate":
        kinematic.append(KinematicBody(stiff_shape("box", 2 * side), 0.5, name="plate"))
        start = pose((0, 0, -side))[None, None]
    else:
        mesh, stuff = bonded_block(draw, "gel", (8e-3, 8e-3, 3e-3)), material(draw, "gel")
        gel = SoftBody(mesh, stuff, name="gel", friction_coefficient=0.5, element=Element.LINEAR)
        soft.append(gel)
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
    density, at = draw.decades("density", 100.0, 2e4), pose((shift, 0, gap + 2.5e-7), heading)
    body = stiff_body(upper, density, friction(draw), at, (0.0, 0.0, down), name="upper")
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
