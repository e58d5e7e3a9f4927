# SPDX-License-Identifier: Apache-2.0
"""A case runner that dies at one seed, for the processes of the pool to import."""

from __future__ import annotations

import os
from typing import Any


def rigged_case(family: str, seed: int, device: str, seconds: float) -> dict[str, Any]:
    """Dies at seed 1, else a result."""
    if seed == 1:
        os._exit(3)
    return {"family": family, "seed": seed, "outcome": "converged", "parameters": {}}
