# SPDX-License-Identifier: Apache-2.0
"""What a press makes is freed with its last name: no circle of references keeps arrays alive until
the cycle collector runs, which counts objects and not their megabytes."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
import warp as wp

from taccel_lab.camera.gel_camera import camera_of
from taccel_lab.geometry import PixelGrid
from taccel_lab.geometry.block import block_mesh
from taccel_lab.ipc.linear.system import LinearSystem
from taccel_lab.model.matrix_pattern import BlockPattern
from taccel_lab.optics.render import OpticalModel
from taccel_lab.outputs import Outputs
from taccel_lab.presses import PressEnv, PressPath, parse_indenter
from taccel_lab.scene import Ball, KinematicBody, Material, Scene, SoftBody
from taccel_lab.sensors.profile import catalogue_profile
from taccel_lab.signals import FineSurface, SignalTactile
from taccel_lab.solvers import SolverIPC
from taccel_lab.state import initial_state

MESH = block_mesh((4, 4, 2), (4e-3, 4e-3, 2e-3))
GRID = PixelGrid(40, 30, 0.1, 0.1)


@contextmanager
def by_counting_alone() -> Iterator[None]:
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


def linear_system() -> dict[str, Any]:
    links = [[0], [0, 1], [1, 2]]
    starts = np.cumsum([0, *map(len, links)])
    columns = np.concatenate(links).astype(np.int32)
    diagonal = (starts[1:] - 1).astype(np.int32)
    pattern = BlockPattern(starts.astype(np.int32), columns, diagonal)
    system = LinearSystem(pattern, 2, wp.get_device("cpu"))
    system.solve(wp.full(2, 1, dtype=wp.int32, device="cpu"), 5)
    return {"system": system, "values": system.values}


def step() -> dict[str, Any]:
    ball = KinematicBody(Ball(3e-3), friction_coefficient=0.5)
    solver = SolverIPC(Scene(SoftBody(MESH, Material(1e5, 0.45)), ball).finalize("cpu"))
    state = initial_state(solver.model, np.array([[[0.0, 0, 3.1e-3, 0, 0, 0, 1]]]))
    for z_mm in (2.95, 2.9, 2.85):  # As they come, captured, launched.
        solver.step(state, np.array([[[0.0, 0, 1e-3 * z_mm, 0, 0, 0, 1]]]))
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
    env = PressEnv(MESH, Material(1e5, 0.45), parse_indenter("sphere:3"), np.zeros((1, 2)))
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
    with by_counting_alone():
        made = make()
        watched = {name: weakref.ref(thing) for name, thing in made.items()}
        made.clear()
        assert [name for name, thing in watched.items() if thing() is not None] == []
