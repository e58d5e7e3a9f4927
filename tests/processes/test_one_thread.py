# SPDX-License-Identifier: Apache-2.0
"""What is made in one thread of BLAS does not depend on the machine's cores."""

from __future__ import annotations

import os
import subprocess
import sys

MESHED = """
import hashlib
from taccel_lab.presses.mesh import press_mesh
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
