# SPDX-License-Identifier: Apache-2.0
"""Where and with what a benchmark ran: goes into every result file."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from taccel_lab.processes.cores import bound_cores

PACKAGES = {"warp-lang": "warp", "numpy": "numpy", "torch": "torch", "scipy": "scipy"}
"""Distributions that results name, with their import names; only those that are loaded."""


def describe_run(device: str = "cpu") -> dict[str, Any]:
    """Machine, device, driver, versions, commit and time."""
    import warp as wp

    wp_device = wp.get_device(device)
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "commit": _commit(),
        "cpu": _cpu_model(),
        "cores": bound_cores(),
        "memory_gib": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1),
        "system": f"{platform.system()} {platform.machine()}, Python {platform.python_version()}",
        **_describe_device(wp_device),
        "packages": _packages(),
    }


def _describe_device(device: Any) -> dict[str, Any]:
    import warp as wp

    if not device.is_cuda:
        return {"device": "CPU, one thread", "cuda_driver": None}
    major, minor = wp.get_cuda_driver_version()
    return {
        "device": device.name,
        "device_memory_gib": round(device.total_memory / 2**30, 1),
        "device_arch": f"sm_{device.arch}",
        "multiprocessors": device.sm_count,
        "cuda_driver": f"{major}.{minor}",
        "driver": _driver_version(),
    }


def _driver_version() -> str | None:
    """Version of the kernel module, as nvidia-smi names it; None where it does not say."""
    path = Path("/proc/driver/nvidia/version")
    if not path.is_file():
        return None
    words = path.read_text(encoding="utf-8").split("Kernel Module", 1)[-1].split()
    return next((word for word in words if word[:1].isdigit() and "." in word), None)


def _packages() -> dict[str, str]:
    """Versions of the packages that this process has loaded."""
    found = {}
    for name, module in PACKAGES.items():
        if module not in sys.modules:
            continue
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            # An unpacked wheel on PYTHONPATH has no metadata.
            found[name] = str(getattr(sys.modules[module], "__version__", "unknown"))
    return found


def _commit() -> str:
    """Commit of the checkout, or what TACCEL_LAB_COMMIT says where there is no repository."""
    try:
        run = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--abbrev=12"],
            cwd=Path(__file__).parent,
            capture_output=True,
            text=True,
            check=False,
        )
        found = run.stdout.strip()
    except FileNotFoundError:
        found = ""
    return found or os.environ.get("TACCEL_LAB_COMMIT", "unknown")


def _cpu_model() -> str:
    info = Path("/proc/cpuinfo")
    if info.is_file():
        for line in info.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or "unknown"
