# SPDX-License-Identifier: Apache-2.0
"""Stiff bodies between gels on mounts: thrown, caught, shaken, let go; and piles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from taccel_lab.benchmarks.stress.case import (
    ELEMENTS,
    Draw,
    StressCase,
    bonded_block,
    friction,
    glued_gel,
    in_time,
    material,
    settings,
    stiff_body,
)
from taccel_lab.benchmarks.stress.shapes import STIFF_SHAPES, about, after, pose, reach, stiff_shape
from taccel_lab.model.embedding import rotate
from taccel_lab.scene import Element, KinematicBody, Plane, Scene, SoftBody

GEL = (6e-3, 6e-3, 2e-3)


def _jaws(open_m: float, lift: float = 0.0, turn: float = 0.0) -> np.ndarray:
    """Poses of two mounts whose gels' faces are ``open_m`` from x = 0, [2, 7]."""
    left, right = about((0, 1, 0), np.pi / 2), about((0, 1, 0), -np.pi / 2)
    spin = about((1, 0, 0), turn)
    return np.stack(
        [pose((-open_m, 0, lift), after(spin, left)), pose((open_m, 0, lift), after(spin, right))]
    )


def _fingers(draw: Draw, young_pa: tuple[float, float]) -> list[SoftBody]:
    element, mu = draw.choose("element", ELEMENTS), friction(draw)
    stuff = material(draw, "gel", young_pa)
    gels = [
        SoftBody(bonded_block(draw, name, GEL), stuff, name=name, mount=f"{name} jaw")
        for name in ("left", "right")
    ]
    return [replace(gel, element=element, friction_coefficient=mu) for gel in gels]


def throw_and_catch(draw: Draw) -> StressCase:
    """A stiff body is thrown between two gels, which close on it, lift and shake it, and let go."""
    config, stepping = settings(draw), in_time(draw, dt_s=(1e-3, 5e-2))
    shape = stiff_shape(draw.choose("shape", STIFF_SHAPES), draw.between("size", 2e-3, 4e-3))
    turn = draw.rotation("turn")
    speed = draw.decades("speed", 0.01, 3.0)
    away = (draw.direction("heading") * speed).tolist()
    density, mu = draw.decades("density", 100.0, 2e4), friction(draw, "friction of body")
    velocity, spin = (away[0], away[1], away[2]), (0.0, draw.between("spin", -50, 50), 0.0)
    body = stiff_body(shape, density, mu, pose((0, 0, 0), turn), velocity, spin)
    wide = float(np.abs(rotate(turn, shape.vertices_m)[:, 0]).max())
    gap = draw.decades("gap", 1e-5, 3e-4)
    squeeze = draw.between("squeeze", 0.02, 0.3) * GEL[2]
    lift, shake = draw.between("lift", 0, 2e-3), draw.between("shake", 0, 0.5)
    fingers = _fingers(draw, (1e4, 1e8))
    jaws = [KinematicBody(None, name=f"{gel.name} jaw") for gel in fingers]
    opened, closed = wide + gap, wide - squeeze
    path = [
        _jaws(opened),
        _jaws(0.5 * (opened + closed)),
        _jaws(closed),
        _jaws(closed, lift),
        _jaws(closed, lift, shake),
        _jaws(closed, 0.5 * lift, -shake),
        _jaws(opened, 0.5 * lift, -shake),
        _jaws(opened + 1e-3, 0.5 * lift, 0.0),
    ]
    scene = Scene(fingers, jaws, affine_bodies=body, time=stepping)
    return StressCase.along(path, scene, config)


def ratios(draw: Draw) -> StressCase:
    """A heavy body rests on foam, or a flake on steel: density and stiffness far apart."""
    config, stepping = settings(draw), in_time(draw, dt_s=(1e-3, 5e-2))
    soft = draw.chance("foam below", 0.6)
    young = (1e3, 1e4) if soft else (1e8, 1e9)
    dense = (1.0, 50.0) if soft else (1e4, 3e4)
    gel = glued_gel(draw, (8e-3, 8e-3, 3e-3), young_pa=young, density=dense)
    density = (1e4, 3e4) if soft else (1.0, 10.0)
    turn = draw.rotation("turn")
    shape = stiff_shape(draw.choose("shape", STIFF_SHAPES), 4e-3)
    low, _ = reach(shape, turn)
    heavy = draw.decades("density", *density)
    at = pose((0, 0, draw.decades("gap", 1e-7, 1e-4) - low), turn)
    body = stiff_body(shape, heavy, 0.5, at, young_pa=1e11 if soft else 1e6)
    scene = Scene(gel, affine_bodies=body, time=stepping)
    return StressCase(scene, config, 8, closed=True)


def pile(draw: Draw) -> StressCase:
    """Several stiff bodies fall on one another, on the floor, and maybe with a soft floor."""
    config, stepping = settings(draw, (2e-5, 2e-4)), in_time(draw, dt_s=(1e-3, 3e-2))
    count = draw.whole("bodies", 2, 5)
    height, bodies = draw.decades("gap", 1e-6, 5e-4), []
    mu = friction(draw)
    for number in range(count):
        shape = stiff_shape(draw.choose(f"shape {number}", STIFF_SHAPES), 3e-3, number)
        turn = draw.rotation(f"turn {number}")
        low, high = reach(shape, turn)
        place = (draw.between(f"x {number}", -5e-4, 5e-4), 0.0, height - low)
        density, fall = draw.decades(f"density {number}", 100.0, 2e4), (0.0, 0.0, -0.1 * number)
        at, name = pose(place, turn), f"body {number}"
        bodies.append(stiff_body(shape, density, mu, at, fall, name=name))
        height += high - low + draw.decades(f"gap {number}", 1e-6, 5e-4)
    gels = []
    floor = Plane(friction_coefficient=0.5)
    if draw.chance("soft floor", 0.4):
        mesh = bonded_block(draw, "gel", (8e-3, 8e-3, 2e-3))
        gels = [
            SoftBody(
                mesh,
                material(draw, "gel", (1e4, 1e7)),
                friction_coefficient=mu,
                element=Element.LINEAR,
            )
        ]
        floor = replace(floor, point_m=(0.0, 0.0, -2.5e-3))
    scene = Scene(gels, affine_bodies=bodies, planes=floor, time=stepping)
    return StressCase(scene, config, 8, closed=True)
