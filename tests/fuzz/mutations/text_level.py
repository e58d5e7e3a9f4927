# SPDX-License-Identifier: Apache-2.0
"""Damage to text that keeps to its format: TOML, JSON, YAML, tables, and words with numbers."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import Any

from tests.fuzz.mutations.draw import Draw, Surroundings
from tests.fuzz.mutations.values import (
    KEYS,
    NUMBERS,
    cell_values,
    json_values,
    toml_values,
    yaml_values,
)

_TOML_VALUE = re.compile(r"""(?<=[\w"] = )("[^"\n]*"|[^,{}\[\]\n]+)""")
_TOML_LIST = re.compile(r"(?<= = )\[[^\n]*\]")
_TOML_KEY = re.compile(r"(?m)(?<![\w.])[A-Za-z_][\w]*(?= = )")
_YAML_VALUE = re.compile(r"(?m)(?<=: )[^\n]+")
_YAML_KEY = re.compile(r"(?m)^\s*[\w]+(?=:)")
_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
_PLACE = "\ue000place\ue000"
_STEP_ENTITY = re.compile(r"#\d+\s*=\s*[^;]*;")
_STEP_TYPE = re.compile(r"(?<==)\s*[A-Z_0-9]+(?=\()")
_STEP_REAL = re.compile(r"-?\d+\.\d*(?:E[-+]?\d+)?")
_STEP_REFERENCE = re.compile(r"#\d+")


def _text(data: bytes) -> str:
    return data.decode("utf-8", errors="surrogateescape")


def _bytes(text: str) -> bytes:
    return text.encode("utf-8", errors="surrogateescape")


def _replace(text: str, pattern: re.Pattern[str], draw: Draw, by: Callable[[str], str]) -> str:
    """One match of a pattern otherwise."""
    found = list(pattern.finditer(text))
    if not found:
        return text + by("")
    match = draw.pick(found)
    return text[: match.start()] + by(match[0]) + text[match.end() :]


def encoding(data: bytes, draw: Draw, _: Surroundings) -> bytes:
    """Other bytes for the same letters, or letters that are none."""
    at = draw.below(len(data) + 1)
    ways: tuple[Callable[[], bytes], ...] = (
        lambda: b"\xef\xbb\xbf" + data,
        lambda: data.replace(b"\n", b"\r\n"),
        lambda: data.replace(b"\n", b"\r"),
        lambda: _text(data).encode("utf-16", errors="replace"),
        lambda: data[:at] + b"\xe9\xff" + data[at:],
        lambda: data[:at] + b"\0" + data[at:],
        lambda: data[:at] + b"\x1b[2J" + data[at:],
        lambda: data[:at] + b"\xed\xa0\x80" + data[at:],
        lambda: data[:at] + "\u2028\u202e\u00a0".encode() + data[at:],
    )
    return draw.pick(ways)()


def number(data: bytes, draw: Draw, _: Surroundings) -> bytes:
    """Another number somewhere."""
    return _bytes(_replace(_text(data), _NUMBER, draw, lambda _found: draw.pick(NUMBERS)))


def line(data: bytes, draw: Draw, _: Surroundings) -> bytes:
    """A line missing, twice, in another place, or many times."""
    lines = data.splitlines(keepends=True) or [b""]
    at, to = draw.below(len(lines)), draw.below(len(lines))
    taken = lines[at]
    way = draw.below(4)
    if way == 0:
        del lines[at]
    elif way == 1:
        lines.insert(to, taken)
    elif way == 2:
        lines[at], lines[to] = lines[to], lines[at]
    else:
        lines[at:at] = [taken] * 500
    return b"".join(lines)


def toml_value(data: bytes, draw: Draw, around: Surroundings) -> bytes:
    """A value of another type or size."""
    pattern = _TOML_LIST if draw.chance(0.15) else _TOML_VALUE
    value = draw.pick(toml_values(around.outside))
    return _bytes(_replace(_text(data), pattern, draw, lambda _found: value))


def toml_key(data: bytes, draw: Draw, _: Surroundings) -> bytes:
    """A key renamed, or one more."""
    name = draw.pick(KEYS)
    name = name if re.fullmatch(r"\w+", name, re.ASCII) else json.dumps(name, ensure_ascii=False)
    if draw.chance(0.5):
        return _bytes(_replace(_text(data), _TOML_KEY, draw, lambda _found: name))
    lines = _text(data).splitlines()
    lines.insert(draw.below(len(lines) + 1), f"{name} = {draw.pick(('1', '{}', '[]', 'true'))}")
    return _bytes("\n".join(lines) + "\n")


def toml_table(data: bytes, draw: Draw, _: Surroundings) -> bytes:
    """A table missing, twice, many times, or of the other kind."""
    parts = re.split(r"(?m)^(?=\[)", _text(data))
    at = draw.below(len(parts))
    way = draw.below(5)
    if way == 0:
        del parts[at]
    elif way == 1:
        parts.insert(draw.below(len(parts) + 1), parts[at])
    elif way == 2:
        parts[at:at] = [parts[at]] * 200
    elif way == 3:
        parts[at] = re.sub(r"^\[\[(.*)\]\]", r"[\1]", parts[at])
    else:
        parts[at] = re.sub(r"^\[([^\[\]]*)\]", r"[[\1]]", parts[at])
    return _bytes("".join(parts))


def json_value(data: bytes, draw: Draw, around: Surroundings) -> bytes:
    """A value of another type or size, a key missing, renamed or twice."""
    try:
        document = json.loads(_text(data))
    except (ValueError, RecursionError):
        return number(data, draw, around)
    nodes: list[tuple[Any, Any]] = []

    def walk(node: Any) -> None:
        items = list(node.items()) if isinstance(node, dict) else list(enumerate(node))
        for key, value in items:
            nodes.append((node, key))
            if isinstance(value, (dict, list)):
                walk(value)

    if isinstance(document, (dict, list)):
        walk(document)
    raw = draw.pick(json_values(around.outside))
    if not nodes:
        return _bytes(raw)
    node, key = draw.pick(nodes)
    way = draw.below(8)
    if way == 0:
        del node[key]
    elif way == 1 and isinstance(node, dict):
        node[draw.pick(KEYS)] = node.pop(key)
    elif way == 2:
        node[key] = [node[key]] * draw.pick((1, 2, 1000))
    elif way == 3:
        node[key] = {"a": node[key]}
    elif way == 4 and draw.chance(0.3):
        return _bytes(raw)
    else:
        node[key] = _PLACE
    text = json.dumps(document, ensure_ascii=False)
    return _bytes(text.replace(json.dumps(_PLACE, ensure_ascii=False), raw))


def yaml_value(data: bytes, draw: Draw, around: Surroundings) -> bytes:
    """A value of another type or size, or a key renamed or one more."""
    if draw.chance(0.2):
        key = draw.pick(("self", "!!int x", "? ", "<<", "[1]", "*a", "&a a", "2020-13-45"))
        if draw.chance(0.5):
            return _bytes(f"{key}: 1\n" + _text(data))
        return _bytes(_replace(_text(data), _YAML_KEY, draw, lambda _found: key))
    if draw.chance(0.1):
        bomb = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
        bomb += [f"a{i}: &a{i} [" + ", ".join([f"*a{i - 1}"] * 9) + "]" for i in range(1, 9)]
        return _bytes("\n".join(bomb) + "\n" + _text(data))
    value = draw.pick(yaml_values(around.outside))
    return _bytes(_replace(_text(data), _YAML_VALUE, draw, lambda _found: value))


def cell(data: bytes, draw: Draw, around: Surroundings) -> bytes:
    """Another cell somewhere in a table."""
    lines = _text(data).splitlines() or [""]
    at = draw.below(len(lines))
    cells = lines[at].split(",")
    cells[draw.below(len(cells))] = draw.pick(cell_values(around.outside))
    lines[at] = ",".join(cells)
    return _bytes("\n".join(lines) + "\n")


def column(data: bytes, draw: Draw, _: Surroundings) -> bytes:
    """A column of a table missing, twice, renamed, in another place, or all one value."""
    rows = [line.split(",") for line in _text(data).splitlines()] or [[""]]
    at, way = draw.below(len(rows[0])), draw.below(5)
    value = draw.pick(NUMBERS)
    for number, row in enumerate(rows):
        if at >= len(row):
            continue
        if way == 0:
            del row[at]
        elif way == 1:
            row.append(row[at])
        elif way == 2 and number == 0:
            row[at] = draw.pick((*KEYS, rows[0][0], rows[0][-1].upper(), f" {row[at]} "))
        elif way == 3:
            row[at], row[0] = row[0], row[at]
        elif way == 4 and number:
            row[at] = value
    return _bytes("\n".join(",".join(row) for row in rows) + "\n")


def separators(data: bytes, draw: Draw, _: Surroundings) -> bytes:
    """Another separator, ragged rows, quotes, or a table of many rows."""
    text = _text(data)
    ways: tuple[Callable[[], str], ...] = (
        lambda: text.replace(",", ";"),
        lambda: text.replace(",", "\t"),
        lambda: text.replace(",", ", "),
        lambda: text.replace("\n", ",\n"),
        lambda: text.replace(".", ","),
        lambda: '"' + text,
        lambda: text + '"open\n',
        lambda: "# note\n\n" + text,
        lambda: text + "\n" * 5000,
        lambda: text + ("," * 100_000),
    )
    return _bytes(draw.pick(ways)())


def step_entity(data: bytes, draw: Draw, _: Surroundings) -> bytes:
    """An entity of a STEP file missing, twice, of another type, or referring elsewhere."""
    text, way = _text(data), draw.below(6)
    if way == 0:
        return _bytes(_replace(text, _STEP_ENTITY, draw, lambda _found: ""))
    if way == 1:
        return _bytes(_replace(text, _STEP_ENTITY, draw, lambda found: found + "\n" + found))
    if way == 2:
        types = sorted(set(_STEP_TYPE.findall(text))) or ["PLANE"]
        return _bytes(_replace(text, _STEP_TYPE, draw, lambda _found: draw.pick(types)))
    if way == 3:
        other = draw.pick((*_STEP_REFERENCE.findall(text), "#0", "#99999999", "$", "*"))
        return _bytes(_replace(text, _STEP_REFERENCE, draw, lambda _found: other))
    if way == 4:
        factor = draw.pick((0.0, 1e-3, 1e3, 1e12, -1.0))
        return _bytes(_STEP_REAL.sub(lambda match: repr(_scaled(match[0], factor)), text))
    quoted = draw.pick(("\\X2\\D800\\X0\\", "\\S\\", "x" * 70_000, "''", "[red]", "\\X\\", "\x1b"))
    return _bytes(_replace(text, re.compile(r"(?<=')[^']*(?=')"), draw, lambda _found: quoted))


def _scaled(word: str, factor: float) -> float:
    try:
        return float(word) * factor
    except ValueError:
        return factor


_ANY = (encoding, number, line)
MUTATORS = {
    ".toml": (*_ANY, toml_value, toml_value, toml_value, toml_value, toml_key, toml_table),
    ".json": (*_ANY, json_value, json_value, json_value, json_value),
    ".yaml": (*_ANY, yaml_value, yaml_value, yaml_value),
    ".csv": (*_ANY, cell, cell, column, column, separators),
    ".txt": (*_ANY, cell, separators),
    ".step": (encoding, number, number, line, step_entity, step_entity, step_entity),
    ".stl": (number, number, line),
    ".ply": (number, number, line),
    ".obj": (*_ANY, number, number),
}
