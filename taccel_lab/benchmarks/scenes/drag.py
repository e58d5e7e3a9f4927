# SPDX-License-Identifier: Apache-2.0
"""A ball presses a gel, drags it sideways and leaves: the work of one sensor.

Pads: 40 x 40 mm with 239 or 5,215 nodes, published or ours, and the domed pad of the catalogue's
GelSight with 2,005 nodes, fine under the ball, of linear tets or of an eighth as many quadratic
ones with nodes at the same places. The motion is quasi-static.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np

from taccel_lab.benchmarks.scenes.base import BenchScene, SceneOptions, make_config, pad, straight
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.scene import Ball, Element, KinematicBody, Material, Scene, SoftBody

FRICTION = 0.5


@dataclass(frozen=True)
class PressMotion:
    """Motion of the ball, in metres."""

    ball_m: float
    depth_m: float
    shear_m: float


PLACE_M = (1e-3, -0.5e-3)
"""Where the ball comes down."""
MOTIONS = {
    "press_239": PressMotion(8e-3, 1.0e-3, 1.0e-3),
    "press_2005": PressMotion(2e-3, 0.8e-3, 0.4e-3),
    "press_2005_quadratic": PressMotion(2e-3, 0.8e-3, 0.4e-3),
    "press_5215": PressMotion(8e-3, 1.0e-3, 1.0e-3),
}
CLEARANCE_M = 0.2e-3
STEPS = [2, 8, 10, 4]
"""Down to the gel, into it, sideways, away."""
GEL = Material(young_modulus_pa=1.5e5, poisson_ratio=0.46)


def build(options: SceneOptions, name: str) -> BenchScene:
    """A press of one of the pads."""
    motion = MOTIONS[name]
    element = Element.QUADRATIC if name.endswith("quadratic") else Element.LINEAR
    if name.startswith("press_2005"):
        mesh, source = domed_pad(motion, 1 if element is Element.LINEAR else 2), "generated"
    else:
        mesh, source = pad(int(name.removeprefix("press_")), options.source)
    scene = Scene(
        SoftBody(mesh, GEL, name="gel", element=element),
        KinematicBody(Ball(motion.ball_m), FRICTION, name="ball"),
        options.env_count,
    )
    nodes = scene.soft_bodies[0].nodal_mesh.node_count
    config = make_config({"dhat_m": 2e-5, "friction_eps_m": 1e-6}, options.config)
    what = f"a ball presses and drags a gel of {nodes:,} nodes"
    if element is Element.QUADRATIC:
        what += ", quadratic tets"
    return BenchScene(name, what, scene, config, ball_path(mesh, motion)[:, None], source)


def domed_pad(motion: PressMotion, coarser: int) -> TetMesh:
    """The catalogue's GelSight with 2,005 nodes, or with edges ``coarser`` times as long."""
    for name in ("scipy", "threadpoolctl"):
        if find_spec(name) is None:
            raise InputError(f"presses of the catalogue's pad are meshed by {name}: install it")
    from taccel_lab.presses import PressMeshOptions
    from taccel_lab.presses.mesh import press_mesh

    radius_mm = 1e3 * np.sqrt(motion.depth_m * motion.ball_m)
    at_mm = (1e3 * PLACE_M[0], 1e3 * PLACE_M[1])
    options = PressMeshOptions(core=8 // coarser, rings=10 // coarser, layers=4 // coarser)
    return press_mesh("gelsight", {}, at_mm, float(radius_mm), options)


def touching_height(mesh: TetMesh, place_m: tuple[float, float], radius_m: float) -> float:
    """Height of the centre of a ball that comes down onto the contact nodes [m]."""
    nodes = mesh.nodes_m[mesh.region_nodes(Region.CONTACT)]
    beside = np.hypot(*(nodes[:, :2] - place_m).T)
    near = beside < radius_m
    return float((nodes[near, 2] + np.sqrt(radius_m**2 - beside[near] ** 2)).max())


def ball_path(mesh: TetMesh, motion: PressMotion) -> np.ndarray:
    """Poses of the ball, [steps + 1, 7]."""
    x, y = PLACE_M
    low = touching_height(mesh, PLACE_M, motion.ball_m)
    above, deep = low + CLEARANCE_M, low - motion.depth_m
    points = np.array(
        [
            (x, y, above + CLEARANCE_M),
            (x, y, above - CLEARANCE_M),
            (x, y, deep),
            (x + motion.shear_m, y, deep),
            (x + motion.shear_m, y, above),
        ]
    )
    turns = np.tile([0.0, 0.0, 0.0, 1.0], (len(points), 1))
    return straight(np.concatenate([points, turns], axis=1), STEPS)
