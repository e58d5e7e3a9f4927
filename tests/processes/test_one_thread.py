# SPDX-License-Identifier: Apache-2.0
"""What is made in one thread of BLAS does not depend on the machine's cores."""

from __future__ import annotations

import os
import subprocess
import sys

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


OVERLAP = """
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier
import numpy
from threadpoolctl import threadpool_info
from taccel_lab.processes.one_thread import one_blas_thread

both_in, first_out = Barrier(2), Barrier(2)

def threads():
    return max(pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas")

def first():
    with one_blas_thread():
        both_in.wait()
    first_out.wait()

def second():
    with one_blas_thread():
        both_in.wait()
        first_out.wait()
        return threads()

with ThreadPoolExecutor(2) as pool:
    left, stays = pool.submit(first), pool.submit(second)
    left.result()
    print(stays.result(), threads())
"""


def test_threads_that_overlap_leave_the_limit_as_it_was() -> None:
    found = subprocess.run(
        [sys.executable, "-c", OVERLAP],
        env=os.environ | {"OPENBLAS_NUM_THREADS": "2", "OMP_NUM_THREADS": "2"},
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert found.split() == ["1", "2"]
