# SPDX-License-Identifier: Apache-2.0
"""Which linear methods a device and a size are offered."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.ipc.linear.system import METHODS, usable_methods

CPU = wp.get_device("cpu")
GPU: Any = SimpleNamespace(is_cpu=False, is_cuda=True)


@pytest.mark.parametrize(
    ("device", "rows", "expected"),
    [
        (CPU, 400, ["ssor"]),
        (GPU, 400, ["arrow", "cg", "pipelined"]),
        (GPU, 401, ["cg", "pipelined"]),
    ],
)
def test_methods_are_offered_where_they_are_made_for(
    device: Any, rows: int, expected: list[str]
) -> None:
    assert usable_methods(rows, device) == expected
    assert set(expected) <= set(METHODS)


def test_the_solver_of_the_cpu_is_refused_on_a_gpu() -> None:
    problem: Any = SimpleNamespace(pattern=None, device=GPU)
    with pytest.raises(InputError, match="ssor is for the CPU; a GPU has arrow, cg and pipelined"):
        METHODS["ssor"](problem)
