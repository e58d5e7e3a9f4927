# SPDX-License-Identifier: Apache-2.0
"""The suite ``precision``: what is left of a solve when numbers have another precision.

The scenes run with the package as it is, with a copy of it in which all numbers are single, and on
a GPU, where CG rounds its matrix, with one in which it does not. Copies are made by exchanging
text, so that nothing of the package has to know of another precision. All run in processes of their
own.
"""

from __future__ import annotations

import json
import re
import shutil
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

from taccel_lab.benchmarks.own_process import ROOT, run_python
from taccel_lab.benchmarks.results import ResultFile
from taccel_lab.benchmarks.suite import Suite
from taccel_lab.errors import InputError

_TYPES = (
    (re.compile(r"\bwp\.float64\b"), "wp.float32"),
    (re.compile(r"\bwp\.(vec\d|mat\d+|quat|transform)d\b"), r"wp.\1f"),
    (re.compile(r"\bwp::float64\b"), "wp::float32"),
    # What keeps divisors from zero is zero itself in single precision.
    (re.compile(r"\b1\.0e-300\b"), "1.0e-30"),
    (re.compile(r"\b1\.0e-150\b"), "1.0e-18"),
)
_DOUBLE = re.compile(r"\bdouble\b")
_OTHER = {
    "model/env_rows.py": (
        ("8) if size % 8 == 0", "4) if size % 4 == 0"),
        ("type_size_in_bytes(dtype) // 8", "type_size_in_bytes(dtype) // 4"),
        (
            "host_values(value, name, expected)\n",
            "host_values(value, name, expected).astype('f')\n",
        ),
    ),
    "ipc/reduce.py": (
        ("reinterpret_cast<long long*>", "reinterpret_cast<int*>"),
        ("__double_as_longlong", "__float_as_int"),
    ),
    "ipc/linear/arrow_program.py": (
        ("- STATIC_BYTES) // 8", "- STATIC_BYTES) // 4"),
        ("8 * self.room", "4 * self.room"),
        ("room + (len(words) + 1) // 2", "room + len(words)"),
    ),
    "ipc/linear/streamed_rows.py": (
        ("_STAGE_BYTES // 8", "_STAGE_BYTES // 4"),
        ("ld.global.f64", "ld.global.f32"),
        ('"=d"', '"=f"'),
    ),
    "solvers/state_rows.py": (
        ("type_size_in_bytes(array.dtype) // 8", "type_size_in_bytes(array.dtype) // 4"),
    ),
    "solvers/report.py": (
        ("2 * (rows.shape[0] - count)", "rows.shape[0] - count"),
        ("(len(_INTS) + 1) // 2", "len(_INTS)"),
    ),
}
"""Where the width of a number is counted on."""
_UNROUNDED = {
    "ipc/linear/pipelined_cg.py": (
        ("exact_rows = clusters.tasks.shape[0] / 3", "exact_rows = size / 3"),
    ),
    "ipc/linear/block_cg.py": (("exact_rows = clustered / 3", "exact_rows = n"),),
}
"""Where CG multiplies rows rounded: all are multiplied as they are, at the price of reading them
from where they were assembled."""


def write_copy(folder: Path) -> Path:
    """Copy the package into ``folder``; returns the copy. InputError where there is one already."""
    copy = folder / "taccel_lab"
    if copy.exists():
        raise InputError(f"{copy} exists already")
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "taccel_lab", copy, symlinks=False, ignore=ignored)
    return copy


def _exchange(text: str, path: Path, pairs: Iterable[tuple[str, str]]) -> str:
    for old, new in pairs:
        if old not in text:
            raise InputError(f"{path.name} no longer says {old!r}: look what does now")
        text = text.replace(old, new)
    return text


def write_double_precision(folder: Path) -> Path:
    """Copy the package with products of unrounded matrices; returns the copy.

    Raises:
        InputError: The folder holds a package already, or a place that has to change is gone.
    """
    copy = write_copy(folder)
    for name, pairs in _UNROUNDED.items():
        path = copy / name
        text = _exchange(path.read_text(encoding="utf-8"), path, pairs)
        path.write_text(text, encoding="utf-8")
    return copy


