# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab doctor``: is this installation able to do the work?"""

from __future__ import annotations

import importlib
import importlib.metadata
import importlib.util
import os
import platform
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from taccel_lab.errors import InputError
from taccel_lab.files.documents import read_toml
from taccel_lab.processes.cores import bound_cores

# Distributions whose import package is not their own name with underscores.
IMPORT_NAMES = {
    "warp-lang": "warp",
    "opencv-contrib-python-headless": "cv2",
    "pillow": "PIL",
    "pyyaml": "yaml",
}
DISTRIBUTION = "taccel-lab"
SYSTEM_LIBRARIES = ("libGL.so.1",)
ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Doctor:
    """Check the installation: versions, libraries, devices, kernels. Exits with 1 when broken."""

    full: bool = False
    """Import every required package, which takes half a minute, and list those for developers."""
    json: bool = False
    """Print JSON instead of tables."""

    def run(self) -> None:
        from taccel_lab.cli.console import print_json

        report = collect(self.full)
        if self.json:
            print_json(report)
        else:
            _print_tables(report)
        if report["problems"]:
            raise SystemExit(1)


def collect(full: bool = False) -> dict[str, Any]:
    """Everything ``doctor`` looks at; ``problems`` lists what keeps the tool from working."""
    packages = list(check_packages(full))
    problems = [
        f"{package['name']}: {package['problem']}"
        for package in packages
        if package["problem"] and not package["extra"]
    ]
    problems += [f"{name}: {problem}" for name, problem in check_libraries().items() if problem]
    report: dict[str, Any] = {"machine": describe_machine(), "packages": packages}
    if not any(package["name"] == "warp-lang" and package["problem"] for package in packages):
        try:
            report["warp"] = check_warp()
        except InputError as error:
            problems.append(str(error))
        problems += [
            f"warp device {device['name']}: {device['problem']}"
            for device in report.get("warp", {}).get("devices", ())
            if device["problem"]
        ]
    report["data"] = find_data()
    report["problems"] = problems
    return report


def describe_machine() -> dict[str, Any]:
    """Interpreter, platform, processor cores and memory [GiB]."""
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    return {
        "python": platform.python_version(),
        "executable": sys.executable,
        "platform": platform.platform(),
        "machine": platform.machine(),
        "cores": bound_cores(),
        "memory_gib": round(memory, 1),
    }


def requirements(root: Path = ROOT) -> Iterator[tuple[str, str]]:
    """Pairs of (requirement, extra) of taccel-lab; extra is empty for the required ones.

    Read from ``pyproject.toml`` in a source checkout, from the installed metadata otherwise.
    """
    pyproject = root / "pyproject.toml"
    if pyproject.is_file():
        project = read_toml(pyproject).get("project", {})
        if project.get("name") == DISTRIBUTION:
            yield from ((line, "") for line in project["dependencies"])
            for extra, lines in project["optional-dependencies"].items():
                yield from ((line, extra) for line in lines)
            return
    for line in importlib.metadata.requires(DISTRIBUTION) or []:
        text, _, marker = line.partition(";")
        extra = marker.split("==")[1].strip(" \"'") if "extra ==" in marker else ""
        yield text.strip(), extra


def check_packages(full: bool = True) -> Iterator[dict[str, Any]]:
    """Installed version of each dependency and what is wrong with it, if anything.

    ``full``: developers' packages too, and required ones are imported, which shows what else of the
    system they miss.
    """
    from packaging.requirements import Requirement

    for line, extra in requirements():
        if extra == "dev" and not full:
            continue
        requirement = Requirement(line)
        version, problem = None, None
        try:
            version = importlib.metadata.version(requirement.name)
        except importlib.metadata.PackageNotFoundError:
            problem = "not installed"
        if version is not None and not requirement.specifier.contains(version, prereleases=True):
            problem = f"version {version} is outside {requirement.specifier}"
        if problem is None and not extra and full:
            problem = import_problem(requirement.name)
        yield {
            "name": requirement.name,
            "allowed": str(requirement.specifier),
            "version": version,
            "extra": extra or None,
            "problem": problem,
        }


