# SPDX-License-Identifier: Apache-2.0
"""Where and with what a benchmark ran: goes into every result file."""

from __future__ import annotations

import os
import platform
import subprocess
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any


def describe_run(device: str = "cpu") -> dict[str, Any]:
    """Machine, device, driver, versions, commit and time."""
    import warp as wp

    wp_device = wp.get_device(device)
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "commit": _commit(),
        "cpu": _cpu_model(),
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}, Python {platform.python_version()}",
        "device": wp_device.name if wp_device.is_cuda else "CPU, one thread",
        "cuda_driver": wp.get_cuda_driver_version() if wp_device.is_cuda else None,
        "packages": {name: version(name) for name in ("warp-lang", "numpy")},
    }


def _commit() -> str:
    here = Path(__file__).parent
    run = subprocess.run(
        ["git", "describe", "--always", "--dirty", "--abbrev=12"],
        cwd=here,
        capture_output=True,
        text=True,
        check=False,
    )
    return run.stdout.strip() or "unknown"


def _cpu_model() -> str:
    info = Path("/proc/cpuinfo")
    if info.is_file():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or "unknown"
