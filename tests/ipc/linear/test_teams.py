# SPDX-License-Identifier: Apache-2.0
"""Teams of thread blocks that cannot all be resident: more than a GPU holds, or two at a time."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from taccel_lab.ipc.linear.pipelined_cg import PATIENCE, PipelinedCG
from taccel_lab.ipc.linear.system import LinearSystem
from tests.ipc.linear.systems import contact_system

pytestmark = [
    pytest.mark.gpu,
    pytest.mark.skipif(not wp.is_cuda_available(), reason="needs a CUDA device"),
]
GPU = "cuda:0"
TOLERANCE = 1e-8


def _check(system: LinearSystem, dense: np.ndarray) -> None:
    report = system.report()
    assert not report.breakdown.any()
    for env, matrix in enumerate(dense):
        b = system.rhs.numpy()[env].ravel()
        left = b - matrix @ system.solution.numpy()[env].ravel()
        assert np.linalg.norm(left) <= 1.01 * TOLERANCE * np.linalg.norm(b)


@pytest.mark.parametrize("patience", [0, PATIENCE])
@pytest.mark.parametrize(("envs", "lanes", "blocks"), [(1, 32, 8), (12, 512, 64)])
def test_whoever_is_there_does_the_work(envs: int, lanes: int, blocks: int, patience: int) -> None:
    """Twelve teams of 64 blocks of 512 lanes are more than any GPU holds; without patience teams
    are of every size."""
    system, dense = contact_system(envs, on=GPU)
    system._solver = PipelinedCG(system, system.clusters, lanes, blocks, 8, patience)
    system.tolerances.fill_(TOLERANCE)
    active = wp.full(envs, 1, dtype=wp.int32, device=GPU)
    for _ in range(20):
        system.solution.fill_(np.nan)
        system.solve(active, 1000)
        _check(system, dense)


def test_solvers_in_streams_of_their_own_end() -> None:
    streams = [wp.Stream(GPU) for _ in range(3)]
    cases = []
    for stream in streams:
        with wp.ScopedStream(stream):
            system, dense = contact_system(2, on=GPU)
            system._solver = PipelinedCG(system, system.clusters, 512, 64, 8)
            system.tolerances.fill_(TOLERANCE)
            cases.append((system, dense, wp.full(2, 1, dtype=wp.int32, device=GPU)))
    for _ in range(50):
        for stream, (system, _, active) in zip(streams, cases, strict=True):
            with wp.ScopedStream(stream):
                system.solve(active, 1000)
    wp.synchronize_device(GPU)
    for system, dense, _ in cases:
        _check(system, dense)
