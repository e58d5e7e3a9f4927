# SPDX-License-Identifier: Apache-2.0
"""A study whose names and bounds have been checked against the catalogue, presses and metrics."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from taccel_lab.cad.parameters import Parameter
from taccel_lab.errors import InputError, naming
from taccel_lab.files.atomic_file import content_id
from taccel_lab.files.regular_file import shown
from taccel_lab.guards import require_known
from taccel_lab.presses import PHYSICS, Accuracy
from taccel_lab.presses.bonded_layer import layer_force_n
from taccel_lab.sensors.base import STIFFNESS, FamilyParameters, SensorFamily
from taccel_lab.sensors.registry import known_sensor, sensor_families
from taccel_lab.studies.metrics.base import Metric
from taccel_lab.studies.metrics.design_point import DesignFigures, DesignPoint
from taccel_lab.studies.spec.axis import Axis, axis_of, grid_points, random_points, significant
from taccel_lab.studies.spec.readings import press_of, readings, split_name
from taccel_lab.studies.spec.study_file import Objective, StudySpec, Tie, load_spec
from taccel_lab.studies.spec.study_table import Swept

EVALUATION_VERSION = 5
"""Raised when presses or metrics give other figures for the same design: stored ones are not taken
over then."""


@dataclass(frozen=True)
class Kit:
    """What a study can press and measure, and who does it."""

    presses: Mapping[str, Any]
    """Frozen dataclasses by name; their fields are what ``[press.NAME]`` may set."""
    metrics: Mapping[str, Metric]
    evaluate: Callable[..., list[DesignFigures]]
    """Evaluation as ``evaluate.evaluate_designs``; a function of a module, so that other processes
    find it."""


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
        """Parameters of the family, by name."""
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

    def name_of(self, parameters: Mapping[str, Any]) -> str:
        """A design by its swept values, as people call it: ``thickness 2 mm, Shore 00 45``."""
        return ", ".join(axis.parameter.worded(parameters[axis.name]) for axis in self.axes)

    @property
    def press_keys(self) -> dict[str, str]:
        """Stands for the settings of each press."""
        return {name: content_id(dataclasses.asdict(press)) for name, press in self.presses.items()}

    @property
    def figure_keys(self) -> dict[str, str]:
        """Stands for the settings of the presses that each metric is read from, tool and load."""
        keys, spread = self.press_keys, self.spec.study.unit_spread_percent
        return {
            name: content_id(
                [*(keys[press] for press in metric.presses), metric.indenter, metric.load_n, spread]
            )
            if metric.presses
            else content_id([])
            for name, metric in self.metrics.items()
        }

    def design_id(self, parameters: Mapping[str, Any]) -> str:
        """Hash of all that decides what a design is: the family and every parameter."""
        defaults = {name: spec.default for name, spec in self.parameters.items()}
        return content_id(
            {
                "family": self.family.identity,
                "parameters": {**defaults, **parameters},
                "version": EVALUATION_VERSION,
            }
        )


def _tied_value(tie: Tie, value: float, parameter: Parameter) -> float | int:
    found = tie.factor * float(value) ** tie.power + tie.offset
    return round(found) if isinstance(parameter.default, int) else significant(found)


def read_study(
    path: Path, kit: Kit, accuracy: str | None = None, swept: Swept | None = None
) -> Study:
    """The study of a file, with another accuracy than its own where one is given, and ``swept``
    values in place of its own; InputError names the file and what is wrong in it."""
    with naming(path):
        spec = load_spec(path, swept)
        if accuracy is not None:
            block = spec.study.model_copy(update={"accuracy": Accuracy(accuracy)})
            spec = spec.model_copy(update={"study": block})
        return make_study(spec, kit)


def make_study(spec: StudySpec, kit: Kit) -> Study:
    """Check a study file's names and bounds.

    Raises InputError for an unknown sensor, parameter, press or metric (with the nearest known),
    and for values outside the family's bounds.
    """
    family = known_sensor(spec.study.sensor)
    if family is None:
        require_known("sensor", spec.study.sensor, sensor_families(), "taccel-lab sensors list")
    assert family is not None
    known = family.parameters_type.parameters()
    for table in ("parameters", "fixed", "tied"):
        for name in getattr(spec, table):
            if any(
                word in name.lower() for word in ("hardness", "durometer", "shore_o", "shore_d")
            ):
                raise InputError(
                    f"no parameter {name!r} in [{table}]; a hardness is shore_00 = 55 or "
                    "shore_a = 10, the number alone"
                )
            listed_by = f"taccel-lab sensors show {spec.study.sensor}"
            require_known(f"parameter of {family.name} in [{table}]", name, known, listed_by)
    stiff = [n for n in STIFFNESS if n in {*spec.parameters, *spec.fixed, *spec.tied}]
    if len(stiff) > 1:
        raise InputError(f"{' and '.join(stiff)} are given; the gel has one stiffness")
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
    presses = _presses(spec, kit)
    spec, metrics = _readings(spec, kit, presses)
    aims = [item.metric for item in (*spec.goals, *spec.constraints)]
    sweep = spec.sweep
    if (
        sweep.kind == "optimize"
        and "method" not in sweep.model_fields_set
        and all(metrics[name].smooth for name in aims)
    ):
        spec = spec.model_copy(update={"sweep": sweep.model_copy(update={"method": "LD_SLSQP"})})
    study = Study(spec, family, tuple(axes), presses, metrics, kit)
    designs: list[DesignPoint] = []
    if spec.sweep.kind != "optimize":
        designs = study.points()
    gels = []
    for design in designs:
        with suppress(InputError):  # A design that cannot be is a separate row, with the cause.
            gels.append(family.parameters(design.parameters))
    require_bearable(metrics.values(), presses, gels)
    return study


def _presses(spec: StudySpec, kit: Kit) -> dict[str, Any]:
    """The study's presses with their settings, in the kit's order."""
    for name in spec.study.presses:
        require_known("press", name, kit.presses)
    for name in spec.press:
        require_known("press in [press]", name, kit.presses)
    chosen = set(spec.study.presses or spec.press)
    for name in spec.metrics():
        base, labels = split_name(name)
        require_known("metric", base, kit.metrics, "taccel-lab study --list-metrics")
        metric = kit.metrics[base]
        if not metric.presses or chosen & {*metric.presses, *metric.also}:
            continue
        needed = press_of(metric, labels, kit.presses)
        if spec.study.presses:
            raise InputError(
                f"metric {base!r} is read from the press {needed!r}, which study.presses leaves out"
            )
        chosen.add(str(needed))
    presses = {name: press for name, press in kit.presses.items() if name in chosen}
    for name, press in presses.items():
        if hasattr(press, "physics"):
            presses[name] = dataclasses.replace(press, physics=PHYSICS[spec.study.accuracy])
    for name, settings in spec.press.items():
        require_known("press of this study in [press]", name, presses)
        fixed = ("name", "physics")
        allowed = [f.name for f in dataclasses.fields(presses[name]) if f.name not in fixed]
        for key in settings:
            require_known(f"setting in [press.{name}]", key, allowed)
        values = {
            key: _setting(f"[press.{name}] {key}", value, getattr(presses[name], key))
            for key, value in settings.items()
        }
        # A depth of one kind takes the place of the standard one of the other.
        for given, other in (("depth_mm", "depth_fraction"), ("depth_fraction", "depth_mm")):
            if given in values and other in allowed and other not in values:
                values[other] = 0.0
        if "depth_mm" in values and "depth_limit_mm" in allowed:
            values.setdefault("depth_limit_mm", math.inf)
        try:
            presses[name] = dataclasses.replace(presses[name], **values)
        except (InputError, TypeError) as error:
            raise InputError(f"[press.{name}] {error}") from error
    return presses


def _readings(
    spec: StudySpec, kit: Kit, presses: Mapping[str, Any]
) -> tuple[StudySpec, dict[str, Metric]]:
    """The study's metrics of each indenter and load, and the study file with their full names."""
    found: dict[str, list[str]] = {}
    metrics: dict[str, Metric] = {}
    for name in spec.metrics():
        base, labels = split_name(name)
        made = readings(kit.metrics[base], labels, presses, spec.study.loads)
        metrics |= {metric.name: metric for metric in made}
        found[name] = [metric.name for metric in made]

    def only(name: str, where: str) -> str:
        if len(found[name]) > 1:
            raise InputError(
                f"{where}: {name!r} is {' and '.join(map(repr, found[name]))}; name one"
            )
        return found[name][0]

    goals = []
    for goal in spec.goals:
        side = "minimize" if goal.minimize is not None else "maximize"
        goals.append(Objective(**{side: only(goal.metric, "[objective]")}))
    constraints = [
        item.model_copy(update={"metric": only(item.metric, "[[constraints]]")})
        for item in spec.constraints
    ]
    named = {"objective": None, "objectives": goals, "constraints": constraints}
    return spec.model_copy(update=named), metrics


