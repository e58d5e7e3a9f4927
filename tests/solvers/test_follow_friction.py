# SPDX-License-Identifier: Apache-2.0
"""Edges that rub on a gel: how many iterations that takes, captured or not, alone or in a batch."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from taccel_lab.model import Model
from taccel_lab.scene import KinematicBody, Material, Scene, SoftBody, box_mesh
from taccel_lab.solvers import SolverConfig, SolverIPC
from taccel_lab.solvers.env_progress import follow_after
from taccel_lab.state import State, initial_state
from tests.support.blocks import block_mesh, pose

STEP = 2e-4
"""Way down of the box in a step [m]."""


def at(depths_m: np.ndarray, side_m: float, turned_deg: float) -> np.ndarray:
    """Poses of the box, so deep in the gel, [env_count, 1, 7]."""
    place = pose(0.13e-3, 0.07e-3, side_m / 2, (0, 0, 1), turned_deg)
    poses = np.tile(place, (len(depths_m), 1, 1))
    poses[:, 0, 2] -= depths_m
    return poses


class Pressed:
    """A box pressed into a gel in three steps, at a pace of each environment."""

    def __init__(
        self, cells: int, side_m: float, turned_deg: float, pace: tuple[float, ...] = (1.0,)
    ) -> None:
        mesh = block_mesh((cells, cells, 3), (6e-3, 6e-3, 2.5e-3))
        gel = SoftBody(mesh, Material(1e5, 0.46), friction_coefficient=1.0)
        box = KinematicBody(box_mesh((side_m, side_m, side_m)), 1.0)
        self.model = Scene(gel, box, len(pace)).finalize()
        self.pace, self.box = np.array(pace), (side_m, turned_deg)

    def run(self, **options: object) -> tuple[State, np.ndarray]:
        """The last state, and the Newton iterations of each step, [step, env]."""
        config = SolverConfig(dhat_m=1e-5, **options)  # type: ignore[arg-type]
        solver = SolverIPC(self.model, config)
        state = initial_state(self.model, at(-0.1 * STEP * np.ones(len(self.pace)), *self.box))
        taken = []
        for step in range(1, 4):
            report = solver.step(state, at(STEP * step * self.pace, *self.box))
            assert report.converged.all(), report.summary()
            assert (report.residual_ratio <= 1).all() and (report.substeps == 1).all()
            taken.append(report.newton_iterations)
        return state, np.array(taken)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("cells", "side_m", "turned_deg", "most"),
    # 63 and 56; 111 and 81 with frozen friction alone.
    [(8, 2e-3, 0.0, 80), (10, 1.5e-3, 30.0, 60)],
)
def test_edges_take_few_iterations(cells: int, side_m: float, turned_deg: float, most: int) -> None:
    _, taken = Pressed(cells, side_m, turned_deg).run()
    assert taken.sum() <= most, taken


@pytest.mark.parametrize(
    ("on_gpu", "env_count", "freezings"), [(False, 64, 1), (True, 1, 1), (True, 64, 20)]
)
def test_batches_of_a_gpu_freeze_longer(on_gpu: bool, env_count: int, freezings: int) -> None:
    """All of them wait for the solves of one that follows: 10 % of the steps a second."""
    model = SimpleNamespace(device=SimpleNamespace(is_cuda=on_gpu), env_count=env_count)
    assert follow_after(cast(Model, model)) == freezings


@pytest.mark.thorough
def test_environments_follow_friction_each_for_itself() -> None:
    together, taken = Pressed(4, 2e-3, 0.0, (1.0, 0.6)).run()
    uncaptured, _ = Pressed(4, 2e-3, 0.0, (1.0, 0.6)).run(capture=False)
    alone, taken_alone = Pressed(4, 2e-3, 0.0, (0.6,)).run()
    np.testing.assert_array_equal(taken[:, 1], taken_alone[:, 0])
    x = together.positions.numpy()
    np.testing.assert_array_equal(x, uncaptured.positions.numpy())
    np.testing.assert_array_equal(x[1], alone.positions.numpy()[0])
