# SPDX-License-Identifier: Apache-2.0
"""Bodies on prescribed paths meet gels that are glued below."""

from __future__ import annotations

import numpy as np

from taccel_lab.benchmarks.stress.case import (
    ELEMENTS,
    Draw,
    StressCase,
    bonded_block,
    friction,
    material,
    maybe_in_time,
    settings,
)
from taccel_lab.benchmarks.stress.shapes import (
    STIFF_SHAPES,
    about,
    after,
    cone,
    pose,
    reach,
    stiff_shape,
    wedge,
)
from taccel_lab.scene import Ball, KinematicBody, Scene, SoftBody, TriangleMesh

SIZE = (6e-3, 6e-3, 2e-3)
TILT = 0.2


def _gel(draw: Draw, name: str = "gel", **options: object) -> SoftBody:
    return SoftBody(
        bonded_block(draw, name, SIZE),
        material(draw, name, young_pa=(1e3, 1e8)),
        name=name,
        element=draw.choose(f"{name} element", ELEMENTS),
        friction_coefficient=friction(draw, f"friction of {name}"),
        **options,  # type: ignore[arg-type]
    )


def press(draw: Draw) -> StressCase:
    """A stiff shape of any kind goes into a gel, deep and in few steps."""
    name = draw.choose("shape", ("ball", *STIFF_SHAPES))
    size = draw.between("size", 1e-3, 4e-3)
    turn = draw.rotation("turn")
    if name == "ball":
        shape, low = Ball(size / 2), -size / 2
    else:
        shape = stiff_shape(name, size, draw.seed("shape seed"))
        low, _ = reach(shape, turn)
    config, depth = settings(draw), draw.between("depth", 0.02, 0.5) * SIZE[2]
    steps = draw.whole("steps", 1, 5)
    x, y = draw.between("x", -1e-3, 1e-3), draw.between("y", -1e-3, 1e-3)
    time = maybe_in_time(draw)
    top = 1.1 * config.dhat_m - low
    heights = np.linspace(top, -depth - low, steps + 1)
    path = [pose((x, y, z), turn) for z in heights]
    scene = Scene(_gel(draw), KinematicBody(shape, friction(draw)), time=time)
    return StressCase.along(path, scene, config)


def _sharp(draw: Draw) -> TriangleMesh:
    """A tip or a ridge at the origin that points down, as sharp as a pin or a knife."""
    kind = draw.choose("sharp shape", ("cone", "needle", "wedge", "knife"))
    slender = draw.decades("half width over height", 0.005, 0.05)
    height = 3e-3
    if kind in ("cone", "needle"):
        half = 0.4 if kind == "cone" else slender
        return cone(half * height, height, draw.whole("segments", 3, 12))
    half = 0.4 if kind == "wedge" else slender
    return wedge(half * height, height, draw.between("length", 1e-3, 9e-3))


def stab(draw: Draw) -> StressCase:
    """A tip or a blade is pressed into a gel, dragged and turned in it, and drawn out."""
    shape, config, mu = _sharp(draw), settings(draw), friction(draw)
    depth = draw.between("depth", 0.02, 0.3) * SIZE[2]
    drag = draw.between("drag", 0.0, 0.5e-3)
    spin = draw.between("spin", 0.0, 0.5)
    lean = about(draw.direction("axis of lean"), draw.between("lean", 0, TILT))
    direction = draw.between("direction of drag", 0, 2 * np.pi)
    low, _ = reach(shape, lean)
    start = np.array([draw.between("x", -5e-4, 5e-4), draw.between("y", -5e-4, 5e-4), 0])
    along = drag * np.array([np.cos(direction), np.sin(direction), 0])
    heights = [1.1 * config.dhat_m, -0.5 * depth, -depth, -depth, -depth, 0.0, 5 * config.dhat_m]
    parts = [0.0, 0.0, 0.0, 0.5, 1.0, 1.0, 1.0]
    path = [
        pose(start + part * along + [0, 0, z - low], after(about((0, 0, 1), part * spin), lean))
        for z, part in zip(heights, parts, strict=True)
    ]
    scene = Scene(_gel(draw), KinematicBody(shape, mu), time=maybe_in_time(draw))
    return StressCase.along(path, scene, config)


def gel_on_gel(draw: Draw) -> StressCase:
    """A gel on a mount is pressed on another one that is up to a million times stiffer, dragged
    and turned; meshes and elements do not match."""
    lower = _gel(draw, "lower")
    upper = _gel(draw, "upper", mount="hand")
    config = settings(draw)
    depth = draw.between("depth", 0.02, 0.3) * SIZE[2]
    drag, spin = draw.between("drag", 0, 1e-3), draw.between("spin", 0, 0.6)
    x = draw.between("x", -2e-3, 2e-3)
    over = about((1, 0, 0), np.pi)
    lean = about(draw.direction("axis of lean"), draw.between("lean", 0, 0.05))
    turn = after(lean, over)
    low, _ = reach(upper.mesh, turn)
    heights = [1.1 * config.dhat_m, -0.5 * depth, -depth, -depth, -depth, 5 * config.dhat_m]
    parts = [0.0, 0.0, 0.0, 0.5, 1.0, 1.0]
    path = [
        pose((x + part * drag, 0, z - low), after(about((0, 0, 1), part * spin), turn))
        for z, part in zip(heights, parts, strict=True)
    ]
    hand = KinematicBody(None, name="hand")
    scene = Scene([lower, upper], hand, time=maybe_in_time(draw))
    return StressCase.along(path, scene, config)
