# SPDX-License-Identifier: Apache-2.0
"""JSON, TOML and YAML files: what may stand in them is shallow, finite, of a sane size.

Of YAML, keys, lists, texts and numbers are read, as other projects keep their settings; no anchors
and aliases (a few hundred bytes of them stand for gigabytes), no tags, no merged or repeated keys.
Words are what YAML 1.2's core schema takes them for: ``yes``, ``1:30``, ``1_000``, ``.inf`` and
dates are text.
"""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

from taccel_lab.errors import InputError
from taccel_lab.files.regular_file import read_text, shown
from taccel_lab.printable import printable

MAX_DEPTH = 32
"""Most levels of tables and lists in one another; our own files reach 6."""
MAX_VALUES = 250_000
"""Most values in one file: 30,000 presses with all that can be said of them. It bounds the memory
of what is made of a file, and of the messages about its faults."""
_MAX_WHOLE = 2**63
"""Whole numbers have 64 bits, as TOML has it."""
_Place = tuple[Any, Any] | None


def require_plain_values(document: Any, source: str) -> Any:
    """``document``, if nothing in it is too deep, not finite, too large or no text.

    Raises InputError with ``source`` and the key.
    """
    stack: list[tuple[Any, _Place, int]] = [(document, None, 0)]
    count = 0
    while stack:
        value, place, depth = stack.pop()
        if isinstance(value, (dict, list)):
            if depth == MAX_DEPTH:
                raise InputError(
                    f"{source} is nested more than {MAX_DEPTH} deep (at {_path(place)[:60]}...)"
                )
            count += len(value)
            if count > MAX_VALUES:
                raise InputError(f"{source} holds more than {MAX_VALUES:,} values")
            pairs: Iterable[tuple[Any, Any]]
            if isinstance(value, dict):
                for key in value:
                    _require_text(key, source, place)
                pairs = value.items()
            else:
                pairs = enumerate(value)
            stack += [(inner, (place, key), depth + 1) for key, inner in pairs]
        elif isinstance(value, str):
            _require_text(value, source, place)
        elif isinstance(value, float) and not math.isfinite(value):
            raise InputError(
                f"{source}: {_path(place)} is {value}, or too large; a finite number is needed"
            )
        elif isinstance(value, int) and not -_MAX_WHOLE <= value < _MAX_WHOLE:
            raise InputError(
                f"{source}: {_path(place)} is a whole number of {value.bit_length()} bits; "
                "63 are allowed"
            )
    return document


def number_at(document: Any, keys: str, source: str) -> float:
    """The number at ``keys`` (``sensor.pixmm``); InputError when there is none."""
    value = document
    for key in keys.split("."):
        value = value.get(key) if isinstance(value, dict) else None
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        found = "is missing" if value is None else f"is {shown(value)}"
        raise InputError(f"{source}: {keys} {found}; a number is needed")
    return float(value)


def _parsed(
    path: Path | str, parse: Callable[[], Any], fault: str, *errors: type[Exception]
) -> dict[str, Any]:
    """The table that ``parse`` makes of a file; ``errors`` and ValueErrors are a ``fault``."""
    try:
        document = parse()
    except RecursionError:
        raise InputError(f"{path} is nested more than {MAX_DEPTH} deep") from None
    except (ValueError, *errors) as error:
        raise InputError(f"{path} {fault}: {' '.join(str(error).split())}") from None
    if not isinstance(document, dict):
        raise InputError(f"{path} holds {shown(document)}; a table {{...}} of keys is needed")
    return require_plain_values(document, str(path))


def first_repeated(names: Iterable[str]) -> str | None:
    """The first name that stood before; None when each is another."""
    seen = set()
    for name in names:
        if name in seen:
            return name
        seen.add(name)
    return None


def _require_text(value: Any, source: str, place: _Place) -> None:
    if not isinstance(value, str):
        raise InputError(f"{source}: {_path(place)}: the key {shown(value)} is no text")
    try:
        value.encode()
    except UnicodeEncodeError:
        raise InputError(
            f"{source}: {_path(place)}: {shown(value)} holds half a character (a lone surrogate)"
        ) from None


def _path(place: _Place) -> str:
    parts: list[str] = []
    while place is not None:
        place, key = place
        parts.append(printable(key))
    return ".".join(reversed(parts)) or "the file"


JSON_LIMIT_BYTES = 8 << 20
"""Most bytes of a file, as TOML's; the results of a design have some 100 KiB."""
_MAX_DIGITS = 20
_BRACKETS = re.compile(r'"(?:[^"\\]|\\.)*"|[\[\]{}]', flags=re.DOTALL)
"""Brackets, and strings, whose brackets do not count."""


def read_json(path: Path) -> dict[str, Any]:
    """Content of a JSON file that holds an object.

    Raises InputError with the path: no file, too large, no text, no JSON or no object, nested too
    deep, a key that stands twice, numbers that are not finite or too large.
    """
    text = read_text(path, JSON_LIMIT_BYTES, "a JSON file")
    hooks: Any = {"object_pairs_hook": _object, "parse_constant": _constant, "parse_int": _whole}

    def parse() -> Any:
        try:
            return json.loads(text, **hooks)
        except ValueError:
            # From Python 3.14 on the parser goes deeper than older ones, to the fault at the end.
            if _nesting(text) > MAX_DEPTH:
                raise RecursionError from None
            raise

    return _parsed(path, parse, "is not valid JSON")


