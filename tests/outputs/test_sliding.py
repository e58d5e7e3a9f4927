# SPDX-License-Identifier: Apache-2.0
"""What slides: nodes whose friction is at its limit, which is where the smoothing ends."""

from __future__ import annotations

import numpy as np

from taccel_lab.geometry.block import block_mesh
from taccel_lab.outputs import Outputs
from taccel_lab.presses import PressEnv, PressSetup, parse_indenter
from taccel_lab.scene import Material


def test_a_node_slides_from_the_end_of_the_smoothing_on() -> None:
    """A ball is dragged until nodes of its contact lie on both sides of that end, and near it."""
    mesh, ball = block_mesh((8, 8, 3), (8e-3, 8e-3, 4e-3)), parse_indenter("sphere:4")
    env = PressEnv(
        PressSetup(mesh, Material(1e5, 0.45), ball, friction_coefficient=0.5), np.zeros((1, 2))
    )
    env.move_to(0.4)
    friction = env.solver.friction
    assert friction is not None
    near = 0
    for x_mm in (0.005, 0.02, 0.05, 0.1):
        env.move_to(0.4, (x_mm, 0.0))
        read = Outputs(env.solver).update(env.state).sliding
        length = np.linalg.norm(read.slips.numpy(), axis=-1)
        end = friction.eps_u_m.numpy()[:, None]
        touching = read.limits.numpy() > 0
        slipping = read.slipping.numpy()
        np.testing.assert_array_equal(slipping[touching], (length >= end)[touching])
        near += int((touching & (length > end) & (length < 3 * end)).sum())
    assert near > 3, "no node tells the end of the smoothing from three times it"