def _setting(what: str, value: Any, standard: Any) -> Any:
    """``value``, lists as tuples, if it is of the kind that the standard press has there."""
    if isinstance(standard, tuple) and isinstance(value, list):
        return tuple(_setting(what, item, standard[0]) for item in value)
    kinds = (int, float) if isinstance(standard, float) else (type(standard),)
    if type(value) not in kinds:
        raise InputError(f"{what} = {shown(value)}; something like {standard!r} is allowed")
    return value


STIFFENED = 10.0
"""How much larger than by small strains the force of a deep press may be: a load beyond that is
reached by no press."""
_EQUATOR = 0.9
"""Depth, as a part of a ball's radius, at which the closed form ends."""


def require_bearable(
    metrics: Iterable[Metric], presses: Mapping[str, Any], designs: Sequence[FamilyParameters]
) -> None:
    """Refuse a load that none of the designs bears under the ball by which a figure is read.

    Args:
        metrics: Of the study, each of one load and indenter; other tools than balls are not judged.
        presses: By name, as of the study.
        designs: None where an optimiser finds them: nothing is rejected then.

    Raises:
        InputError: Names the load, and about what the press ends at.
    """
    for metric in metrics:
        tool, _, size = (metric.indenter or "").partition(":")
        if not (metric.at_load and designs and tool == "sphere"):
            continue
        press, ends = presses[metric.presses[0]], 0.0
        for design in designs:
            ends = max(ends, _end_n(press, float(size), design))
            if metric.load_n <= STIFFENED * ends:
                break
        else:
            raise InputError(
                f"{metric.name}: no gel of this study bears {metric.load_n:g} N; the press "
                f"{metric.presses[0]} of {metric.indenter} ends at about {ends:.2g} N. Give a "
                "smaller load_n"
            )


def _end_n(press: Any, radius_mm: float, design: FamilyParameters) -> float:
    """Estimate of the force of a press at its full depth [N], of the stiffest layer all through."""
    thickness = design.pad().thickness_mm
    layers = design.layer_materials()
    depth = min(press.full_depth_mm(thickness), _EQUATOR * radius_mm)
    modulus = max(layer.young_modulus_pa for layer in layers)
    nu = max(layer.poisson_ratio for layer in layers)
    return float(layer_force_n("sphere", depth, radius_mm, thickness, nu, modulus))
