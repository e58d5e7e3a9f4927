# SPDX-License-Identifier: Apache-2.0
"""A frictionless ball of 4 mm radius, 0.2, 0.6 and 1 mm into a bonded gel of 24 x 24 x 4.25 mm,
on meshes that are refined alike in all directions."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from taccel_lab.cad.mesh.focus import FocusOptions
from taccel_lab.cad.mesh.gel_mesh import focused_gel_mesh
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.envs import PHYSICS, Accuracy, PressEnv, parse_indenter
from taccel_lab.scene import Element, Material

DEPTHS_MM = (0.2, 0.6, 1.0)
YOUNG_PA = 1.5e5


@dataclass(frozen=True)
class LayerPress:
    """What the ball gave."""

    node_count: int
    forces_n: list[float]
    """At each depth."""


def press(element: Element, layers: int, poisson_ratio: float) -> LayerPress:
    """Press the ball into the gel, one step a depth."""
    mesh = focused_gel_mesh(
        GelPad(
            length_x_mm=24.0,
            length_y_mm=24.0,
            corner_radius_mm=1.5,
            thickness_mm=4.25,
            window_x_mm=18.0,
            window_y_mm=18.0,
        ),
        FocusOptions(
            at_mm=(0.0, 0.0),
            radius_mm=3.5,
            size_mm=1.4 / layers,
            core=2 * layers,
            rings=max(5, round(2.3 * layers)),
            layers=layers,
            layer_ratio=1.15,
        ),
    )
    env = PressEnv(
        mesh,
        Material(YOUNG_PA, poisson_ratio),
        parse_indenter("sphere:4.0"),
        np.zeros((1, 2)),
        physics=replace(PHYSICS[Accuracy.DEFAULT], element=element),
    )
    forces = []
    for depth in DEPTHS_MM:
        env.move_to(depth)
        forces.append(float(env.wrench[0, 2]))
    return LayerPress(env.model.soft_count, forces)