def write_single_precision(folder: Path) -> Path:
    """Copy the package with all types exchanged; returns the copy.

    Raises:
        InputError: As ``write_double_precision``.
    """
    copy = write_copy(folder)
    for path in copy.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        for pattern, other in _TYPES:
            text = pattern.sub(other, text)
        if path.is_relative_to(copy / "ipc"):  # Elsewhere it is a word of file formats.
            text = _DOUBLE.sub("float", text)
        text = _exchange(text, path, _OTHER.get(path.relative_to(copy).as_posix(), ()))
        path.write_text(text, encoding="utf-8")
    return copy


@dataclass(frozen=True)
class Precision(Suite):
    """Scenes as they are, in double and in single precision, at several tolerances."""

    name: ClassVar[str] = "precision"
    what: ClassVar[str] = (
        "Steps that converge, Newton iterations and residual as it is, in double and in single "
        "precision."
    )
    scene: tuple[str, ...] = ("press_239", "peg", "bolt")
    """Scenes."""
    steps: int = 24
    """First steps of each motion."""
    tolerances: tuple[float, ...] = (1e-2, 1e-3, 1e-4)
    """Residual over the contact force at which a step counts as converged. A residual of as many
    newtons is enough, too, where that is at most 1 mN; else one of 1 mN."""
    iterations: int = 100
    """Newton iterations after which a step has failed; it is not halved."""

    def settings(self) -> dict[str, Any]:
        return {"steps": self.steps, "max_newton_iterations": self.iterations}

    def measure_rows(self, result: ResultFile) -> None:
        """By scene and tolerance, the most exact first. On the CPU nothing is rounded."""
        if min(self.steps, self.iterations) < 1 or min(self.tolerances) <= 0:
            raise InputError("--steps, --iterations and --tolerances must be positive")
        with tempfile.TemporaryDirectory() as folder:
            roots = {"double": ROOT}
            if not self.device.startswith("cpu"):
                roots = {
                    "double": write_double_precision(Path(folder) / "double").parent,
                    "as it is": ROOT,
                }
            roots["single"] = write_single_precision(Path(folder) / "single").parent
            for scene in self.scene:
                for tolerance in self.tolerances:
                    for precision, root in roots.items():
                        label = f"{scene}, {precision}, {tolerance:g}"
                        row = partial(measure, scene, precision, root, tolerance, self)
                        result.measure(label, row, describe)


def measure(
    scene: str, precision: str, root: Path, tolerance: float, options: Precision
) -> dict[str, Any]:
    """One row: the suite ``speed`` in a process that imports the package from ``root``."""
    chosen = {
        "relative_tolerance": tolerance,
        "absolute_tolerance_n": min(tolerance, 1e-3),
        "max_newton_iterations": options.iterations,
        "max_substep_halvings": 0,
    }
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "speed.json"
        command = ["-m", "taccel_lab.benchmarks", "speed", "--scene", scene, "--repeats", "1"]
        command += ["--steps", str(options.steps), "--device", options.device, "--no-startup"]
        command += ["--no-check", "--out", str(out), "--set"]
        command += [f"{name}={value}" for name, value in chosen.items()]
        run_python(f"{scene} in {precision} precision", command, root, Path(folder))
        found = json.loads(out.read_text(encoding="utf-8"))["rows"][0]
    return {
        "scene": scene,
        "precision": precision,
        "tolerance": tolerance,
        **{key: found[key] for key in ("steps", "newton_mean", "newton_worst", "residual")},
        "ms_per_step": found["ms_per_step"]["median"],
        "contact_force_mean_n": found["contact_force_mean_n"],
    }


def describe(row: dict[str, Any]) -> str:
    """One line for the terminal."""
    failed = row["residual"]["unconverged"]
    return (
        f"{row['scene']}, {row['precision']}, {row['tolerance']:g}: {failed} of {row['steps']} "
        f"steps failed, Newton {row['newton_mean']:.1f}, {row['ms_per_step']:.1f} ms a step"
    )
