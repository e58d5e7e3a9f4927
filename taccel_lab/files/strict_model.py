# SPDX-License-Identifier: Apache-2.0
"""Contents of files as frozen models: what is written is what is meant, or is rejected by name."""

from __future__ import annotations

from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Self, Union, get_args, get_origin

import numpy as np
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    StrictBool,
    StrictFloat,
    StrictInt,
    StrictStr,
    ValidationError,
)

from taccel_lab.errors import InputError
from taccel_lab.files.documents import read_toml
from taccel_lab.files.regular_file import shown
from taccel_lab.guards import nearest, unknown
from taccel_lab.printable import printable


def _plain_int(value: object) -> object:
    return int(value) if isinstance(value, np.integer) else value


Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
"""A finite number, written as one: neither "0.5" nor true."""
Whole = Annotated[StrictInt, BeforeValidator(_plain_int)]
"""A whole number, written as one: neither "3" nor true nor 3.0; NumPy's become Python's."""
Flag = StrictBool
"""true or false, and neither 1 nor "yes"."""
Scalar = StrictBool | StrictInt | StrictFloat | StrictStr

_WORDS = {
    "tuple_type": "a list in square brackets is needed",
    "list_type": "a list is needed, of [[tables]] or in square brackets",
}
"""Messages in place of pydantic's, for those who write TOML."""
MAX_FAULTS = 20
"""Faults of one file that a message lists."""


class StrictModel(BaseModel):
    """Immutable, without unknown keys, NaN or infinity."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @classmethod
    def checked(cls, table: object, source: str) -> Self:
        """The model of a table; InputError with a line a fault, each begun with ``source``."""
        try:
            return cls.model_validate(table)
        except ValidationError as error:
            lines = describe_errors(error, cls).splitlines()
            raise InputError("\n".join(f"{source}: {line}" for line in lines)) from None

    @classmethod
    def read(cls, path: Path) -> Self:
        """The model of a TOML file; InputError names the file, each wrong key, what was found."""
        return cls.checked(read_toml(path), str(path))

    def replace(self, **changes: Any) -> Self:
        """Return a copy with some fields changed, checked like a new one."""
        values = {name: getattr(self, name) for name in type(self).model_fields}
        return type(self)(**{**values, **changes})


def describe_errors(error: ValidationError, model: type[BaseModel]) -> str:
    """One readable line per wrong key: its path, what was found and what is allowed; the keys of a
    kind of table once."""
    lines: list[str] = []
    named: set[type[BaseModel]] = set()
    faults = error.errors(include_url=False)
    for item in faults[:MAX_FAULTS]:
        path = ".".join(map(printable, item["loc"])) or model.__name__
        message = item["msg"].removeprefix("Value error, ")
        message = message[:1].lower() + message[1:]
        message = _WORDS.get(item["type"], message)
        if item["type"] == "extra_forbidden":
            owner = _model_at(model, item["loc"][:-1])
            every = [] if owner is None else list(owner.model_fields)
            keys = [] if owner in named else every
            named |= set() if owner is None else {owner}
            keys = sorted(keys) if len(item["loc"]) == 1 else keys
            key = str(item["loc"][-1])
            message = "unknown key" + (
                unknown(key, keys, they_are="allowed") if keys else nearest(key, every)
            )
        elif item["type"] != "missing" and not isinstance(item["input"], (dict, BaseModel)):
            message += f" (found {shown(item['input'])})"
        lines.append(f"{path}: {message}")
    if faults[MAX_FAULTS:]:
        lines.append(f"{model.__name__}: and {len(faults) - MAX_FAULTS} more faults")
    return "\n".join(lines)


def _model_at(model: type[BaseModel], path: tuple[int | str, ...]) -> type[BaseModel] | None:
    """The model of a table inside another one, by keys and places in lists; None where that is not
    known, as of one of several."""
    kind: Any = model
    for step in path:
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            field = kind.model_fields.get(str(step))
            kind = None if field is None else field.annotation
        elif get_origin(kind) in (list, tuple, dict):
            kind = get_args(kind)[-1 if get_origin(kind) is dict else 0]
        else:
            return None
        models = [part for part in get_args(kind) if part is not type(None)]
        if get_origin(kind) in (Union, UnionType) and len(models) == 1:
            kind = models[0]
    return kind if isinstance(kind, type) and issubclass(kind, BaseModel) else None
