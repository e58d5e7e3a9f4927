# SPDX-License-Identifier: Apache-2.0
"""What is made in one thread of BLAS does not depend on the machine's cores."""

from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import numpy as np
from threadpoolctl import threadpool_info, threadpool_limits

from taccel_lab.processes.one_thread import one_blas_thread

MESHED = """
import hashlib
from taccel_lab.sensors.press_mesh import press_mesh
mesh = press_mesh("gelsight_mini", {}, (0.0, 0.0), 1.5)
print(hashlib.sha256(mesh.nodes_m.tobytes()).hexdigest())
"""


def test_meshes_do_not_depend_on_the_threads_of_blas() -> None:
    """The sums of a descent came out in another order with two, and the nodes elsewhere."""
    found = {
        subprocess.run(
            [sys.executable, "-c", MESHED],
            env=os.environ | {"OPENBLAS_NUM_THREADS": threads, "OMP_NUM_THREADS": threads},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for threads in ("1", "2")
    }
    assert len(found) == 1


def blas_threads() -> int:
    np.ones(2) @ np.ones(2)
    return max(pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas")


def test_threads_that_overlap_leave_the_limit_as_it_was() -> None:
    both_in, first_out = Barrier(2), Barrier(2)

    def first() -> None:
        with one_blas_thread():
            both_in.wait()
        first_out.wait()

    def second() -> int:
        with one_blas_thread():
            both_in.wait()
            first_out.wait()
            return blas_threads()

    with threadpool_limits(2, user_api="blas"), ThreadPoolExecutor(2) as threads:
        left = threads.submit(first)
        assert threads.submit(second).result() == 1
        left.result()
        assert blas_threads() == 2
