# SPDX-License-Identifier: Apache-2.0
"""A process a GPU: each steps its part of the environments, and nothing is exchanged.

python many_gpus.py 64 cuda:0 cuda:1 presses 64 balls in, and prints steps a second.
"""

import sys
import time
from multiprocessing import get_context

import numpy as np

import taccel_lab as tl
from taccel_lab.scene.shards import shard_of

STEPS, RADIUS_M = 5, 4e-3


def run(envs: int, rank: int, devices: list[str]) -> float:
    """Press a ball into the gels of part ``rank``; returns the seconds of its steps."""
    gel, ball = tl.load_sensor("flat_pad"), tl.KinematicBody(tl.Ball(RADIUS_M), name="ball")
    scene = tl.profile_scene(gel, kinematic_bodies=ball, env_count=envs)
    model = shard_of(scene, rank, len(devices)).finalize(devices[rank])
    top_m = gel.mesh.nodes_m[:, 2].max() + RADIUS_M + 2e-5
    poses = np.tile([0, 0, top_m, 0, 0, 0, 1], (model.env_count, 1, 1))
    solver, state = tl.SolverIPC(model), tl.initial_state(model, poses)
    begun = time.perf_counter()
    for _ in range(STEPS):
        poses[..., 2] -= 5e-5
        assert solver.step(state, poses).converged.all()
    return time.perf_counter() - begun


if __name__ == "__main__":
    envs, names = int(sys.argv[1]), sys.argv[2:]
    with get_context("spawn").Pool(len(names)) as pool:
        seconds = pool.starmap(run, [(envs, rank, names) for rank in range(len(names))])
    sys.stdout.write(f"{envs * STEPS / max(seconds):.1f} steps/s on {len(names)} devices\n")
