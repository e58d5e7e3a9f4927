# SPDX-License-Identifier: Apache-2.0
"""The press of a design page: at once by a formula, in a second by a coarse mesh, then by default.

How far the first two are from the last is measured in docs/viewer.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry import TetMesh
from taccel_lab.geometry.tool_section import ToolSection
from taccel_lab.presses import (
    PHYSICS,
    Accuracy,
    PressEnv,
    PressPath,
    PressSetup,
    layered_material,
    parse_indenter,
)
from taccel_lab.presses.mesh import Pad, pad_press_mesh
from taccel_lab.presses.mesh_options import PressMeshOptions
from taccel_lab.scene import Material
from taccel_lab.viewer.ball_press import BallPress, PressAnswer, SupersededError

if TYPE_CHECKING:
    from taccel_lab.sensors.base import FamilyParameters
    from taccel_lab.solvers import StepReport

QUICK = replace(
    PHYSICS[Accuracy.FAST],
    mesh=PressMeshOptions(rings=4, layers=2),
    dhat_m=2e-5,
    relative_tolerance=1e-3,
)
"""A third of the default press's nodes: with the rules of ``on_pad`` it would be within 1 % of that
press, and take as long."""
QUICK_STEPS, MORE_RINGS = 2, 6


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
        step: Receives before each step how many are done, and of how many.

    Raises:
        SupersededError: ``superseded`` said so.
        InputError: A gel that cannot be meshed for the press.
        SimulationError: The press did not converge.
    """
    indenter, path = parse_indenter(f"sphere:{press.radius_mm:g}"), PressPath(press.depth_mm)
    layers = parameters.layer_materials()
    materials = [
        Material(one.young_modulus_pa, one.poisson_ratio, one.density_kg_m3) for one in layers
    ]
    friction, poisson_ratio = layers[0].friction_coefficient, layers[0].poisson_ratio
    material_of = partial(layered_material, materials)
    if quick:
        mesh = _quick_mesh(parameters.pad(), indenter.contact(press.depth_mm))
        setup = PressSetup(mesh, material_of(mesh), indenter, friction, QUICK)
    else:
        setup = PressSetup.on_pad(
            parameters.pad(),
            material_of,
            indenter,
            (0.0, 0.0),
            path,
            poisson_ratio=poisson_ratio,
            friction_coefficient=friction,
            physics=PHYSICS[Accuracy.DEFAULT],
        )
    env = PressEnv(setup, np.zeros((1, 2)))
    if quick:
        path = replace(path, step_mm=press.depth_mm / QUICK_STEPS)

    def go_on(done: int, total: int, report: StepReport | None = None) -> None:
        if done == total:
            return
        if superseded():
            raise SupersededError
        step(done, total)

    go_on(0, len(path.waypoints()))
    env.follow(path, go_on)
    return _answer(env, math.nan if quick else float(env.error_estimate().force_n[0]))


def _quick_mesh(pad: Pad, contact: float | ToolSection) -> TetMesh:
    """The gel around the press; pads with rings along their edge need more rings than a coarse
    mesh has."""
    try:
        return pad_press_mesh(pad, (0.0, 0.0), contact, QUICK.mesh)
    except InputError:
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
