# SPDX-License-Identifier: Apache-2.0
"""Parameters with bounds, unit and source: the fields of frozen dataclasses that users may set.

``parameter(...)`` declares a dataclass field; ``ParameterSet`` checks every value when an instance
is made, lists what can be set and reads overrides written as ``name=value``. A parameter is
declared once: ``restated(...)`` takes it over, from a base class or from the part that a sensor
builds, with another default and other bounds where there is reason to. A set of ``groups`` has the
parameters of all of them and hands each group out with its values.
"""

from __future__ import annotations

import dataclasses
import math
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar, Self, TypeVar

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.files.regular_file import shown
from taccel_lab.files.table_file import number
from taccel_lab.guards import parse_words, require_known

_KEY = "parameter"
_SPELLED = {
    "young modulus": "Young's modulus",
    "poisson ratio": "Poisson's ratio",
    "led": "LED",
    "focal": "focal length",
    "index": "refractive index",
    "ambient": "ambient light",
}
"""Words of names, as people say them."""
MOST_EACH = 64
"""Values of one parameter at most."""
_Group = TypeVar("_Group", bound="ParameterSet")


@dataclass(frozen=True)
class Parameter:
    """What a user has to know to set one value."""

    name: str
    default: Any
    unit: str
    description: str
    source: str
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()
    zero_means: str = ""
    """When not empty, 0 is allowed besides [minimum, maximum] and means this."""
    pattern: str = ""
    """Text that is allowed besides the choices, as a regular expression; see ``pattern_words``."""
    pattern_words: str = ""
    each: str = ""
    """What there may be several of, such as ``LED``: the value is then one for all of them, or a
    tuple of one each. Empty where there is one only."""
    group: str = ""
    """Heading under which it is listed: the ``parameter_group`` of the class that declares it."""

    def allowed(self) -> str:
        """The allowed values in words."""
        unit = f" {self.unit}" if self.unit and self.unit != "1" else ""
        each = f"; one for each {self.each} with commas" if self.each else ""
        if self.choices:
            also = f", or {self.pattern_words}" if self.pattern else ""
            return "one of " + ", ".join(self.choices) + also + each
        text = f"{self.minimum:g} to {self.maximum:g}{unit}"
        return (f"0 ({self.zero_means}) or {text}" if self.zero_means else text) + each

    @property
    def whole(self) -> bool:
        """Whether values are whole numbers."""
        return isinstance(self.default, int)

    def worded(self, value: Any) -> str:
        """The value as one says it: ``thickness 2 mm``, ``Shore 00 45``, ``rim fillet``."""
        text = value_text(value, 4)
        if self.unit.startswith("Shore"):
            return f"{self.unit} {text}"
        unit = "" if self.unit in ("", "1") else f" {self.unit}"
        return f"{self.words} {text}{unit}"

    @property
    def words(self) -> str:
        """The name as one says it, without its unit: ``thickness``, ``scale y``, ``Shore A``."""
        if self.unit.startswith("Shore"):
            return self.unit
        # As names have units: mm_per_px, per_mm, kg_m3.
        unit = self.unit.lower()
        endings = {unit.replace("/", "_per_").removeprefix("1_"), unit.replace("/", "_")} - {""}
        name = self.name
        for ending in endings:
            name = re.sub(rf"^{re.escape(ending)}(?=_|$)", "scale", name)
            name = re.sub(rf"_{re.escape(ending)}(?=_|$)", "", name)
        words = name.replace("_", " ")
        for ours, theirs in _SPELLED.items():
            words = re.sub(rf"\b{ours}\b", theirs, words)
        return words

    @property
    def label(self) -> str:
        """The name as one says it, with its unit: ``Young's modulus [MPa]``, ``Shore A``."""
        bare = self.unit in ("", "1") or self.unit.startswith("Shore")
        return self.words + ("" if bare else f" [{self.unit}]")

    def check(self, value: Any) -> Any:
        """Return ``value`` as the parameter's own type; raise InputError when it is not allowed.

        Several values, a tuple or list, become a tuple where the parameter takes one for ``each``.
        """
        if self.each and isinstance(value, (tuple, list)):
            if not 1 <= len(value) <= MOST_EACH:
                raise InputError(
                    f"{self.name} has {len(value)} values; allowed: 1 to {MOST_EACH}, one for each "
                    f"{self.each}"
                )
            found = tuple(self._check_one(one) for one in value)
            return found[0] if len(found) == 1 else found
        return self._check_one(value)

    def _check_one(self, value: Any) -> Any:
        if self.choices:
            like = self.pattern and isinstance(value, str) and re.fullmatch(self.pattern, value)
            if value not in self.choices and not like:
                raise InputError(
                    f"{self.name} = {shown(value)} is not allowed; use {self.allowed()}"
                )
            return value
        checked = self._number(value)
        minimum, maximum = float(self.minimum or 0.0), float(self.maximum or 0.0)
        if self.zero_means and checked == 0:
            return checked
        if not minimum <= checked <= maximum:
            side = "below" if checked < minimum else "above"
            raise InputError(
                f"{self.name} = {checked:g} is {side} its bound; allowed: {self.allowed()}"
            )
        return checked

    def _number(self, value: Any) -> int | float:
        whole = self.whole
        is_number = isinstance(value, (int, float, np.number)) and not isinstance(value, bool)
        # `float` of a whole number of 400 digits fails; no bound is that far.
        is_finite = is_number and abs(value) <= sys.float_info.max
        found = float(value) if is_finite else math.nan
        if math.isnan(found) or (whole and found % 1):
            wanted = "a whole number" if whole else "a number"
            raise InputError(
                f"{self.name} = {shown(value)} is not {wanted}; allowed: {self.allowed()}"
            )
        return int(found) if whole else found


