# SPDX-License-Identifier: Apache-2.0
"""The study file: what is swept, pressed and measured, as read from TOML.

Only the form is checked here; ``taccel_lab.studies.spec.study`` checks the names and bounds against
the catalogue.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    Field,
    StrictStr,
    StringConstraints,
    ValidationError,
    field_validator,
    model_validator,
)

from taccel_lab.errors import InputError
from taccel_lab.files.documents import first_repeated
from taccel_lab.files.regular_file import shown
from taccel_lab.files.strict_model import Flag, Number, StrictModel, Whole, describe_errors
from taccel_lab.presses import Accuracy
from taccel_lab.profile.schema import Name
from taccel_lab.studies.metrics.design_point import LOAD_N
from taccel_lab.studies.spec.study_table import Swept, study_table

MAX_DESIGNS = 10_000
"""Largest study: more is a slip of the keyboard rather than a plan."""
PlainName = Annotated[str, StringConstraints(pattern=r"^[A-Za-z][A-Za-z0-9_]*$", max_length=80)]
MetricName = Annotated[
    str,
    StringConstraints(pattern=r"^[A-Za-z][A-Za-z0-9_]*(\[[^\[\]]+\])?$", max_length=160),
]
"""A metric, with the indenter and the load behind it where a study has several."""


def _check_value(value: Any) -> int | float | str:
    if isinstance(value, str):
        return value
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise ValueError("must be a finite number or a text")
    return value


Value = Annotated[Any, AfterValidator(_check_value)]
"""A parameter's value: a finite number or a text."""


Load = Annotated[Number, Field(gt=0, le=1000)]
"""A force [N]."""
UNIT_SPREAD_PERCENT = 13.0
"""Two pairs of nominally equal gels differed by 12 and 24 % in stiffness: a standard deviation of
sqrt((12^2 + 24^2) / 2) / sqrt(2) percent of one unit."""


class StudyBlock(StrictModel):
    """What the study is about."""

    name: Name
    sensor: Name
    """Family of the catalogue, or the folder of a profile, beside the study file if it is not
    absolute."""
    metrics: list[MetricName] = Field(default_factory=list)
    """Columns of the table; the objective's and the constraints' are added."""
    presses: list[PlainName] = Field(default_factory=list)
    """Standard presses. Default: those that the metrics read."""
    load_n: Load = LOAD_N
    """Normal load at which figures are read, where they are read at a load."""
    loads_n: list[Load] = Field(default_factory=list)
    """Several of them in place of one."""
    accuracy: Accuracy = Accuracy.DEFAULT
    """Accuracy of the presses, as of ``taccel-lab press``."""
    unit_spread_percent: Number = Field(default=UNIT_SPREAD_PERCENT, ge=0, le=100)
    """Standard deviation of the stiffness from unit to unit, for the intervals."""
    seed: Whole = Field(default=0, ge=0, lt=2**31)
    """Seed of random draws and of the optimiser."""

    @field_validator("metrics", "presses", "loads_n")
    @classmethod
    def _check_repeats(cls, names: list[Any]) -> list[Any]:
        repeated = first_repeated(names)
        if repeated is not None:
            raise ValueError(f"named twice: {repeated}")
        return names

    @model_validator(mode="after")
    def _check_loads(self) -> StudyBlock:
        if self.loads_n and "load_n" in self.model_fields_set:
            raise ValueError("give either load_n or loads_n, not both")
        return self

    @property
    def loads(self) -> tuple[float, ...]:
        """Loads at which figures are read [N]."""
        return tuple(self.loads_n) or (self.load_n,)


class ParameterRange(StrictModel):
    """Values of one parameter: a list, plain or as ``values``, or a range."""

    values: list[Value] | None = None
    min: Number | None = None
    max: Number | None = None
    count: Whole | None = Field(default=None, ge=1, le=MAX_DESIGNS)
    """Values of a range in a grid."""
    scale: Literal["linear", "log"] = "linear"
    """How a range is divided: equal steps, or equal ratios."""
    start: Number | None = None
    """Where an optimiser begins. Default: the family's default, or the middle."""

    @model_validator(mode="before")
    @classmethod
    def _from_list(cls, given: Any) -> Any:
        """Take a plain list for values."""
        return {"values": given} if isinstance(given, list) else given

    @model_validator(mode="after")
    def _check_form(self) -> ParameterRange:
        if self.values is not None:
            extra = [n for n in ("min", "max", "count", "start") if getattr(self, n) is not None]
            if extra or self.scale != "linear":
                raise ValueError("give either values, or min and max, not both")
            if not self.values:
                raise ValueError("values is empty; give at least one")
            if len(set(self.values)) < len(self.values):
                raise ValueError(f"values repeat themselves: {shown(self.values)}")
            return self
        if self.min is None or self.max is None:
            raise ValueError("give values = [...], or min and max (and count for a grid)")
        if not self.min < self.max:
            raise ValueError(f"min {self.min:g} must be below max {self.max:g}")
        if self.scale == "log" and self.min <= 0:
            raise ValueError(f"a log scale needs min above 0, got {self.min:g}")
        if self.start is not None and not self.min <= self.start <= self.max:
            raise ValueError(f"start {self.start:g} lies outside [{self.min:g}, {self.max:g}]")
        return self


