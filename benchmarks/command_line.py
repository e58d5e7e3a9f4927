# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab bench`` and ``python -m taccel_lab.benchmarks``: the options of each command, which
stand in its own file, as arguments.

Written with argparse, which every machine has; a command's module is imported when it is asked for.
"""

from __future__ import annotations

import argparse
import ast
import inspect
import sys
from collections.abc import Sequence
from dataclasses import MISSING, fields
from importlib import import_module
from itertools import pairwise
from typing import Any, Protocol, get_args, get_origin, get_type_hints

from taccel_lab.errors import InputError, SimulationError

COMMANDS = {
    "speed": "speed:Speed",
    "learning": "learning:Learning",
    "error": "error:Error",
    "press_accuracy": "press_accuracy:PressAccuracy",
    "scaling": "scaling:Scaling",
    "skips": "skips:Skips",
    "precision": "precision:Precision",
    "stress": "stress.suite:Stress",
    "peers": "peers:Peers",
    "study": "design_study:Study",
    "captures": "capture_sets:Captures",
    "check_errors": "check_errors:CheckErrors",
    "images": "images:Images",
    "fine_images": "fine_images:FineImages",
    "environments": "environments:Environments",
    "dataset": "dataset:DatasetSpeed",
    "multi_gpu": "multi_gpu:MultiGpu",
    "quick": "quick:Quick",
    "compare": "compare:Compare",
    "report": "report.pages:Report",
    "scenes": "scenes.listing:Scenes",
}
"""Modules below ``taccel_lab.benchmarks`` and their classes of options, suites first."""
DESCRIPTION = """Measure speed at a stated error, and compare results.

Suites write a JSON file into --out; `report` makes docs/benchmarks.md from benchmarks/results."""


class Command(Protocol):
    """Options of a command, ready to run."""

    def run(self) -> None: ...


def options_of(command: str) -> type:
    """The dataclass of a command's options."""
    module, name = COMMANDS[command].split(":")
    return getattr(import_module(f"taccel_lab.benchmarks.{module}"), name)


def field_help(options: type) -> dict[str, str]:
    """Docstrings of a dataclass's fields, inherited ones too: the strings below them in source."""
    found: dict[str, str] = {}
    for kind in reversed(options.__mro__[:-1]):
        body = ast.parse(inspect.getsource(kind).strip()).body[0].body  # type: ignore[attr-defined]
        for node, text in pairwise(body):
            if (
                isinstance(node, ast.AnnAssign)
                and isinstance(node.target, ast.Name)
                and isinstance(text, ast.Expr)
                and isinstance(text.value, ast.Constant)
            ):
                found[node.target.id] = ast.literal_eval(text.value)
    return found


def add_options(parser: argparse.ArgumentParser, options: type) -> None:
    """An argument for each field; those without a default are positional, tuples are lists."""
    hints, texts = get_type_hints(options), field_help(options)
    for item in fields(options):
        kind, text = hints[item.name], texts.get(item.name, "").replace("%", "%%")
        flag = f"--{item.name.replace('_', '-')}"
        inner = [part for part in get_args(kind) if part not in (type(None), ...)]
        if item.default is MISSING:
            parser.add_argument(item.name, type=kind, help=text)
        elif kind is bool:
            parser.add_argument(
                flag, action=argparse.BooleanOptionalAction, default=item.default, help=text
            )
        else:
            parser.add_argument(
                flag,
                type=inner[0] if inner else kind,
                nargs="+" if get_origin(kind) is tuple else None,
                default=item.default,
                metavar=item.name.upper(),
                help=f"{text} ({_shown(item.default)})",
            )


def _shown(value: Any) -> str:
    if isinstance(value, tuple):
        return " ".join(map(str, value)) or "none"
    return "not set" if value is None else str(value)


def parse(
    arguments: Sequence[str] | None = None, program: str = "python -m taccel_lab.benchmarks"
) -> Command:
    """The command that the arguments name, with its options; --help and usage errors leave through
    SystemExit (0 and 2)."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    if not words or words[0] not in COMMANDS:
        _parser_of_all(program).parse_args(words[:1])
    command, *rest = words
    options = options_of(command)
    text = inspect.getdoc(options)
    parser = argparse.ArgumentParser(prog=f"{program} {command}", description=text)
    add_options(parser, options)
    found = vars(parser.parse_args(rest))
    return options(**{k: tuple(v) if isinstance(v, list) else v for k, v in found.items()})


def _parser_of_all(program: str) -> argparse.ArgumentParser:
    """For help and for errors in the command's name."""
    parser = argparse.ArgumentParser(prog=program, description=DESCRIPTION)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for command in COMMANDS:
        text = inspect.getdoc(options_of(command)) or ""
        commands.add_parser(command, help=text.split("\n")[0])
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run; the exit code is 0 done, 1 a difference or failure found, 2 bad input, 3 not solved,
    130 interrupted."""
    try:
        parse(arguments).run()
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