def parameter(
    default: float | int | str | tuple[float | str, ...],
    *,
    unit: str = "1",
    description: str,
    source: str,
    minimum: float | None = None,
    maximum: float | None = None,
    choices: Sequence[str] = (),
    zero_means: str = "",
    pattern: tuple[str, str] = ("", ""),
    each: str = "",
) -> Any:
    """Declare a dataclass field that carries its bounds, unit and source; ``pattern``: a regular
    expression of further choices, and what that is in words."""
    if not choices and (minimum is None or maximum is None):
        raise TypeError("a numeric parameter needs a minimum and a maximum")
    details = {
        "unit": unit,
        "description": description,
        "source": source,
        "minimum": minimum,
        "maximum": maximum,
        "choices": tuple(choices),
        "zero_means": zero_means,
        "pattern": pattern[0],
        "pattern_words": pattern[1],
        "each": each,
    }
    return dataclasses.field(default=default, metadata={_KEY: details})


@dataclass(frozen=True)
class _Restated:
    """What ``restated`` was given, until the class and the name are known."""

    default: float | int | str | tuple[float | str, ...] | None
    of: type[ParameterSet] | None
    changes: dict[str, Any]

    def field(self, cls: type[ParameterSet], name: str) -> Any:
        """The field ``name`` of ``cls``."""
        known = self.of.__dict__["__dataclass_fields__"] if self.of else _inherited_fields(cls)
        declared = known.get(name)
        if declared is None:
            where = self.of.__name__ if self.of else "no base class"
            raise TypeError(f"{cls.__name__}.{name} is restated, but {where} has that parameter")
        details = {**declared.metadata[_KEY], **self.changes}
        if self.of is not None:
            details["group"] = vars(cls).get("parameter_group", "")
            self._check(declared.metadata[_KEY], name)
        default = declared.default if self.default is None else self.default
        return dataclasses.field(default=default, metadata={_KEY: details})

    def _check(self, declared: dict[str, Any], name: str) -> None:
        """Bounds of a part say what can be built."""
        part = self.of.__name__ if self.of else ""
        if self.default is not None and "source" not in self.changes:
            raise TypeError(f"another default of {part}.{name} needs a source")
        low, high = declared["minimum"], declared["maximum"]
        if low is not None and not (
            low <= self.changes.get("minimum", low) and self.changes.get("maximum", high) <= high
        ):
            raise TypeError(f"bounds of {name} are wider than those of {part}")


def restated(
    default: float | int | str | tuple[float | str, ...] | None = None,
    *,
    of: type[ParameterSet] | None = None,
    source: str | None = None,
    minimum: float | None = None,
    maximum: float | None = None,
    description: str | None = None,
    zero_means: str | None = None,
) -> Any:
    """Declare a parameter again, with another default and the source of that.

    What is left out (unit, bounds, description) stays as it is declared: by a base class or one of
    ``groups``, or by the part ``of``. Bounds of a part may only be narrower: the part knows what
    can be built, a sensor what its other parts leave room for.
    """
    given = {
        "source": source,
        "minimum": minimum,
        "maximum": maximum,
        "description": description,
        "zero_means": zero_means,
    }
    changes = {key: value for key, value in given.items() if value is not None}
    return _Restated(default, of, changes)


@cache
def _declared(fields: tuple[dataclasses.Field[Any], ...]) -> dict[str, Parameter]:
    """Parameters among the fields of a class, made once: every design asks for them many times."""
    return {
        f.name: Parameter(name=f.name, default=f.default, **f.metadata[_KEY])
        for f in fields
        if _KEY in f.metadata
    }