def check_libraries() -> dict[str, str | None]:
    """What is wrong with each library of the system that the CAD kernel and pictures load."""
    import ctypes

    found: dict[str, str | None] = {}
    for name in SYSTEM_LIBRARIES if sys.platform == "linux" else ():
        try:
            ctypes.CDLL(name)
            found[name] = None
        except OSError as error:
            found[name] = f"{error}; on Debian: apt install libgl1"
    return found


def import_problem(distribution: str) -> str | None:
    """Why the distribution's package cannot be imported, or None when it can."""
    module = IMPORT_NAMES.get(distribution, distribution.replace("-", "_"))
    try:
        importlib.import_module(module)
    except (ImportError, OSError) as error:
        return f"import {module} fails: {error}"
    return None


def check_warp() -> dict[str, Any]:
    """Warp's devices; on each, a small FP64 kernel is compiled, run and compared with numpy."""
    import numpy as np
    import warp as wp

    from taccel_lab.processes.start_warp import start_warp

    start_warp()

    @wp.kernel
    def _square_and_shift_kernel(x: wp.array(dtype=wp.float64), y: wp.array(dtype=wp.float64)):  # type: ignore[valid-type]
        i = wp.tid()
        y[i] = x[i] * x[i] + wp.float64(1.0)

    x = np.array([1e-7, 2e-7, 3.0])  # the first two vanish beside 1 in single precision
    devices = []
    for device in wp.get_devices():
        problem = None
        try:
            y = wp.empty(len(x), dtype=wp.float64, device=device)
            source = wp.array(x, dtype=wp.float64, device=device)
            wp.launch(_square_and_shift_kernel, dim=len(x), inputs=[source, y], device=device)
            if not np.allclose(y.numpy(), x * x + 1.0, rtol=1e-15, atol=0):
                problem = "a double-precision kernel gave wrong values"
        except RuntimeError as error:
            problem = f"kernel does not compile or run: {error}"
        devices.append({"name": str(device), "hardware": device.name, "problem": problem})
    return {
        "version": wp.config.version,
        "cuda": wp.is_cuda_available(),
        "kernel_cache": str(wp.config.kernel_cache_dir),
        "devices": devices,
    }


def find_data() -> dict[str, str | None]:
    """Where the demonstration captures and the validation data are, if anywhere."""
    spec = importlib.util.find_spec("taxim")
    captures = None
    if spec is not None and spec.origin is not None:
        pack = Path(spec.origin).parent / "calib" / "gelsight" / "dataPack.npz"
        captures = str(pack) if pack.is_file() else None
    folder = os.environ.get("TACCEL_LAB_DATA")
    return {
        "demo_captures": captures,
        "TACCEL_LAB_DATA": folder if folder and Path(folder).is_dir() else None,
    }


def _print_tables(report: dict[str, Any]) -> None:
    from rich.text import Text

    from taccel_lab.cli.console import print_table, results

    machine = [(name, str(value)) for name, value in report["machine"].items()]
    machine += [(name, value or "not found") for name, value in report["data"].items()]
    print_table(("machine", ""), machine)
    packages = []
    for package in report["packages"]:
        missing_style = "yellow" if package["extra"] else "red"
        state = Text(package["problem"] or "ok", style=missing_style if package["problem"] else "")
        known = (package["version"] or "-", package["allowed"], package["extra"] or "")
        packages.append((package["name"], *known, state))
    print_table(("package", "version", "allowed", "extra", "state"), packages)
    console = results()
    if "warp" in report:
        devices = report["warp"]["devices"]
        rows = [(one["name"], one["hardware"], one["problem"] or "ok") for one in devices]
        print_table(("device", "hardware", "FP64 kernel"), rows)
        console.print(f"kernel cache: {report['warp']['kernel_cache']}")
    for problem in report["problems"]:
        console.print(f"broken: {problem}", style="red")
    if not report["problems"]:
        console.print("everything required works", style="green")
