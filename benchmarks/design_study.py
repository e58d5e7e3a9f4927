# SPDX-License-Identifier: Apache-2.0
"""What a design study costs: designs that share nothing go through the standard presses.

The designs of a row differ in one dimension of the pad, so that every one needs simulations of its
own; studies that also vary stiffness or optics reuse them and cost less a design. The time of a row
is split into meshing, presses and figures. Where a row of the same sensor, parameter and number of
designs from another device is at hand, forces are compared with it.
"""

from __future__ import annotations

import time
from collections import defaultdict
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from taccel_lab.benchmarks.results import ResultFile, note, read_result
from taccel_lab.benchmarks.suite import Suite
from taccel_lab.errors import InputError
from taccel_lab.sensors.registry import sensor_family
from taccel_lab.studies.design_point import DesignPoint, DesignResult
from taccel_lab.studies.evaluate import evaluate_designs
from taccel_lab.studies.metrics import METRICS, Metric
from taccel_lab.studies.presses import DEFAULT_PRESSES, standard_presses


@dataclass(frozen=True)
class Study(Suite):
    """Designs a minute: every design meshed, pressed in the standard ways and judged."""

    name: ClassVar[str] = "study"
    what: ClassVar[str] = (
        "designs that share no simulation go through the standard presses; figures of merit "
        "included"
    )
    sensor: str = "gelsight_mini"
    """Sensor of the catalogue."""
    vary: str = "thickness_mm"
    """Dimension in which the designs differ, by up to a fifth of its default."""
    designs: tuple[int, ...] = (8,)
    """Numbers of designs, a row each."""
    reference: Path | None = None
    """Result of another device, whose forces are compared with."""

    def settings(self) -> dict[str, Any]:
        return {"sensor": self.sensor, "vary": self.vary, "presses": list(DEFAULT_PRESSES)}

    def measure_rows(self, result: ResultFile) -> None:
        reference = _forces_of(self.reference) if self.reference else {}
        note("a first design compiles the kernels ...")
        started = time.perf_counter()
        _evaluate(_designs(self, 1), self.device)
        result.put("first_design_s", time.perf_counter() - started)
        for count in self.designs:
            row = partial(_row, _designs(self, count), self.device, reference.get(count))
            result.measure(f"{count} designs", row, _describe)


def mechanical_metrics() -> list[Metric]:
    """Metrics that the standard presses feed and that need no picture."""
    return [
        metric
        for metric in METRICS.values()
        if set(metric.presses) <= set(DEFAULT_PRESSES) and not metric.name.startswith("optical")
    ]


def _designs(options: Study, count: int) -> list[DesignPoint]:
    """Designs with evenly spaced values around the default of the varied parameter."""
    family = sensor_family(options.sensor)
    known = family.parameters_type.parameters()
    if options.vary not in known:
        raise InputError(f"{options.sensor} has no parameter {options.vary!r}; {', '.join(known)}")
    default = float(known[options.vary].default)
    values = np.linspace(0.8 * default, 1.2 * default, count) if count > 1 else [1.01 * default]
    return [
        DesignPoint(f"{options.vary}_{i}", options.sensor, {options.vary: float(value)})
        for i, value in enumerate(values)
    ]


def _evaluate(
    designs: list[DesignPoint], device: str
) -> tuple[list[DesignResult], dict[str, float]]:
    """Results, and seconds by stage."""
    seconds: dict[str, float] = defaultdict(float)
    last = time.perf_counter()

    def lap(what: str, done: int, total: int) -> None:
        nonlocal last
        now = time.perf_counter()
        seconds[what] += now - last
        last = now

    results = evaluate_designs(
        designs, standard_presses(), mechanical_metrics(), device=device, progress=lap
    )
    lap("figures", 0, 0)
    return results, dict(seconds)


def _row(
    designs: list[DesignPoint], device: str, reference: dict[str, list[Any]] | None
) -> dict[str, Any]:
    started = time.perf_counter()
    results, stages = _evaluate(designs, device)
    seconds = time.perf_counter() - started
    records = [record for result in results for made in result.records.values() for record in made]
    whole = [record for record in records if not record.cause]
    # Steps that lift the indenter off have no force to compare the residual with.
    residuals = [
        float(np.max(record.residual_n / np.maximum(np.linalg.norm(record.force_n, axis=1), 1e-2)))
        for record in whole
    ]
    forces = {
        name: [made[0].force_n[-1].tolist() if not made[0].cause else None for made in column]
        for name, column in _by_press(results).items()
    }
    row: dict[str, Any] = {
        "designs": len(designs),
        "seconds": seconds,
        "designs_per_minute": 60 * len(designs) / seconds,
        "seconds_by_stage": stages,
        "simulations": sum(result.simulations for result in results),
        "steps": sum(len(record.force_n) for record in records),
        "failures": len(records) - len(whole),
        "causes": sorted({record.cause for record in records if record.cause})[:5],
        "nodes": max((record.mesh.node_count for record in records), default=0),
        "newton_iterations": int(sum(record.newton_iterations.sum() for record in records)),
        "largest_residual_over_force": max(residuals, default=None),
        "force_n": forces,
    }
    if reference is not None:
        row["force_difference"] = _difference(forces, reference)
    return row


def _describe(row: dict[str, Any]) -> str:
    return (
        f"{row['designs']} designs: {row['seconds']:.1f} s, {row['simulations']} simulations, "
        f"{row['failures']} failed"
    )


def _by_press(results: list[DesignResult]) -> dict[str, list[Any]]:
    """Records of each press, design by design."""
    return {
        name: [result.records[name] for result in results if name in result.records]
        for name in DEFAULT_PRESSES
    }


def _forces_of(path: Path) -> dict[int, dict[str, list[Any]]]:
    """Final forces in a result, by number of designs."""
    return {row["designs"]: row["force_n"] for row in read_result(path)["rows"]}


def _difference(found: dict[str, list[Any]], other: dict[str, list[Any]]) -> dict[str, float]:
    """Largest difference of the final force over its size, by press."""
    result = {}
    for name, forces in found.items():
        pairs = [
            (np.array(a), np.array(b))
            for a, b in zip(forces, other.get(name, []), strict=False)
            if a is not None and b is not None
        ]
        if pairs:
            result[name] = max(float(np.linalg.norm(a - b) / np.linalg.norm(b)) for a, b in pairs)
    return result
