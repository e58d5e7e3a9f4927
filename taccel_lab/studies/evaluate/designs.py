# SPDX-License-Identifier: Apache-2.0
"""Evaluate designs: build and press each one, compute its figures; alike presses are one batch.

Two designs share a simulation when the result is the same: those that differ in stiffness alone
(forces then scale), in density, or in camera, lights and markers.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import write_json
from taccel_lab.progress import Progress, silent
from taccel_lab.sensors.base import FamilyParameters
from taccel_lab.sensors.registry import sensor_family
from taccel_lab.studies.evaluate.unknowns import Unknowns
from taccel_lab.studies.metrics.base import Metric
from taccel_lab.studies.metrics.design_point import DesignFigures, DesignPoint, Fitted, NoFigure
from taccel_lab.studies.metrics.evidence import Evidence
from taccel_lab.studies.presses.press_batch import REFERENCE_PA, Simulated, batch_size, simulate
from taccel_lab.studies.presses.press_job import PressJob, press_jobs
from taccel_lab.studies.presses.standard import StandardPress

_KEPT = 16
"""Whole presses that a process remembers: optimisers come back to a gel with another modulus."""
_recent: dict[tuple[str, str], Simulated] = {}
"""By key and device, the newest last."""


@dataclass
class _Design:
    """One design on its way."""

    result: DesignFigures
    parameters: FamilyParameters | None = None
    keys: dict[str, list[str]] = field(default_factory=dict)
    """Simulations by press."""


def evaluate_designs(
    designs: Sequence[DesignPoint],
    presses: Sequence[StandardPress],
    metrics: Sequence[Metric],
    *,
    device: str = "cpu",
    progress: Progress = silent,
    folder: Path | None = None,
    unit_spread: float = 0.0,
) -> list[DesignFigures]:
    """Press every design and compute its figures.

    A design that cannot be built, and a press that does not converge, leave figures None with a
    cause; the others go on.

    Args:
        designs: Points of a study, with unique ids.
        presses: Standard presses; figures read from presses that are missing here stay None.
        metrics: What to compute.
        device: Warp device of the solver.
        progress: Told before the first and after each batch how many simulations are done.
        folder: Where the steps of presses are saved, in a subfolder of each design's id.
        unit_spread: Standard deviation of the stiffness from unit to unit, as a part of it.

    Returns:
        One result for each design, in order.
    """
    ids = [point.id for point in designs]
    if len(set(ids)) != len(ids):
        raise InputError("designs of a study need unique ids; some are given twice")
    if len({press.name for press in presses}) != len(presses):
        raise InputError("presses of a study need unique names; some are given twice")
    jobs: dict[str, PressJob] = {}
    owners: dict[str, _Design] = {}
    prepared = []
    for point in designs:
        design = _prepare(point, presses, jobs)
        for keys in design.keys.values():
            for key in keys:
                owners.setdefault(key, design)
        prepared.append(design)
    done = {key: _recent[key, device] for key in jobs if (key, device) in _recent}
    progress("meshed", len(done), len(jobs))
    to_do = {key: job for key, job in jobs.items() if key not in done}
    for batch in _batches(to_do, batch_size(device)):
        for job, simulated in zip(batch, simulate(batch, device), strict=True):
            done[job.key] = simulated
            if not simulated.record.cause:
                _recent[job.key, device] = simulated
            owner = owners[job.key].result
            owner.simulations += 1
            owner.seconds += simulated.seconds
        progress(f"press {batch[0].press.name}", len(done), len(jobs))
    while len(_recent) > _KEPT:
        del _recent[next(iter(_recent))]
    for design in prepared:
        started = time.perf_counter()
        _conclude(design, done, metrics, unit_spread, device)
        if folder is not None:
            _save_presses(design.result, folder / design.result.point.id)
        design.result.seconds += time.perf_counter() - started
    return [design.result for design in prepared]


def _prepare(
    point: DesignPoint, presses: Sequence[StandardPress], jobs: dict[str, PressJob]
) -> _Design:
    """Build a design and add the simulations that it needs, and nobody before it, to ``jobs``."""
    started = time.perf_counter()
    design = _Design(DesignFigures(point))
    try:
        design.parameters = sensor_family(point.family).parameters(point.parameters)
    except InputError as error:
        design.result.causes["design"] = str(error)
        return design
    for press in presses:
        try:
            wanted = press_jobs(press, design.parameters)
        except InputError as error:
            design.result.causes[f"press {press.name}"] = str(error)
            continue
        design.keys[press.name] = [job.key for job in wanted]
        for job in wanted:
            jobs.setdefault(job.key, job)
    design.result.seconds += time.perf_counter() - started
    return design


def _batches(jobs: dict[str, PressJob], size: int) -> Iterator[list[PressJob]]:
    """Jobs that can be environments of one scene, at most ``size`` at a time."""
    groups: dict[str, list[PressJob]] = {}
    for job in jobs.values():
        groups.setdefault(job.batch_key, []).append(job)
    for group in groups.values():
        for start in range(0, len(group), size):
            yield group[start : start + size]


def _conclude(
    design: _Design,
    done: dict[str, Simulated],
    metrics: Sequence[Metric],
    unit_spread: float,
    device: str,
) -> None:
    """Figures and curves of a design from its simulations."""
    result, parameters = design.result, design.parameters
    if parameters is None:
        cause = result.causes["design"]
        for metric in metrics:
            result.figures[metric.name] = None
            result.causes[metric.name] = cause
        return
    stiffer = parameters.layer_materials()[0].young_modulus_pa / REFERENCE_PA
    records = {
        name: [done[key].record.scaled(stiffer) for key in keys]
        for name, keys in design.keys.items()
    }
    for name, made in records.items():
        causes = [record.cause for record in made if record.cause]
        if causes:
            result.causes[f"press {name}"] = "; ".join(causes)
        result.curves[name] = [record.curve() for record in made]
    result.records = records
    unmade = {
        name.removeprefix("press "): cause
        for name, cause in result.causes.items()
        if name.removeprefix("press ") not in records
    }
    evidence = Evidence(parameters, records, unmade, device=device)
    unknowns = Unknowns(parameters, result.point.parameters, unit_spread)
    factors = {n: [unknowns.force_factors(r) for r in made] for n, made in records.items()}
    ends = [
        replace(
            evidence,
            records={
                name: [r.scaled(f[end]) for r, f in zip(made, factors[name], strict=True)]
                for name, made in records.items()
            },
        )
        for end in (0, 1)
    ]
    for metric in metrics:
        try:
            found = metric.read(evidence)
        except (NoFigure, InputError) as error:
            result.figures[metric.name] = None
            result.causes[metric.name] = str(error)
            continue
        result.figures[metric.name] = found.value
        if metric.presses:
            result.intervals[metric.name] = _interval(metric, found, ends)


def _interval(
    metric: Metric, found: Fitted, ends: Sequence[Evidence]
) -> tuple[float | None, float | None]:
    """Where the figure lies between the softest and the stiffest gel that this may be; None for an
    end that cannot be had, such as a depth at a load which a press of the softest does not reach.

    The interval of a fit comes on top, as independent.
    """
    values: list[float | None] = []
    for evidence in ends:
        try:
            values.append(metric.read(evidence).value)
        except (NoFigure, InputError):
            values.append(None)
    soft, stiff = values
    rising = (soft is not None and soft < found.value) or (
        stiff is not None and stiff > found.value
    )
    low, high = (soft, stiff) if rising else (stiff, soft)
    return (
        None if low is None else found.value - math.hypot(found.value - low, found.half),
        None if high is None else found.value + math.hypot(high - found.value, found.half),
    )


def _save_presses(result: DesignFigures, folder: Path) -> None:
    """Write the steps of a design's presses."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, made in result.records.items():
        for number, record in enumerate(made):
            suffix = f"_{number}" if len(made) > 1 else ""
            record.save(folder / f"press_{name}{suffix}.npz")
    write_json(folder / "presses.json", result.curves)
