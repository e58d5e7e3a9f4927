# SPDX-License-Identifier: Apache-2.0
"""``python -m taccel_lab.benchmarks``: the suites with argparse, for machines without the command
line's libraries.

Lists are written with commas: ``--envs 1,16,64``.
"""

from __future__ import annotations

import argparse
import ast
import inspect
import sys
from collections.abc import Sequence
from dataclasses import MISSING, Field, fields
from functools import partial
from itertools import pairwise
from typing import Any, get_args, get_origin, get_type_hints

from taccel_lab.benchmarks.options import COMMANDS, SUITES
from taccel_lab.errors import InputError, SimulationError


def field_help(options: type) -> dict[str, str]:
    """Docstrings of a dataclass's fields: the strings below them in its source."""
    body = ast.parse(inspect.getsource(options).strip()).body[0].body  # type: ignore[attr-defined]
    return {
        node.target.id: ast.literal_eval(text.value)
        for node, text in pairwise(body)
        if isinstance(node, ast.AnnAssign)
        and isinstance(node.target, ast.Name)
        and isinstance(text, ast.Expr)
        and isinstance(text.value, ast.Constant)
    }


def add_options(parser: argparse.ArgumentParser, options: type) -> None:
    """An argument for each field; those without a default are positional."""
    hints, texts = get_type_hints(options), field_help(options)
    for item in fields(options):
        kind, text = hints[item.name], texts.get(item.name, "")
        if item.default is MISSING:
            parser.add_argument(item.name, type=_reader(kind), help=text)
        elif kind is bool:
            parser.add_argument(
                f"--{item.name.replace('_', '-')}",
                action=argparse.BooleanOptionalAction,
                default=item.default,
                help=text,
            )
        else:
            parser.add_argument(
                f"--{item.name.replace('_', '-')}",
                type=_reader(kind),
                default=item.default,
                metavar=_metavar(item, kind),
                help=f"{text} ({_shown(item.default)})",
            )


def _reader(kind: Any) -> Any:
    """What turns the text of an argument into a field's type."""
    if get_origin(kind) is tuple:
        return partial(_read_list, get_args(kind)[0])
    inner = [part for part in get_args(kind) if part is not type(None)]
    return inner[0] if inner else kind


def _read_list(kind: Any, text: str) -> tuple[Any, ...]:
    return tuple(kind(part) for part in text.split(",") if part)


def _metavar(item: Field, kind: Any) -> str:
    return f"{item.name.upper()},..." if get_origin(kind) is tuple else item.name.upper()


def _shown(value: Any) -> str:
    if isinstance(value, tuple):
        return ",".join(map(str, value)) or "none"
    return "not set" if value is None else str(value)


def make_parser() -> argparse.ArgumentParser:
    """``run SUITE`` and the other commands."""
    parser = argparse.ArgumentParser(prog="python -m taccel_lab.benchmarks", description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    suites = commands.add_parser("run", help="run a suite").add_subparsers(
        required=True, metavar="SUITE"
    )
    for group, kinds in ((suites, SUITES), (commands, COMMANDS)):
        for options in kinds:
            text = inspect.getdoc(options) or ""
            entry = group.add_parser(options.name, help=text.split("\n")[0], description=text)
            add_options(entry, options)
            entry.set_defaults(options=options)
    return parser


def parse(arguments: Sequence[str] | None = None) -> Any:
    """The options of the command that the arguments name."""
    found = vars(make_parser().parse_args(arguments))
    kind = found.pop("options")
    return kind(**found)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run; the exit code is 0 done, 1 a difference or failure found, 2 bad input, 3 not solved,
    130 interrupted."""
    options = parse(arguments)
    try:
        options.run()
    except InputError as error:
        return _fail(2, f"error: {error}")
    except (PermissionError, NotADirectoryError, IsADirectoryError) as error:
        return _fail(2, f"error: {error.filename}: {error.strerror}")
    except SimulationError as error:
        return _fail(3, f"simulation failed: {error}")
    except KeyboardInterrupt:
        return 130
    return 0


def _fail(code: int, message: str) -> int:
    sys.stderr.write(message + "\n")
    return code
