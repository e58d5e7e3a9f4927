# SPDX-License-Identifier: Apache-2.0
"""Values of options: what is wrong with one is said in words, whichever option it stands behind."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

if TYPE_CHECKING:
    from tyro.constructors import (
        ConstructorRegistry,
        PrimitiveConstructorSpec,
        PrimitiveTypeInfo,
    )


def parse_number(word: str, kind: type) -> float | int:
    """``word`` as a finite ``kind``, float or int. Raises ValueError that says how to write it."""
    try:
        value = kind(word)
    except ValueError:
        raise ValueError(f"{word!r} is not a {_NAMES[kind]}{_hint(word, kind)}") from None
    if not math.isfinite(value):
        raise ValueError(f"{word!r} is not allowed, only finite numbers are")
    return value


def parse_path(word: str) -> Path:
    """``word`` as a path. Raises ValueError for an empty one, which would mean this folder, and for
    one with a NUL, which no file has."""
    if not word:
        raise ValueError("an empty name is not allowed; this folder is written .")
    if "\0" in word:
        raise ValueError("a file name has no NUL in it")
    return Path(word)


_NAMES = {float: "number", int: "whole number"}


def _hint(word: str, kind: type) -> str:
    pointed = re.fullmatch(r"([-+]?\d*),(\d+)", word)
    if pointed and kind is float:
        return f"; decimals have a point: {pointed[1] or 0}.{pointed[2]}"
    united = re.fullmatch(r"([-+]?\d+(?:\.\d*)?) ?[^\W\d]+", word)
    return f"; write it without a unit: {united[1]}" if united else ""


def values() -> ConstructorRegistry:
    """What lets tyro read options: numbers and tuples of them by ``parse_number``, paths by
    ``parse_path``, and one that may be left out as if it had to be given, as nobody writes None."""
    from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

    registry = ConstructorRegistry()

    @registry.primitive_rule
    def left_out(about: PrimitiveTypeInfo) -> Any:
        kinds = [kind for kind in get_args(about.type) if kind is not type(None)]
        if len(kinds) != 1 or about.type_origin is tuple:
            return None
        given = ConstructorRegistry.get_primitive_spec(
            PrimitiveTypeInfo.make(kinds[0], about.markers)
        )
        if not isinstance(given, PrimitiveConstructorSpec):
            return given
        return replace(
            given,
            is_instance=lambda value: value is None or given.is_instance(value),
            str_from_instance=lambda value: (
                ["None"] if value is None else given.str_from_instance(value)
            ),
        )

    @registry.primitive_rule
    def path(about: PrimitiveTypeInfo) -> PrimitiveConstructorSpec | None:
        if about.type is not Path:
            return None
        return PrimitiveConstructorSpec(
            nargs=1,
            metavar="PATH",
            instance_from_str=lambda words: parse_path(words[0]),
            is_instance=lambda value: isinstance(value, Path),
            str_from_instance=lambda value: [str(value)],
        )

    @registry.primitive_rule
    def number(about: PrimitiveTypeInfo) -> PrimitiveConstructorSpec | None:
        several = about.type_origin is tuple
        kinds: tuple[Any, ...] = get_args(about.type) if several else (about.type,)
        if set(kinds) not in ({float}, {int}):
            return None
        kind, count = kinds[0], len(kinds)

        def read(words: list[str]) -> tuple[float | int, ...] | float | int:
            found = tuple(parse_number(word, kind) for word in words)
            return found if several else found[0]

        def written(value: Any) -> list[str]:
            return [str(one) for one in (value if several else (value,))]

        return PrimitiveConstructorSpec(
            nargs=count,
            metavar=" ".join([kind.__name__.upper()] * count),
            instance_from_str=read,
            is_instance=lambda value: len(written(value)) == count,
            str_from_instance=written,
        )

    return registry
