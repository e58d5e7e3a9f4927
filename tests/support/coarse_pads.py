# SPDX-License-Identifier: Apache-2.0
"""Coarse GelSight pads on which a press takes a fraction of a second."""

from __future__ import annotations

import functools
from dataclasses import replace

from taccel_lab.geometry import TetMesh
from taccel_lab.presses import PHYSICS, Accuracy, PressMeshOptions
from taccel_lab.presses.mesh import press_mesh
from taccel_lab.scene import Element, Material

GEL = Material(1.5e5, 0.46)
LINEAR = replace(PHYSICS[Accuracy.DEFAULT], element=Element.LINEAR)
"""For what does not depend on the elements: which steps are taken, what is refused, which way
forces point."""
COARSE = PressMeshOptions(elements_per_radius=3.0, core=4, rings=8, layers=2)
FINER = PressMeshOptions(elements_per_radius=6.0, core=6, rings=10, layers=3)


@functools.cache
def pad(
    at_mm: tuple[float, float] = (0.0, 0.0),
    radius_mm: float = 1.0,
    options: PressMeshOptions = COARSE,
) -> TetMesh:
    """The default GelSight pad (5 mm thick, dome of 50 mm radius), graded around ``at_mm``."""
    return press_mesh("gelsight", {}, at_mm, radius_mm, options)
