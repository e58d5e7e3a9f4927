# SPDX-License-Identifier: Apache-2.0
"""The press of a design page: at once by a formula, in a second by a coarse mesh, then by default.

How far the first two are from the last is measured in docs/viewer.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.cad.parts.dome_pad import DomePad
from taccel_lab.errors import InputError
from taccel_lab.geometry import QuadraticMesh, Region, TetMesh
from taccel_lab.geometry.press_mesh_options import PressMeshOptions
from taccel_lab.geometry.tool_section import ToolSection
from taccel_lab.presses import PHYSICS, Accuracy, PressEnv, layered_material, parse_indenter
from taccel_lab.presses.bonded_layer import layer_force_n
from taccel_lab.presses.physics import PressPhysics
from taccel_lab.scene import Material
from taccel_lab.sensors.press_mesh import pad_press_mesh

if TYPE_CHECKING:
    from taccel_lab.sensors.base import FamilyParameters

QUICK = replace(
    PHYSICS[Accuracy.FAST],
    mesh=PressMeshOptions(rings=4, layers=2),
    dhat_m=2e-5,
    relative_tolerance=1e-3,
)
"""A third of the default press's nodes."""
QUICK_STEPS, MORE_RINGS = 2, 6
STEP_MM = 0.2
"""Of the default press, as of ``taccel-lab press``."""
DEPTH_SHARE = 0.4
"""Deepest press of the page, as a part of the gel's thickness."""


class SupersededError(Exception):
    """A newer wish has come; what is under way is of no use any more."""


@dataclass(frozen=True)
class BallPress:
    """A ball pressed into the middle of the gel."""

    radius_mm: float = 3.0
    depth_mm: float = 0.5

    def limited(self, thickness_mm: float) -> BallPress:
        """As deep as the page presses a gel of that thickness."""
        return replace(self, depth_mm=min(self.depth_mm, DEPTH_SHARE * thickness_mm))


@dataclass(frozen=True)
class PressAnswer:
    """What a press gave."""

    force_n: float
    error_n: float
    """Estimated error of the force; NaN where there is no estimate."""
    mesh: TetMesh | QuadraticMesh
    positions_m: np.ndarray
    """[node, 3]."""
    pressures_pa: np.ndarray
    """[node]."""
    forces_n: np.ndarray
    """Of the ball on the nodes, [node, 3]."""
    von_mises_pa: np.ndarray
    """[node]."""
    ball_mm: np.ndarray
    """Middle of the ball at the end, [3]."""


def formula_force_n(parameters: FamilyParameters, press: BallPress) -> float:
    """Force by the exact linear solution of a bonded flat layer [N], see ``layer_force_n``: without
    friction, crown or rim; NaN for domes."""
    pad, gel = parameters.pad(), parameters.material()
    if isinstance(pad, DomePad):
        return math.nan
    found = layer_force_n(
        "sphere",
        np.array([press.depth_mm]),
        press.radius_mm,
        pad.thickness_mm,
        gel.poisson_ratio,
        gel.young_modulus_pa,
    )
    return float(found[0])


def press_ball(
    parameters: FamilyParameters,
    press: BallPress,
    *,
    quick: bool,
    superseded: Callable[[], bool],
    step: Callable[[int, int], None] = lambda done, total: None,
) -> PressAnswer:
    """Simulate the press.

    Args:
        parameters: Of the design.
        press: What is pressed.
        quick: With the coarse mesh, in two steps; else as ``taccel-lab press`` by default.
        superseded: Asked between steps.
        step: Told before each step how many are done, and of how many.

    Raises:
        SupersededError: ``superseded`` said so.
        InputError: A gel that cannot be meshed for the press.
        SimulationError: The press did not converge.
    """
    physics: PressPhysics = QUICK if quick else PHYSICS[Accuracy.DEFAULT]
    indenter = parse_indenter(f"sphere:{press.radius_mm:g}")
    mesh = _mesh(parameters, indenter.contact(press.depth_mm), physics)
    layers = parameters.layer_materials()
    material = layered_material(
        [Material(one.young_modulus_pa, one.poisson_ratio, one.density_kg_m3) for one in layers],
        mesh,
    )
    env = PressEnv(
        mesh,
        material,
        indenter,
        np.zeros((1, 2)),
        friction_coefficient=layers[0].friction_coefficient,
        physics=physics,
    )
    steps = QUICK_STEPS if quick else math.ceil(press.depth_mm / STEP_MM - 1e-9)
    for k in range(steps):
        if superseded():
            raise SupersededError
        step(k, steps)
        env.move_to(press.depth_mm * (k + 1) / steps)
    return _answer(env, math.nan if quick else float(env.error_estimate().force_n[0]))


def _mesh(
    parameters: FamilyParameters, contact: float | ToolSection, physics: PressPhysics
) -> TetMesh:
    """The gel around the press; pads with rings along their edge need more rings than a coarse
    mesh has."""
    pad = parameters.pad()
    try:
        return pad_press_mesh(pad, (0.0, 0.0), contact, physics.mesh)
    except InputError:
        if physics is not QUICK:
            raise
        return pad_press_mesh(pad, (0.0, 0.0), contact, replace(QUICK.mesh, rings=MORE_RINGS))


def _answer(env: PressEnv, error_n: float) -> PressAnswer:
    from taccel_lab.outputs import Outputs

    outputs, count = Outputs(env.solver).update(env.state), env.model.soft_count
    load = outputs.surface_load
    pressures = load.pressures.numpy()[0, :count].copy()
    return PressAnswer(
        force_n=float(env.press_force[0, 2]),
        error_n=error_n,
        mesh=env.mesh,
        positions_m=env.positions[0].copy(),
        pressures_pa=pressures,
        forces_n=env.contact_forces[0].copy(),
        von_mises_pa=outputs.von_mises.numpy()[0, :count].copy(),
        ball_mm=1e3 * env.poses[0, 0, :3],
    )


def height_profile_mm(
    answer: PressAnswer, positions_m: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """x and z [mm] of the contact face along y = 0, by ascending x; ``positions_m``: [node, 3]."""
    faces = answer.mesh.region_faces(Region.CONTACT)
    points = 1e3 * positions_m
    edges = np.unique(np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    first, second = points[edges[:, 0]], points[edges[:, 1]]
    # A hair beside the middle, where rows of nodes lie.
    below, above = first[:, 1] - 1e-6, second[:, 1] - 1e-6
    crossing = below * above < 0
    share = (below / np.where(crossing, below - above, 1.0))[crossing, None]
    found = first[crossing] + share * (second[crossing] - first[crossing])
    order = np.argsort(found[:, 0])
    return found[order, 0], found[order, 2]


def scaled(answer: PressAnswer, factor: float) -> PressAnswer:
    """The press of a gel whose moduli are all ``factor`` times these: the same shape, and all loads
    times that factor, as nothing else in a press has the dimension of a stress."""
    if not factor > 0:
        raise InputError("moduli must be above 0")
    return replace(
        answer,
        force_n=factor * answer.force_n,
        error_n=factor * answer.error_n,
        pressures_pa=factor * answer.pressures_pa,
        forces_n=factor * answer.forces_n,
        von_mises_pa=factor * answer.von_mises_pa,
    )
