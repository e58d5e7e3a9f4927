# SPDX-License-Identifier: Apache-2.0
"""A study whose names and bounds have been checked against the catalogue, presses and metrics."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from taccel_lab.cad.parameters import Parameter
from taccel_lab.errors import InputError, naming
from taccel_lab.progress import Progress, silent
from taccel_lab.reading.text_file import shown
from taccel_lab.sensors.base import SensorFamily
from taccel_lab.sensors.registry import sensor_families
from taccel_lab.studies.axis import Axis, axis_of, significant
from taccel_lab.studies.design_point import DesignPoint, DesignResult, content_id
from taccel_lab.studies.metrics.base import Metric
from taccel_lab.studies.spec import StudySpec, Tie, load_spec, require_known
from taccel_lab.studies.sweep import grid_points, random_points

EVALUATION_VERSION = 2
"""Raised when presses or metrics give other figures for the same design: stored ones are not taken
over then."""


class Evaluate(Protocol):
    """Presses designs and computes their figures;
    ``taccel_lab.studies.evaluate.evaluate_designs``."""

    def __call__(
        self,
        designs: Sequence[DesignPoint],
        presses: Sequence[Any],
        metrics: Sequence[Metric],
        *,
        device: str = "cpu",
        progress: Progress = silent,
        folder: Path | None = None,
        load_n: float = 0.5,
    ) -> list[DesignResult]: ...


@dataclass(frozen=True)
class Kit:
    """What a study can press and measure, and who does it."""

    presses: Mapping[str, Any]
    """Frozen dataclasses by name; their fields are what ``[press.NAME]`` may set."""
    metrics: Mapping[str, Metric]
    evaluate: Evaluate
    """A function of a module, so that other processes find it."""
    version: int = EVALUATION_VERSION


@dataclass(frozen=True)
class Study:
    """What a study file asks for, ready to run."""

    spec: StudySpec
    family: SensorFamily
    axes: tuple[Axis, ...]
    presses: dict[str, Any]
    metrics: dict[str, Metric]
    kit: Kit

    @property
    def parameters(self) -> dict[str, Parameter]:
        """Of the family, by name."""
        return self.family.parameters_type.parameters()

    def points(self) -> list[DesignPoint]:
        """Designs of a grid or random sweep, in order; an optimiser finds its own."""
        sweep = self.spec.sweep
        if sweep.kind == "grid":
            chosen = grid_points(self.axes)
        else:
            chosen = random_points(self.axes, sweep.count or 0, self.spec.study.seed, sweep.sampler)
        # Whole numbers and listed values can come up twice in a random sweep: one row is enough.
        return list({point.id: point for point in map(self.point, chosen)}.values())

    def point(self, swept: Mapping[str, Any]) -> DesignPoint:
        """The design with these values of the swept parameters."""
        parameters = {**self.spec.fixed, **swept}
        for name, tie in self.spec.tied.items():
            parameters[name] = _tied_value(tie, swept[tie.to], self.parameters[name])
        return DesignPoint(self.design_id(parameters), self.family.name, parameters)

    @property
    def press_keys(self) -> dict[str, str]:
        """Stands for the settings of each press."""
        return {name: content_id(dataclasses.asdict(press)) for name, press in self.presses.items()}

    @property
    def figure_keys(self) -> dict[str, str]:
        """Stands for the settings of the presses that each metric is read from, and the load."""
        keys, load_n = self.press_keys, self.spec.study.load_n
        return {
            name: content_id([*(keys[press] for press in metric.presses), load_n])
            if metric.presses
            else content_id([])
            for name, metric in self.metrics.items()
        }

    def design_id(self, parameters: Mapping[str, Any]) -> str:
        """Hash of all that decides what a design is: the family and every parameter."""
        defaults = {name: spec.default for name, spec in self.parameters.items()}
        return content_id(
            {
                "family": self.family.name,
                "parameters": {**defaults, **parameters},
                "version": self.kit.version,
            }
        )


def _tied_value(tie: Tie, value: float, parameter: Parameter) -> float | int:
    found = tie.factor * float(value) ** tie.power + tie.offset
    return round(found) if isinstance(parameter.default, int) else significant(found)


def default_kit() -> Kit:
    """The standard presses and metrics on our solver."""
    from taccel_lab.studies.evaluate import evaluate_designs
    from taccel_lab.studies.metrics import METRICS
    from taccel_lab.studies.presses import STANDARD_PRESSES

    return Kit(STANDARD_PRESSES, METRICS, evaluate_designs)


def read_study(path: Path, kit: Kit) -> Study:
    """The study of a file; InputError names the file and what is wrong in it."""
    with naming(path):
        return make_study(load_spec(path), kit)


def make_study(spec: StudySpec, kit: Kit) -> Study:
    """Check a study file's names and bounds.

    Raises InputError for an unknown sensor, parameter, press or metric (with the nearest known),
    and for values outside the family's bounds.
    """
    families = sensor_families()
    require_known("sensor", spec.study.sensor, families)
    family = families[spec.study.sensor]
    known = family.parameters_type.parameters()
    for table in ("parameters", "fixed", "tied"):
        for name in getattr(spec, table):
            require_known(f"parameter of {family.name} in [{table}]", name, known)
    axes = []
    for name, wanted in spec.parameters.items():
        try:
            axes.append(axis_of(known[name], wanted))
        except InputError as error:
            raise InputError(f"[parameters.{name}] {error}") from error
    for name, value in spec.fixed.items():
        try:
            known[name].check(value)
        except InputError as error:
            raise InputError(f"[fixed] {error}") from error
    for name, tie in spec.tied.items():
        for other in (name, tie.to):
            if known[other].choices:
                raise InputError(f"[tied.{name}] {other} is a choice; only numbers can be tied")
    metrics = {}
    for name in spec.metrics():
        require_known("metric", name, kit.metrics)
        metrics[name] = kit.metrics[name]
    study = Study(spec, family, tuple(axes), _presses(spec, kit, metrics), metrics, kit)
    if spec.sweep.kind == "optimize":
        from taccel_lab.studies.optimise import require_method

        require_method(spec.sweep.method, len(axes))
    else:
        study.points()
    return study


def _presses(spec: StudySpec, kit: Kit, metrics: Mapping[str, Metric]) -> dict[str, Any]:
    """The study's presses with their settings, in the kit's order."""
    needed = {press: name for name, found in metrics.items() for press in found.presses}
    for name in spec.study.presses:
        require_known("press", name, kit.presses)
    chosen = set(spec.study.presses) or set(needed)
    for press, name in needed.items():
        if press not in chosen:
            raise InputError(
                f"metric {name!r} is read from the press {press!r}, which study.presses leaves out"
            )
    presses = {name: press for name, press in kit.presses.items() if name in chosen}
    for name, settings in spec.press.items():
        require_known("press of this study in [press]", name, presses)
        allowed = [item.name for item in dataclasses.fields(presses[name]) if item.name != "name"]
        for key in settings:
            require_known(f"setting in [press.{name}]", key, allowed)
        values = {
            key: _setting(f"[press.{name}] {key}", value, getattr(presses[name], key))
            for key, value in settings.items()
        }
        try:
            presses[name] = dataclasses.replace(presses[name], **values)
        except (InputError, TypeError) as error:
            raise InputError(f"[press.{name}] {error}") from error
    return presses


def _setting(what: str, value: Any, standard: Any) -> Any:
    """``value``, lists as tuples, if it is of the kind that the standard press has there."""
    if isinstance(standard, tuple) and isinstance(value, list):
        return tuple(_setting(what, item, standard[0]) for item in value)
    kinds = (int, float) if isinstance(standard, float) else (type(standard),)
    if type(value) not in kinds:
        raise InputError(f"{what} = {shown(value)}; something like {standard!r} is allowed")
    return value