def _nesting(text: str) -> int:
    """Depth of a JSON text where it is more than allowed; 0 otherwise."""
    depth = 0
    for found in _BRACKETS.finditer(text):
        depth += {"{": 1, "[": 1, "}": -1, "]": -1}.get(found[0], 0)
        if depth > MAX_DEPTH:
            return depth
    return 0


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        twice = shown(first_repeated(name for name, _ in pairs))
        raise ValueError(f"the key {twice} stands twice")
    return found


def _constant(name: str) -> float:
    raise ValueError(f"{name} is no number of JSON")


def _whole(digits: str) -> int:
    if len(digits) > _MAX_DIGITS:
        raise ValueError(f"a whole number of {len(digits)} digits; 64 bits are allowed")
    return int(digits)


TOML_LIMIT_BYTES = 4 << 20
"""A manifest of 14,000 presses; the parser, in Python, reads half a MiB a second."""
_PART = r"""(?:[\w-]+|"[^"\n]*"|'[^'\n]*')[ \t]*"""
_LONG_KEY = re.compile(rf"""(?<![\w"'-])(?:{_PART}\.[ \t]*){{{MAX_DEPTH}}}""")
"""``a.b.c. ...``: the parser's time grows with the square of a key's parts."""
_LONG_NUMBER = re.compile(r"(?<![0-9_])[0-9][0-9_]{999}|0x[0-9A-Fa-f_]{1000}")
"""The parser's memory is a hundred times that of a number's digits."""


def read_toml(path: Path) -> dict[str, Any]:
    """Content of a TOML file.

    Raises InputError with the path: no file, too large, no text, no TOML, nested too deep, numbers
    that are not finite or too large.
    """
    text = read_text(path, TOML_LIMIT_BYTES, "a TOML file")
    if found := _LONG_KEY.search(text):
        raise InputError(
            f"{path} is nested more than {MAX_DEPTH} deep: line {_line(text, found)} has a key of "
            "more parts"
        )
    if found := _LONG_NUMBER.search(text):
        raise InputError(f"{path}: line {_line(text, found)} has a number of 1,000 digits or more")
    return _parsed(path, lambda: tomllib.loads(text), "is not valid TOML")


def _line(text: str, found: re.Match[str]) -> int:
    return text.count("\n", 0, found.start()) + 1


YAML_LIMIT_BYTES = 256 << 10
"""Settings of sensors have a few KiB; the parser reads some 100 KiB a second."""


def read_yaml(path: Path) -> dict[str, Any]:
    """Content of a YAML file that holds one table of keys.

    Raises InputError with the path: no file, too large, no text, no YAML or no table, what is not
    read (see above), nested too deep, numbers that are not finite or too large.
    """
    import yaml

    text = read_text(path, YAML_LIMIT_BYTES, "a YAML file")
    parse = partial(yaml.load, text, _loader())
    return _parsed(path, parse, "cannot be read as YAML", yaml.YAMLError)


def _loader() -> type[Any]:
    """The loader; made here since yaml is imported late."""
    import yaml

    def fault(problem: str, at: Any) -> Exception:
        return yaml.MarkedYAMLError(problem=problem, problem_mark=at.start_mark)

    class Loader(yaml.SafeLoader):
        yaml_implicit_resolvers: ClassVar[dict[str, Any]] = {}

        def compose_node(self, parent: Any, index: Any) -> Any:
            event = self.peek_event()
            if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None) is not None:
                raise fault("anchors and aliases are not read", event)
            if getattr(event, "tag", None) is not None:
                raise fault(f"tags ({shown(event.tag)}) are not read", event)
            return super().compose_node(parent, index)

        def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
            found: dict[Any, Any] = {}
            for key_node, value_node in node.value:
                if not isinstance(key_node, yaml.ScalarNode):
                    raise fault("a list or table as a key is not read", key_node)
                if key_node.value in found:
                    raise fault(f"the key {shown(key_node.value)} stands twice", key_node)
                # Keys are text, whatever they look like.
                found[key_node.value] = self.construct_object(value_node, deep=True)
            return found

    for tag, pattern, first in (
        ("null", r"~|null|Null|NULL|", ["~", "n", "N", ""]),
        ("bool", r"true|True|TRUE|false|False|FALSE", list("tTfF")),
        ("int", r"[-+]?[0-9]+", list("-+0123456789")),
        (
            "float",
            r"[-+]?(?:\.[0-9]+|[0-9]+\.?[0-9]*)(?:[eE][-+]?[0-9]+)?",
            list("-+0123456789."),
        ),
    ):
        name = f"tag:yaml.org,2002:{tag}"
        Loader.add_implicit_resolver(name, re.compile(rf"(?:{pattern})\Z"), first)
    Loader.add_constructor("tag:yaml.org,2002:int", lambda _, node: int(node.value))
    Loader.add_constructor("tag:yaml.org,2002:float", lambda _, node: float(node.value))
    return Loader
