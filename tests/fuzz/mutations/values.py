# SPDX-License-Identifier: Apache-2.0
"""Values that a field of a text file should not have, as they are written there."""

from __future__ import annotations

from pathlib import Path

DIGITS = "9" * 5000
"""More than Python turns into an integer."""
LONG = "x" * 100_000
LONG_NAME = "n" * 300
"""More than a file system takes for a name."""
NUMBERS = (
    "-1", "0", "1", "-0", "2", "0.5", "1e308", "-1e308", "1e-320", "1e999", "1e30", "1e9", "1e-9",
    "2147483648", "-2147483649", "18446744073709551616", "1000000000", "99999", "nan", "inf",
    "-inf", DIGITS, "1" + "0" * 400, "0x7fffffff", "1_0", "+1", "3.0",
)  # fmt: skip
"""As JSON, TOML, YAML and tables write them, though not each takes all."""
_NAMES = (
    "", " ", ".", "..", "/", "../x", "../x.png", "a/../../x.png", "~", "*", "**/*", "[", "[!a]*",
    "con", "\\\\server\\x", "C:\\x", LONG_NAME + ".png", LONG, "[red]x[/bold]", "{}%s", "self",
    "0.5", "true", "given", "é\u202e", "１２",
)  # fmt: skip


def json_values(outside: Path) -> tuple[str, ...]:
    texts = [f'"{_escaped(name)}"' for name in (*_NAMES, str(outside))]
    odd = [r'"a\u0000b"', r'"\u001b[2J"', r'"\ud800"', r'"a\nb"']
    nested = ["[" * depth + "]" * depth for depth in (2, 50, 3000, 100_000)]
    objects = ['{"a":' * depth + "1" + "}" * depth for depth in (3, 3000)]
    plain = ["null", "true", "false", "[]", "{}", "NaN", "Infinity", "-Infinity", '[1, "a", true]']
    return (*NUMBERS, *texts, *odd, *nested, *objects, *plain, "[" + "1," * 5000 + "1]")


def toml_values(outside: Path) -> tuple[str, ...]:
    texts = [f'"{_escaped(name)}"' for name in (*_NAMES, str(outside))]
    odd = [r'"a\u0000b"', r'"\u001b[2J"', r'"a\nb"', "'''raw'''", '"""', "'", "\u00e9"]
    nested = ["[" * depth + "]" * depth for depth in (2, 50, 3000)]
    objects = ["{ a = " * depth + "1" + " }" * depth for depth in (1, 2000)]
    times = ["1979-05-27", "1979-05-27T07:32:00Z", "07:32:00", "1979-13-45"]
    plain = ["true", "false", "[]", "{}", '[1, "a", true]', "", "[" + "1," * 5000 + "1]"]
    return (*NUMBERS, *texts, *odd, *nested, *objects, *times, *plain)


def yaml_values(outside: Path) -> tuple[str, ...]:
    own = [
        ".nan", "-.inf", "2020-13-45", "2020-01-01 25:61:61", "1:2:3", "!!int x", "!!float y",
        '!!binary "x"', "!!timestamp z", "!!python/object/apply:os.getcwd []", "!!set {a}", "*a",
        "&a [*a]", "&a {b: *a}", "{[1]: 2}", "? [1, 2]", "|", ">", "\t", "@", "`", "%", "- - -",
        "!!bool 7", "!!null 7", "<<", "=", "0o7", "0b2", "190:20:30",
    ]  # fmt: skip
    return (*json_values(outside), *own)


def cell_values(outside: Path) -> tuple[str, ...]:
    odd = ['"', '"open', "a\0b", "1,5", "1;5", "1 5", "=1+1", "true", "\xa0", "１", "x" * 200_000]
    return (*NUMBERS, *_NAMES, str(outside), *odd)


KEYS = (
    "self", "model_config", "__init__", "__class__", "cls", "x", "model_fields", "schema_version",
    "kind", "values", "copy", "data", "fields_set", "é", "a b", "", "*", "[red]", "[/]", "_private",
)  # fmt: skip
"""Keys that mean something to the program rather than to the format."""


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"')