class ParameterSet:
    """Base of frozen dataclasses whose fields are declared with ``parameter``."""

    parameter_group: ClassVar[str] = ""
    """Heading of the parameters that a class declares itself, not those that it inherits."""
    groups: ClassVar[tuple[type[ParameterSet], ...]] = ()
    """Sets whose parameters this one has, too, under the same names; see ``group``."""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        for part in vars(cls).get("groups", ()):
            for f in dataclasses.fields(part):  # type: ignore[arg-type]
                cls.__annotations__.setdefault(f.name, f.type)
                if f.name not in vars(cls):
                    copied = dataclasses.field(default=f.default, metadata=dict(f.metadata))
                    setattr(cls, f.name, copied)
        group = vars(cls).get("parameter_group", "")
        for name, value in list(vars(cls).items()):
            if isinstance(value, _Restated):
                setattr(cls, name, value.field(cls, name))
            elif isinstance(value, dataclasses.Field) and _KEY in value.metadata:
                value.metadata[_KEY].setdefault("group", group)

    @classmethod
    def parameters(cls) -> dict[str, Parameter]:
        """What can be set, by name, in the order of declaration."""
        return dict(_declared(dataclasses.fields(cls)))  # type: ignore[arg-type]

    def __post_init__(self) -> None:
        for name, spec in self.parameters().items():
            object.__setattr__(self, name, spec.check(getattr(self, name)))

    def group(self, kind: type[_Group]) -> _Group:
        """One of ``groups`` with the values of this set, whose bounds are those that count."""
        found = object.__new__(kind)
        for name in kind.parameters():
            object.__setattr__(found, name, getattr(self, name))
        return found

    def part(self, kind: type[_Group], **own: Any) -> _Group:
        """A part with the values of this set for all that both call the same, ``own`` for others.

        Raises InputError for values that it cannot be built of.
        """
        known = self.parameters()
        common = {name: getattr(self, name) for name in kind.parameters() if name in known}
        return kind(**common | own)

    def require(
        self, name: str, why: str, *, low: float = -math.inf, high: float = math.inf, also: str = ""
    ) -> None:
        """Refuse a value that other parameters leave no room for; ``why`` says what it breaks, and
        ``also`` what is allowed besides. Raises InputError with the value and the bound."""
        value, spec = getattr(self, name), self.parameters()[name]
        if low <= value <= high or (spec.zero_means and value == 0):
            return
        bound = f"at least {low:g}" if value < low else f"up to {high:g}"
        raise InputError(f"{name} = {value:g} {why}; allowed: {bound} {spec.unit}{also}")

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Self:
        """A set with these values and the defaults of others; unknown names raise InputError."""
        for name in values:
            require_known("parameter", name, cls.parameters(), "taccel-lab sensors show SENSOR")
        return cls(**values)

    def values(self) -> dict[str, Any]:
        """Name -> value; several values as a list, as in files."""
        return {name: _listed(getattr(self, name)) for name in self.parameters()}

    def describe(self) -> dict[str, dict[str, Any]]:
        """Name -> value, default, bounds, unit, description and source, ready for JSON."""
        return {
            name: {
                "value": _listed(getattr(self, name)),
                "default": _listed(spec.default),
                "minimum": spec.minimum,
                "maximum": spec.maximum,
                "choices": list(spec.choices) or None,
                "zero_means": spec.zero_means or None,
                "each": spec.each or None,
                "unit": spec.unit,
                "group": spec.group,
                "description": spec.description,
                "source": spec.source if getattr(self, name) == spec.default else "set by the user",
            }
            for name, spec in self.parameters().items()
        }


def _inherited_fields(cls: type[ParameterSet]) -> dict[str, Any]:
    """Fields of the base classes and groups, the nearest one's where several have a name."""
    found: dict[str, Any] = {}
    for base in (*vars(cls).get("groups", ()), *cls.__mro__[1:]):
        found = {**vars(base).get("__dataclass_fields__", {}), **found}
    return found


def parse_overrides(items: Sequence[str]) -> dict[str, Any]:
    """Read ``name=value`` words into a dict, see ``parse_value``; InputError as ``parse_words``."""
    return {name: parse_value(text) for name, text in parse_words(items).items()}


def parse_value(text: str) -> float | str | list[float | str]:
    """The number or text that ``text`` is, or the list of those between its commas."""
    if "," in text:
        return [_one_value(part.strip()) for part in text.split(",")]
    return _one_value(text)


def value_text(value: Any, digits: int = 9) -> str:
    """Text as ``parse_value`` reads it: ``2.5``, ``fillet``, ``-90,30,150``."""
    if isinstance(value, (tuple, list)):
        return ",".join(value_text(one, digits) for one in value)
    return f"{value:.{digits}g}" if isinstance(value, float) else f"{value}"


def _one_value(text: str) -> float | str:
    try:
        return number(text)
    except ValueError:
        return text


def _listed(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value
