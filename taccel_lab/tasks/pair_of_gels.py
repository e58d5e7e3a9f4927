# SPDX-License-Identifier: Apache-2.0
"""Two gels that face each other across the x axis of a hand, as fingers of a gripper do."""

from __future__ import annotations

import numpy as np

from taccel_lab.geometry import TetMesh
from taccel_lab.scene import KinematicBody, SoftBody
from taccel_lab.tasks.bodies import pad_body, pad_mesh
from taccel_lab.tasks.parameters import PadParameters

SIDES = ("left", "right")


def gels_of(
    pad: PadParameters, mesh: TetMesh | None = None
) -> tuple[list[SoftBody], list[KinematicBody]]:
    """The gels, and the frames that carry them: ``left mount``, ``right mount``.

    ``mesh`` stands in place of the block of ``pad``: its contact face touches z = 0 from below.
    """
    mesh = pad_mesh(pad) if mesh is None else mesh
    return (
        [pad_body(pad, mesh, side, f"{side} mount") for side in SIDES],
        [KinematicBody(None, name=f"{side} mount") for side in SIDES],
    )


def mounts_of(hands: np.ndarray, half_m: np.ndarray) -> np.ndarray:
    """Where the mounts are, [env, 2, 4, 4], the gels' faces at minus and plus ``half_m``, [env] or
    [env, 2], of the hands [env, 4, 4]; a gel's own y is the hand's z."""
    in_hand = np.tile(np.eye(4), (len(hands), 2, 1, 1))
    half_m = np.broadcast_to(half_m.reshape(len(hands), -1), (len(hands), 2))
    for k, side in enumerate((-1.0, 1.0)):
        in_hand[:, k, :3, 0] = [0.0, -side, 0.0]
        in_hand[:, k, :3, 1] = [0.0, 0.0, 1.0]
        in_hand[:, k, :3, 2] = [-side, 0.0, 0.0]
        in_hand[:, k, 0, 3] = side * half_m[:, k]
    return hands[:, None] @ in_hand
