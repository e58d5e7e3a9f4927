# SPDX-License-Identifier: Apache-2.0
"""What a press makes is freed with its last name: no circle of references keeps arrays alive until
the cycle collector runs, which counts objects and not their megabytes. And 100,000 steps keep no
memory from step to step, and the last one is as good as the first."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import warp as wp

from taccel_lab.camera.gel_camera import camera_of
from taccel_lab.geometry import PixelGrid
from taccel_lab.ipc.linear.system import LinearSystem
from taccel_lab.model.matrix_pattern import block_pattern
from taccel_lab.optics.render import OpticalModel
from taccel_lab.outputs import Outputs
from taccel_lab.presses import PressEnv, PressPath, PressSetup, parse_indenter
from taccel_lab.scene import Ball, Element, KinematicBody, Material, Scene
from taccel_lab.sensors.profile import catalogue_profile
from taccel_lab.signals import FineSurface, SignalTactile
from tests.solvers.steps import begun, stepped
from tests.support.blocks import everywhere, pose, soft_block

GEL = soft_block((4, 4, 2), (4e-3, 4e-3, 2e-3), Material(1e5, 0.45), Element.QUADRATIC)
GRID = PixelGrid(40, 30, 0.1, 0.1)


def linear_system() -> dict[str, Any]:
    pattern = block_pattern([np.array([[0, 1], [1, 2]])], np.arange(3))
    system = LinearSystem(pattern, 2, wp.get_device("cpu"))
    system.solve(wp.full(2, 1, dtype=wp.int32, device="cpu"), 5)
    return {"system": system, "values": system.values}


def step() -> dict[str, Any]:
    ball = KinematicBody(Ball(3e-3), friction_coefficient=0.5)
    solver, state = begun(Scene(GEL, ball).finalize("cpu"), everywhere(1, pose(0, 0, 3.1e-3)))
    for z_mm in (2.95, 2.9, 2.85):  # As they come, captured, launched.
        solver.step(state, everywhere(1, pose(0, 0, 1e-3 * z_mm)))
    fine = FineSurface(solver, ball.name, GRID)
    signal = SignalTactile.from_solver(solver, GRID, fine=fine)
    signal.update(state)
    signal.read("height_m", "contact", "traction_pa")
    outputs = Outputs(solver).update(state)
    assert outputs.surface_load is not None
    scene = solver.model.scene
    return {
        "solver": solver, "model": solver.model, "scene": scene, "state": state, "fine": fine,
        "signal": signal, "outputs": outputs,
    }  # fmt: skip


def press() -> dict[str, Any]:
    env = PressEnv(PressSetup(GEL.mesh, GEL.material, parse_indenter("sphere:3")), np.zeros((1, 2)))
    env.follow(PressPath(0.1, (0.0, 0.0), 0.0, 0.1, 2.0), lambda done, total, report: None)
    return {"env": env, "solver": env.solver, "model": env.model}


def seen() -> dict[str, Any]:
    profile = catalogue_profile("gelsight_mini")
    camera, design = camera_of(profile).resized(64, 48), profile.optical_design()
    assert design is not None and not isinstance(camera, PixelGrid)
    picture = OpticalModel.through(camera, design, profile.mesh)
    picture.render()
    signal = SignalTactile(profile.mesh, camera, env_count=1)
    signal.update(wp.array(profile.mesh.nodes_m[None], dtype=wp.vec3d, device="cpu"))
    signal.read("depth_m")
    return {"profile": profile, "camera": camera, "picture": picture, "signal": signal}


@pytest.mark.thorough(cases=("press", "seen", "step"))
@pytest.mark.parametrize("make", [linear_system, step, press, seen])
def test_all_of_it_is_freed_by_counting_references(make: Callable[[], dict[str, Any]]) -> None:
    make()  # What is made once, such as kernels, stays.
    gc.collect()
    gc.disable()
    try:
        made = make()
        watched = {name: weakref.ref(thing) for name, thing in made.items()}
        made.clear()
        assert [name for name, thing in watched.items() if thing() is not None] == []
    finally:
        gc.enable()


def resident_mib() -> float:
    with open("/proc/self/status", encoding="ascii") as status:
        (line,) = (line for line in status if line.startswith("VmRSS"))
    return int(line.split()[1]) / 1024


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_long_run_neither_grows_nor_drifts() -> None:
    period = 40
    gel = soft_block((3, 3, 1), (6e-3, 6e-3, 2e-3), Material(1e5, 0.45), friction_coefficient=0.5)
    phases = 2 * np.pi * np.arange(period) / period
    heights = 3e-3 + 1e-4 - 2.5e-4 * (1 - np.cos(phases))
    places = zip(2e-4 * np.sin(phases), heights, strict=True)
    path = [everywhere(1, pose(x, 0, z)) for x, z in places]
    solver, state = begun(Scene(gel, KinematicBody(Ball(3e-3))).finalize("cpu"), path[0])
    outputs, forces, after_warmup = Outputs(solver), [], 0.0
    for step in range(100_000):
        stepped(solver, state, path[step % period])
        if step % period == period // 2:
            forces.append(float(outputs.update(state).soft_wrenches().numpy()[0, 0, 2]))
        if step == 10 * period:
            after_warmup = resident_mib()
    assert resident_mib() - after_warmup < 5.0 and np.abs(forces[0]) > 1e-3
    np.testing.assert_allclose(forces[-1], forces[1], rtol=1e-3)
