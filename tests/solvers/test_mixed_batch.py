# SPDX-License-Identifier: Apache-2.0
"""A batch in which every environment has its own object, gel, friction and motion."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from taccel_lab.geometry.block import block_mesh
from taccel_lab.model import Model
from taccel_lab.scene import (
    Ball,
    Element,
    KinematicBody,
    Material,
    Scene,
    SoftBody,
    Surface,
    box_mesh,
    sphere_mesh,
)
from taccel_lab.solvers import SolverConfig, SolverIPC
from taccel_lab.state import initial_state

PAD = block_mesh((4, 4, 2), (6e-3, 6e-3, 3e-3), jitter=0.1)
OBJECTS = {
    "ball": (Ball(2e-3), 2e-3),
    "box": (box_mesh((2e-3, 2e-3, 1e-3)), 0.5e-3),
    "pebble": (sphere_mesh(1.5e-3, 0.8e-3), 1.5e-3),
}
"""Each with its height over its origin [m]."""
NAMES = tuple(OBJECTS)
STEPS = 5
CONFIG = SolverConfig(dhat_m=5e-5, relative_tolerance=1e-6)


class Draw:
    """What differs: row e is of environment e, whatever the number of them."""

    def __init__(self, env_count: int) -> None:
        rng = np.random.default_rng(7)
        rows = rng.random((1000, 6))[:env_count]
        self.kinds = np.arange(env_count) % len(NAMES)
        self.young_pa = 4e4 * 5 ** rows[:, 0]
        self.poisson = 0.3 + 0.17 * rows[:, 1]
        self.friction = np.where(rows[:, 2] < 0.2, 0.0, rows[:, 2])
        self.depth_m = 1e-4 + 2e-4 * rows[:, 3]
        self.shear_m = 2e-4 * (rows[:, 4:] - 0.5)

    def pose(self, env: int, step: int) -> np.ndarray:
        """Of its object: down from beyond reach, then sideways as well."""
        z = OBJECTS[NAMES[self.kinds[env]]][1] + 1e-4 - (1e-4 + self.depth_m[env]) * step / STEPS
        x, y = self.shear_m[env] * max(step - 2, 0) / STEPS
        return np.array([x, y, z, 0.0, 0.0, 0.0, 1.0])


def batch(draw: Draw, env_count: int, device: str) -> Model:
    """All objects, each present in its environments; parameters are set afterwards."""
    bodies = [
        KinematicBody(
            OBJECTS[name][0],
            name=name,
            friction_coefficient=0.5,
            surface=Surface(environments=tuple(np.flatnonzero(draw.kinds == kind).tolist())),
        )
        for kind, name in enumerate(NAMES)
    ]
    pad = SoftBody(PAD, Material(1e5, 0.4), name="pad", element=Element.LINEAR)
    return Scene(pad, bodies, env_count).finalize(device)


def run_batch(env_count: int, device: str) -> tuple[np.ndarray, np.ndarray]:
    """Positions of the pad [env_count, node_count, 3] and contact forces [env_count] at the end."""
    draw = Draw(env_count)
    model = batch(draw, env_count, device)
    model.set_body("pad", young_modulus_pa=draw.young_pa, poisson_ratio=draw.poisson)
    for name in NAMES:
        model.set_friction("pad", name, draw.friction)

    def poses(step: int) -> np.ndarray:
        rows = [draw.pose(env, step) for env in range(env_count)]
        return np.repeat(np.stack(rows)[:, None], len(NAMES), axis=1)

    solver, state = SolverIPC(model, CONFIG), initial_state(model, poses(0))
    for step in range(1, STEPS + 1):
        report = solver.step(state, poses(step))
        assert report.converged.all(), report.summary()
    return state.positions.numpy()[:, : model.soft_count], report.contact_force_n


def run_alone(env: int) -> tuple[np.ndarray, float]:
    """The same of a model that was built for one environment."""
    draw = Draw(env + 1)
    name = NAMES[draw.kinds[env]]
    friction = float(draw.friction[env])
    material = Material(float(draw.young_pa[env]), float(draw.poisson[env]))
    pad = SoftBody(PAD, material, name="pad", element=Element.LINEAR)
    model = Scene(pad, KinematicBody(OBJECTS[name][0], friction, name=name)).finalize()
    solver = SolverIPC(model, CONFIG)
    state = initial_state(model, draw.pose(env, 0)[None, None])
    for step in range(1, STEPS + 1):
        report = solver.step(state, draw.pose(env, step)[None, None])
        assert report.converged.all(), report.summary()
    return state.positions.numpy()[0, : model.soft_count], float(report.contact_force_n[0])


ON_A_GPU = [
    pytest.mark.gpu,
    pytest.mark.skipif(not wp.is_cuda_available(), reason="needs a CUDA device"),
]


@pytest.mark.thorough(cases=("20-cpu",))
@pytest.mark.parametrize(
    ("env_count", "device"),
    [
        (20, "cpu"),
        # More than a block of 64 threads has.
        pytest.param(256, "cpu", marks=pytest.mark.slow),
        pytest.param(256, "cuda:0", marks=ON_A_GPU),
    ],
)
def test_each_is_as_if_alone(env_count: int, device: str) -> None:
    positions, forces = run_batch(env_count, device)
    assert (forces > 0).all()
    assert len(np.unique(forces)) == len(forces), "no two do the same"
    for env in range(0, len(forces), 17):
        alone, force = run_alone(env)
        assert forces[env] == pytest.approx(force, rel=1e-5)
        np.testing.assert_allclose(positions[env], alone, atol=1e-9)
