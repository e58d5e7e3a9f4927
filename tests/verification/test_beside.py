# SPDX-License-Identifier: Apache-2.0
"""The comparison of two devices: a CPU beside itself, and beside one whose gel is another."""

from __future__ import annotations

import pytest

from taccel_lab.geometry.block import block_mesh
from taccel_lab.scene import KinematicBody, Material, Scene, SoftBody, box_mesh
from taccel_lab.solvers import SolverIPC
from tests.support.blocks import pose
from tests.support.scene_steps import Stepped
from tests.verification.beside import steps_beside
from tests.verification.conftest import BESIDE

pytestmark = pytest.mark.skipif(BESIDE is not None, reason="does it itself")


def press() -> None:
    gel = SoftBody(block_mesh((3, 3, 2), (6e-3, 6e-3, 3e-3)), Material(1e5, 0.4))
    plate = KinematicBody(box_mesh((3e-3, 3e-3, 1e-3)), friction_coefficient=0.5)
    # Onto the block, then along it.
    path = [pose(2e-5 * max(k - 3, 0), 0, 6.5e-4 - 1e-4 * min(k, 3)) for k in range(6)]
    run = Stepped(Scene(gel, plate), path[0], dhat_m=1e-4)
    for target in path[1:]:
        run.step(target)
    assert run.contact().any()


@pytest.mark.thorough
def test_a_cpu_beside_itself_gives_the_same_bits() -> None:
    with steps_beside("cpu") as found:
        press()
    assert (found.steps, found.left_out) == (5, 0)
    assert found.worst_force == found.worst_motion == 0


def test_another_gel_is_noticed() -> None:
    def soften(twin: SolverIPC) -> None:
        twin.model.set_body("gel", young_modulus_pa=0.99e5)

    with pytest.raises(AssertionError, match="cpu and cpu differ"), steps_beside("cpu", soften):
        press()
    step = SolverIPC.step
    assert step.__name__ == "step", "nothing is left behind"
