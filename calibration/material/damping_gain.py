# SPDX-License-Identifier: Apache-2.0
"""How much the solver's damping resists a press, over what small strains would say.

At small strains a speed v adds tau f'(d) v to the elastic force f(d). The solver's viscous stress
goes with the rate of Green's strain, which under compression changes less than the stress: at a
fifth of the gel's thickness about 0.7 of that force is left. A slow dynamic press of a damped gel
beside a static one measures the part, as a straight line over the depth.
"""

from __future__ import annotations

import numpy as np

from taccel_lab.calibration.material.gel import Gel, Tool
from taccel_lab.calibration.material.press_plans import GelBench
from taccel_lab.errors import SimulationError
from taccel_lab.files.file_cache import cached_arrays
from taccel_lab.geometry import Region
from taccel_lab.presses import profile_material
from taccel_lab.presses.touch import first_touch_m
from taccel_lab.scene import KinematicBody, Scene, SoftBody, TimeStepping
from taccel_lab.solvers import SolverIPC
from taccel_lab.state import initial_state

STEPS = 30
STEP_S = 0.01
DAMPING_S = 0.03
"""A tenth of the time of the press: the gel's shape stays the static one."""
LIGHT_KG_M3 = 1.0
"""Density of the gel, so that inertia adds nothing."""
EARLIEST = 0.2
"""Part of the depth from which forces count; before, single nodes make contact."""


def damping_gain(
    gel: Gel,
    tool: Tool,
    deepest_mm: float,
) -> tuple[float, float]:
    """Part of tau f'(d) v that the solver's damping adds: its value at 0 and slope over d [1/mm].

    Raises:
        SimulationError: A step that did not converge.
    """

    def simulate() -> dict[str, np.ndarray]:
        return {
            "still_n": damped_forces(gel, tool, deepest_mm, 0.0),
            "moving_n": damped_forces(gel, tool, deepest_mm, DAMPING_S),
        }

    bench = GelBench(gel, tool, deepest_mm)
    recipe = bench.recipe("viscous gain", gel, {"deepest_mm": deepest_mm, "steps": STEPS})
    found = cached_arrays("responses", recipe).read_or_make(simulate)
    depth = deepest_mm * np.arange(1, STEPS + 1) / STEPS
    # The static curve is smooth; what single nodes do to its slope is not wanted.
    late = depth > EARLIEST * deepest_mm
    curve = np.polyfit(np.log(depth[late]), np.log(found["still_n"][late]), 2)
    smooth = np.exp(np.polyval(curve, np.log(depth)))
    slope = smooth * np.polyval(np.polyder(curve), np.log(depth)) / depth
    unit = DAMPING_S * slope * deepest_mm / (STEPS * STEP_S)
    columns = np.stack([unit, unit * depth], axis=1)[late]
    extra = (found["moving_n"] - found["still_n"])[late]
    gain = np.linalg.lstsq(columns, extra, rcond=None)[0]
    return float(gain[0]), float(gain[1])


def damped_forces(gel: Gel, tool: Tool, deepest_mm: float, damping_s: float) -> np.ndarray:
    """Normal force of a gel of 1 MPa in each step of a steady press [N]."""
    mesh, physics = gel.mesh(tool, deepest_mm), gel.physics
    block = gel.unit_material().replace(damping_time_s=damping_s, density_kg_m3=LIGHT_KG_M3)
    soft = SoftBody(mesh, profile_material(block, mesh), element=physics.element)
    body = KinematicBody(tool.indenter().shape, 0.0, name="tool")
    time = TimeStepping(quasi_static=damping_s == 0, dt_s=STEP_S)
    model = Scene(soft, (body,), 1, time).finalize(gel.device)
    solver = SolverIPC(model, physics.solver())
    nodal = soft.nodal_mesh
    at = np.array(tool.at_mm) * 1e-3
    faces = nodal.region_faces(Region.CONTACT)
    touch = first_touch_m(tool.indenter().shape, nodal.nodes_m, faces, at)
    start = touch + 3 * physics.dhat_m
    pose = np.array([[[*at, start, 0.0, 0.0, 0.0, 1.0]]])
    state = initial_state(model, pose)
    forces = []
    for step in range(1, STEPS + 1):
        pose[0, 0, 2] = touch - deepest_mm * 1e-3 * step / STEPS
        report = solver.step(state, pose)
        if not report.converged[0]:
            raise SimulationError(
                f"the damped press of {tool.description} did not converge at "
                f"{deepest_mm * step / STEPS:.3g} mm"
            )
        gradient = solver.contact_gradient.numpy()[0, : model.soft_count, 2]
        forces.append(float(gradient.sum()))
    return np.array(forces)
