# SPDX-License-Identifier: Apache-2.0
"""The kernels that read a press, compiled while its solver still compiles its own.

Warp compiles a module when the first of its kernels is launched, one after the other; those of the
signals are needed last.
"""

from __future__ import annotations

import sys
from typing import Any

import warp as wp

from taccel_lab.processes.start_warp import start_warp

_READERS = ("taccel_lab.signals.", "taccel_lab.outputs.", "taccel_lab.optics.")


def reading_modules() -> list[Any]:
    """Warp's modules with kernels of what reads a press."""
    import taccel_lab.presses.press_image
    import taccel_lab.presses.press_outcome  # noqa: F401

    named = (wp.get_module(name) for name in sorted(sys.modules) if name.startswith(_READERS))
    return [module for module in named if module.kernels]


def compile_reading(device: str) -> None:
    """Compile them into the cache of kernels, from which any process takes them."""
    start_warp()
    wp.force_load(device, reading_modules())
