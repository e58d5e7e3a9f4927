# SPDX-License-Identifier: Apache-2.0
"""What changed between two results, beyond their spread."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeGuard

from taccel_lab.benchmarks.results import read_result
from taccel_lab.errors import InputError, naming

IDENTITY = {
    "speed": ("scene", "source", "envs", "lag", "steps"),
    "learning": ("scene", "source", "envs", "pace"),
    "press_accuracy": (
        "family", "thickness_mm", "tool", "depth_mm", "poisson_ratio", "friction", "branches",
        "setting",
    ),
    "stress": ("family",),
    "captures": ("set", "command", "figure"),
    "slow_steps": ("group",),
    "images": ("size", "sensors"),
    "readings": ("size", "at_once"),
}  # fmt: skip
"""What makes a row of a suite the same row."""
MACHINE = ("device", "cpu", "cores", "driver", "cuda_driver", "packages", "system")
SILENT = (
    "settings",
    "notes",
    "worst_n",
    "worst_over_contact_force",
    "worst_over_allowed",
    "worst_step_ms",
    "setup_s",
    "build_s",
)
"""What is set, follows from the tolerance, or is a single moment of wall time."""
SPREAD = {"median", "min", "max"}
"""What a figure measured several times has."""
UNSPREAD = 0.05
"""Part by which a figure measured once must differ to count."""


@dataclass(frozen=True)
class FigureChange:
    """One figure of one row."""

    row: str
    figure: str
    before: float
    after: float

    @property
    def percent(self) -> float:
        return 100 * (self.after / self.before - 1) if self.before else float("inf")

    def describe(self) -> str:
        return f"{self.row}: {self.figure} {self.before:.4g} -> {self.after:.4g}" + (
            f" ({self.percent:+.1f} %)" if self.before else ""
        )


def identity(suite: str, row: dict[str, Any]) -> tuple[str, ...]:
    """What two rows of one suite share only if they are the same."""
    return tuple(str(row.get(key)) for key in IDENTITY[suite])


def compare(first: dict[str, Any], second: dict[str, Any]) -> tuple[list[str], list[FigureChange]]:
    """Remarks on what makes the two hard to compare, and the figures that changed.

    A figure with a spread has changed when its ranges do not overlap, another one when it differs
    by more than 5 %.
    """
    if first["suite"] != second["suite"]:
        raise InputError(f"suites differ: {first['suite']} and {second['suite']}")
    settings = sorted({*first["settings"], *second["settings"]})
    remarks = [
        f"{title}{name}: {first[part].get(name)} -> {second[part].get(name)}"
        for part, title, names in (("run", "", MACHINE), ("settings", "setting ", settings))
        for name in names
        if first[part].get(name) != second[part].get(name)
    ]
    if first["suite"] not in IDENTITY:
        raise InputError(f"results of {first['suite']!r} are not compared row by row")
    before, after = (
        {identity(document["suite"], row): row for row in document["rows"]}
        for document in (first, second)
    )
    for title, one, other in (("only in the first", before, after), ("new", after, before)):
        missing = [", ".join(key) for key in one if key not in other]
        if missing:
            remarks.append(f"rows {title}: {'; '.join(missing)}")
    changes = [
        change
        for key in before
        if key in after
        for change in _changes(", ".join(key), before[key], after[key], "")
    ]
    return remarks, changes


def _changes(row: str, before: Any, after: Any, path: str) -> Iterator[FigureChange]:
    if isinstance(before, dict) and isinstance(after, dict):
        if SPREAD <= before.keys() & after.keys():
            if not all(_is_number(figure[name]) for figure in (before, after) for name in SPREAD):
                raise InputError(f"{row}: {path} has a spread that is not all numbers")
            if before["max"] < after["min"] or after["max"] < before["min"]:
                yield FigureChange(row, path, before["median"], after["median"])
            return
        for name in before:
            if name in after and name not in SILENT:
                yield from _changes(row, before[name], after[name], f"{path}.{name}".lstrip("."))
    elif _is_number(before) and _is_number(after):
        scale = max(abs(before), abs(after))
        if abs(after - before) > UNSPREAD * scale:
            yield FigureChange(row, path, float(before), float(after))


def _is_number(value: Any) -> TypeGuard[float]:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


@dataclass(frozen=True)
class Compare:
    """Say what changed from one result to another, beyond their spread."""

    first: Path
    """Result of before (JSON)."""
    second: Path
    """Result of after, of the same suite."""

    def run(self) -> None:
        before, after = read_result(self.first), read_result(self.second)
        with naming(self.second):
            remarks, changes = compare(before, after)
        for remark in remarks:
            print(f"note: {remark}")
        for change in changes:
            print(change.describe())
        print(f"{len(changes)} figures changed beyond their spread")
