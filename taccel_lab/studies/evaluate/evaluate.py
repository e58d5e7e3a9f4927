# SPDX-License-Identifier: Apache-2.0
"""Evaluate designs: build and press each one, compute its figures; alike presses are one batch.

Two designs share a simulation when the result is the same: those that differ in stiffness alone
(forces then scale), in density, or in camera, lights and markers.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import write_json
from taccel_lab.presses import parse_indenter
from taccel_lab.presses.bonded_layer import layer_force_n
from taccel_lab.progress import Progress, silent
from taccel_lab.scene import Ball
from taccel_lab.sensors.base import INCOMPRESSIBLE, FamilyParameters
from taccel_lab.sensors.registry import sensor_family
from taccel_lab.studies.metrics.base import Metric
from taccel_lab.studies.metrics.design_point import DesignFigures, DesignPoint, Fitted, NoFigure
from taccel_lab.studies.metrics.evidence import Evidence
from taccel_lab.studies.presses.press_batch import (
    REFERENCE_PA,
    PressJob,
    Simulated,
    batch_size,
    press_jobs,
    simulate,
)
from taccel_lab.studies.presses.press_record import PressRecord
from taccel_lab.studies.presses.standard import StandardPress

_NORMAL_95 = 1.96


class Unknowns:
    """What is not known of a gel before it is measured, as factors on the forces of its presses.

    Four things, taken as independent of each other:

    - what its Shore hardness says of Young's modulus, where that is how the modulus was given;
    - what units of one design differ by (``study.unit_spread_percent``);
    - Poisson's ratio, where the study leaves it at the catalogue's assumption (a gel of a hardness
      is taken as incompressible): solid silicone may be that, which stiffens a thin layer on a
      plate. The factor is that of the closed form of a bonded layer at the end of the press;
    - friction, where it is left at the catalogue's assumption, 1.0: a tool that slides lets a thin
      gel flow out from under it. No closed form is known; the factor is a law of balls and flat
      punches that was fitted to presses, see ``_slipping``.

    Positions stay and forces scale, exactly for a modulus, at the press's full depth for Poisson's
    ratio and friction. Figures at both ends are read from presses scaled by both factors.
    """

    def __init__(
        self, parameters: FamilyParameters, given: Mapping[str, Any], unit_spread: float
    ) -> None:
        """``given``: parameters that are not left to the catalogue."""
        layer = parameters.layer_materials()[0]
        pa = layer.young_modulus_pa
        low, high = layer.young_interval_pa or (pa, pa)
        units = _NORMAL_95 * math.log1p(unit_spread)
        self._low = math.hypot(math.log(pa / low), units)
        self._high = math.hypot(math.log(high / pa), units)
        self._nu = None if "poisson_ratio" in given else layer.poisson_ratio
        self._holds = "friction" not in given and layer.friction_coefficient > 0

    def force_factors(self, record: PressRecord) -> tuple[float, float]:
        """Factors between which the forces of a press lie, over those of the record."""
        low = math.hypot(self._low, self._slipping(record))
        return math.exp(-low), math.exp(math.hypot(self._high, self._stiffening(record)))

    def _slipping(self, record: PressRecord) -> float:
        """Logarithm of the force of this gel over that of one without friction; 0 where friction is
        given, or for tools that no law was fitted to.

        Presses at friction 1 over those without: flat gels of 1, 2 and 3 mm, Poisson's ratio 0.499,
        balls of 2 and 4 mm radius to half of the thickness and a punch of 2 mm to 15 %. The law
        meets logarithms of balls from a tenth of the thickness on within 25 %, of punches within
        5 %. On 9DTacts of 1.5 and 3 mm it gives 0.77 to 1.1 times the logarithm of balls, and up to
        0.13 too much of a punch. At a lower Poisson's ratio it is less.
        """
        found = _round_tool(record)
        if not self._holds or found is None:
            return 0.0
        kind, radius, depth = found
        if kind == "cylinder":
            return 0.21 * (radius / record.thickness_mm) ** 1.17
        return 0.63 * (depth / record.thickness_mm) ** 1.16 * (radius / record.thickness_mm) ** 0.43

    def _stiffening(self, record: PressRecord) -> float:
        """Logarithm of the force of an incompressible gel over that of this one; 0 where Poisson's
        ratio is given, or for tools without a closed form."""
        found = _round_tool(record)
        if self._nu is None or found is None:
            return 0.0
        kind, radius, depth = found
        try:
            here, there = (
                float(layer_force_n(kind, np.array([depth]), radius, record.thickness_mm, nu)[0])
                for nu in (self._nu, INCOMPRESSIBLE)
            )
        except InputError:
            return 0.0  # Past the ball's equator, where small strains have ended.
        return max(math.log(there / here), 0.0)


def _round_tool(record: PressRecord) -> tuple[Literal["sphere", "cylinder"], float, float] | None:
    """Kind and radius [mm] of a ball or flat punch, and how deep the press goes [mm]; None for
    other tools and for presses without a step."""
    kind, _, size = record.indenter.partition(":")
    if kind not in ("sphere", "cylinder") or not len(record.depth_mm):
        return None
    shape = parse_indenter(record.indenter).shape
    radius = shape.radius_m * 1e3 if isinstance(shape, Ball) else float(size)
    return kind, radius, float(record.depth_mm[record.down][-1])


_KEPT = 16
"""Whole presses that a process remembers: optimisers come back to a gel with another modulus."""
_recent: dict[tuple[str, str], Simulated] = {}
"""Presses by key and device, the newest last."""


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
        progress: Receives before the first and after each batch how many simulations are done.
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