class Tie(StrictModel):
    """A parameter that follows a swept one: factor * x^power + offset."""

    to: PlainName
    factor: Number = 1.0
    power: Number = 1.0
    offset: Number = 0.0


LOCAL = ("LD_SLSQP", "LN_COBYLA")
"""NLopt's methods, for one objective; Optuna's are for several."""


class Sweep(StrictModel):
    """How designs are chosen."""

    kind: Literal["grid", "random", "optimize"]
    count: Whole | None = Field(default=None, ge=1, le=MAX_DESIGNS)
    """Designs of a random sweep, or the most that an optimiser may try."""
    sampler: Literal["latin-hypercube", "sobol"] = "latin-hypercube"
    """Sampler of a random sweep."""
    method: Literal["LD_SLSQP", "LN_COBYLA", "GP", "TPE", "NSGA2"] = "LN_COBYLA"
    """Optimiser: NLopt's SLSQP or COBYLA, or one of Optuna's. Where a study does not say,
    ``make_study`` takes SLSQP for figures that are smooth."""
    tolerance: Number = Field(default=1e-3, gt=0, lt=1)
    """Step, as a part of each parameter's range, at which NLopt is done."""

    @model_validator(mode="after")
    def _check_kind(self) -> Sweep:
        if self.kind == "grid" and self.count is not None:
            raise ValueError("a grid has as many designs as its values make; leave out count")
        if self.kind != "grid" and self.count is None:
            raise ValueError(f"kind = {self.kind!r} needs count, the number of designs")
        given = self.model_fields_set
        for name, kind in (
            ("sampler", "random"),
            ("method", "optimize"),
            ("tolerance", "optimize"),
        ):
            if name in given and self.kind != kind:
                raise ValueError(f"{name} belongs to kind = {kind!r}, not {self.kind!r}")
        if "tolerance" in given and self.method not in LOCAL:
            raise ValueError(f"tolerance belongs to {' and '.join(LOCAL)}, not {self.method!r}")
        return self


class Objective(StrictModel):
    """What makes a design better."""

    minimize: MetricName | None = None
    maximize: MetricName | None = None

    @model_validator(mode="after")
    def _check_one(self) -> Objective:
        if (self.minimize is None) == (self.maximize is None):
            raise ValueError("give either minimize or maximize, with the name of a metric")
        return self

    @property
    def metric(self) -> str:
        return self.minimize or self.maximize or ""

    @property
    def sign(self) -> float:
        """1 where less is better, -1 where more is."""
        return 1.0 if self.minimize is not None else -1.0

    def cost(self, figures: Mapping[str, float | None]) -> float:
        """Less is better; infinite without a figure."""
        value = figures.get(self.metric)
        return math.inf if value is None else self.sign * value

    def text(self) -> str:
        """Words such as ``least blur``."""
        return ("least " if self.sign > 0 else "greatest ") + self.metric


@dataclass(frozen=True)
class Bound:
    """One side of a constraint."""

    metric: str
    side: Literal["max", "min"]
    limit: float

    @property
    def sign(self) -> float:
        """1 where values above the limit break it, -1 where those below do."""
        return 1.0 if self.side == "max" else -1.0

    def beyond(self, value: float) -> float:
        """How far ``value`` lies outside, in the metric's unit; at most 0 inside."""
        return self.sign * (value - self.limit)


class Constraint(StrictModel):
    """Bounds that a design has to keep."""

    metric: MetricName
    min: Number | None = None
    max: Number | None = None

    @model_validator(mode="after")
    def _check_bounds(self) -> Constraint:
        if self.min is None and self.max is None:
            raise ValueError("give min, max or both")
        if self.min is not None and self.max is not None and self.min > self.max:
            raise ValueError(f"unreachable: min {self.min:g} is above max {self.max:g}")
        return self

    @property
    def bounds(self) -> list[Bound]:
        """Its sides, the lower one first."""
        limits: tuple[tuple[Literal["max", "min"], float | None], ...]
        limits = ("min", self.min), ("max", self.max)
        return [Bound(self.metric, side, limit) for side, limit in limits if limit is not None]

    def violation(self, value: float) -> float:
        """How far ``value`` lies outside, in the metric's unit; 0 inside."""
        return max(0.0, *(bound.beyond(value) for bound in self.bounds))

    def text(self) -> str:
        """Words such as ``stiffness_n_per_mm from 1 to 2``."""
        if self.min is None:
            return f"{self.metric} at most {self.max:g}"
        if self.max is None:
            return f"{self.metric} at least {self.min:g}"
        return f"{self.metric} from {self.min:g} to {self.max:g}"


class StudyOutput(StrictModel):
    """What is kept of each design besides its row."""

    meshes: Flag = True
    """The gel's mesh, as VTU."""
    pictures: Flag = True
    """Contact pressures and previews, as PNG."""
    records: Flag = True
    """Curves and fields of each press, as NPZ."""
    step: Flag = False
    """The gel pad as a STEP file."""


