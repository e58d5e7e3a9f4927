# SPDX-License-Identifier: Apache-2.0
"""Words that mean the same for all commands: which one, --version, --quiet, --device auto; and
what is wrong with a value, in words, whichever option it stands behind."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin

from taccel_lab.errors import InputError
from taccel_lab.guards import nearest, unknown

if TYPE_CHECKING:
    from tyro.constructors import (
        ConstructorRegistry,
        PrimitiveConstructorSpec,
        PrimitiveTypeInfo,
    )


def common_words(words: Sequence[str]) -> tuple[list[str], bool]:
    """The words without --quiet, and whether it was there; the device that ``auto`` stands for put
    in its place: the first GPU, or the CPU where there is none."""
    left = [word for word in words if word != "--quiet"]
    for i, word in enumerate(left):
        if word == "auto" and i > 0 and left[i - 1] == "--device":
            left[i] = _best_device()
        elif word == "--device=auto":
            left[i] = f"--device={_best_device()}"
    return left, len(left) < len(words)


def _best_device() -> str:
    import warp as wp

    from taccel_lab.processes.start_warp import start_warp

    start_warp()
    return "cuda:0" if wp.is_cuda_available() else "cpu"


def checked_words(words: Sequence[str], names: Mapping[str, Sequence[str]]) -> list[str]:
    """The words, --help added where a command is still to be chosen.

    ``names``: the commands, and those of each group (none for a plain command). Raises InputError
    for a command that is not there, with or without --help behind it, and says which may be meant;
    --version leaves through SystemExit.
    """
    if not words:
        return ["--help"]
    if words[0] == "--version":
        from taccel_lab.version import __version__

        sys.stdout.write(f"taccel-lab {__version__}\n")
        raise SystemExit(0)
    require_command(words[0], tuple(names), "taccel-lab")
    group = names.get(words[0], ())
    if group:
        if len(words) == 1:
            return [*words, "--help"]
        require_command(words[1], group, f"taccel-lab {words[0]}")
    return list(words)


def require_options(words: Sequence[str], command: type, prefix: str) -> None:
    """Raise InputError for options that ``command``, a dataclass, does not have, and say which may
    be meant. ``words``: those behind the command's name, ``prefix``.

    Said before the words are parsed, which would name only what is then missing.
    """
    left = list(words[: words.index("--")] if "--" in words else words)
    if {"-h", "--help"} & set(left):
        return
    known = tuple(_options(command))
    # An option or a name, not a negative number; what follows = is a value, whatever it is.
    found = [word.partition("=")[0] for word in left if re.match("-+[^\\W\\d]", word)]
    found = [word for word in found if not re.fullmatch("-(inf|infinity|nan)", word, re.IGNORECASE)]
    lines = []
    for word in dict.fromkeys(found):
        if word.startswith("--") and word.replace("_", "-") in known:
            continue
        meant = nearest(word, (*known, *_COMMON))
        if not meant and not word.startswith("--"):
            meant = f"; write a file or folder of that name as ./{word}"
        lines.append(f"{prefix} has no option {word}{meant}")
    if lines:
        raise InputError("\n".join([*lines, f"{prefix} --help lists the options"]))


_COMMON = ("--help", "--quiet")


def _options(command: type) -> Iterator[str]:
    for field in fields(command):
        if isinstance(field.default_factory, type) and is_dataclass(field.default_factory):
            yield from _options(field.default_factory)
            continue
        name = field.name.replace("_", "-").strip("-")
        yield f"--{name}"
        if field.type in ("bool", bool):
            yield f"--no-{name}"


def require_command(word: str, known: Sequence[str], prefix: str) -> None:
    """Raise InputError for a word that names no command of ``prefix``, unless it is an option."""
    if not word.startswith("-") and word not in known:
        more = unknown(word, known, f"{prefix} --help")
        raise InputError(f"{prefix} has no command {word!r}{more}")


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


def parse_choice(word: str, known: Sequence[str]) -> str:
    """``word`` where it is one of ``known``. Raises ValueError that says which may be meant."""
    if word not in known:
        raise ValueError(f"{word!r} is not allowed{unknown(word, known, they_are='allowed')}")
    return word


def values(*, for_completion: bool = False) -> ConstructorRegistry:
    """What lets tyro read options: numbers and tuples of them by ``parse_number``, paths by
    ``parse_path``, choices by ``parse_choice``, and one that may be left out as if it had to be
    given, as nobody writes None. ``for_completion``: a shell is to be told the choices."""
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
    def choice(about: PrimitiveTypeInfo) -> PrimitiveConstructorSpec | None:
        several = about.type_origin is tuple and get_args(about.type)[1:] == (Ellipsis,)
        one = get_args(about.type)[0] if several else about.type
        known = get_args(one)
        if get_origin(one) is not Literal or not all(isinstance(word, str) for word in known):
            return None
        name = "{" + ",".join(known) + "}"

        def read(words: list[str]) -> tuple[str, ...] | str:
            found = tuple(parse_choice(word, known) for word in words)
            return found if several else found[0]

        return PrimitiveConstructorSpec(
            nargs="*" if several else 1,
            metavar=f"[{name} [{name} ...]]" if several else name,
            instance_from_str=read,
            is_instance=lambda value: set(value if several else (value,)) <= set(known),
            str_from_instance=lambda value: [str(one) for one in (value if several else (value,))],
            # tyro's own refusal of a choice names no nearest one.
            choices=known if for_completion else None,
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