class StudyRun(StrictModel):
    """Where it is computed; the command line overrides."""

    device: StrictStr = "cpu"
    processes: Whole | None = Field(default=None, ge=1, le=1024)
    """One a core when left out; one for a GPU."""


class StudySpec(StrictModel):
    """A whole study file."""

    study: StudyBlock
    parameters: dict[PlainName, ParameterRange] = Field(default_factory=dict)
    fixed: dict[PlainName, Value] = Field(default_factory=dict)
    """Parameters other than the family's defaults, the same in all designs."""
    tied: dict[PlainName, Tie] = Field(default_factory=dict)
    sweep: Sweep = Field(default_factory=lambda: Sweep(kind="grid"))
    objective: Objective | None = None
    objectives: list[Objective] = Field(default_factory=list)
    """Several of them for an optimiser; the first one ranks designs."""
    constraints: list[Constraint] = Field(default_factory=list)
    press: dict[PlainName, dict[PlainName, Any]] = Field(default_factory=dict)
    """Settings of single presses other than the standard ones."""
    output: StudyOutput = StudyOutput()
    run: StudyRun = StudyRun()

    @model_validator(mode="after")
    def _check_whole(self) -> StudySpec:
        if not self.parameters:
            raise ValueError(
                "there is nothing to sweep: give [parameters] NAME = [3, 4, 5], or --set NAME=3,4,5"
            )
        for one, two in (("fixed", "parameters"), ("tied", "parameters"), ("tied", "fixed")):
            both = sorted(set(getattr(self, one)) & set(getattr(self, two)))
            if both:
                raise ValueError(f"{', '.join(both)} stands in [{one}] and in [{two}]")
        for name, tie in self.tied.items():
            if tie.to not in self.parameters:
                raise ValueError(
                    f"tied.{name}.to: {tie.to!r} is not swept; "
                    f"swept are {', '.join(self.parameters)}"
                )
        self._check_ranges()
        wanted = [c.metric for c in self.constraints]
        if len(set(wanted)) < len(wanted):
            raise ValueError("two constraints name one metric; give its min and max together")
        if not self.metrics():
            raise ValueError("no metrics: name at least one in study.metrics")
        if self.objective is not None and self.objectives:
            raise ValueError("give either [objective] or [[objectives]], not both")
        if self.sweep.kind == "optimize" and not self.goals:
            raise ValueError("kind = 'optimize' needs [objective] minimize or maximize = a metric")
        if len({goal.metric for goal in self.goals}) < len(self.goals):
            raise ValueError("two objectives name one metric")
        if len(self.goals) > 1 and self.sweep.method in LOCAL:
            raise ValueError(
                "several objectives need kind = 'optimize' and method GP, TPE or NSGA2"
            )
        if len(self.goals) == 1 and self.sweep.method not in LOCAL:
            raise ValueError(
                f"method {self.sweep.method!r} takes several objectives; one is for "
                f"{' or '.join(LOCAL)}: leave out sweep.method"
            )
        return self

    @property
    def goals(self) -> list[Objective]:
        """All objectives, the one that ranks designs first."""
        return [self.objective] if self.objective is not None else list(self.objectives)

    def _check_ranges(self) -> None:
        kind = self.sweep.kind
        for name, axis in self.parameters.items():
            if kind == "grid" and axis.values is None and axis.count is None:
                raise ValueError(f"parameters.{name}: a range in a grid needs count")
            if kind != "grid" and axis.count is not None:
                raise ValueError(
                    f"parameters.{name}: count belongs to a grid; the sweep has its own"
                )
            if kind == "optimize" and axis.values is not None:
                raise ValueError(f"parameters.{name}: an optimiser needs min and max, not values")
            if kind != "optimize" and axis.start is not None:
                raise ValueError(f"parameters.{name}: start belongs to kind = 'optimize'")

    def metrics(self) -> tuple[str, ...]:
        """Names of all metrics that the study reads, the listed ones first."""
        names = [*self.study.metrics, *(goal.metric for goal in self.goals)]
        names += [constraint.metric for constraint in self.constraints]
        return tuple(dict.fromkeys(names))


def load_spec(path: Path | str, swept: Swept | None = None) -> StudySpec:
    """Read a study file, with ``swept`` values in place of its own.

    Raises InputError with every wrong key: what is there, what is allowed.
    """
    path = Path(path)
    spec = spec_of(study_table(path, swept), str(path))
    sensor = spec.study.sensor
    if "/" in sensor:
        sensor = os.path.abspath(path.parent / sensor)
    study = spec.study.model_copy(update={"sensor": sensor})
    return spec.model_copy(update={"study": study})


def spec_of(table: dict[str, Any], source: str = "study") -> StudySpec:
    """The study in a table as of TOML; ``source`` names it in messages."""
    try:
        return StudySpec.model_validate(table)
    except ValidationError as error:
        lines = describe_errors(error, StudySpec).splitlines()
        said = [f"{source}: {line.removeprefix('StudySpec: ')}" for line in lines]
        raise InputError("\n".join(said)) from None
