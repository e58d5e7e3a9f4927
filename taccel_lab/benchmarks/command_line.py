# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab bench`` and ``python -m taccel_lab.benchmarks``: the options of each command, which
stand in its own file, as arguments. A command's module is imported on demand.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Protocol

from taccel_lab.errors import (
    InputError,
    SimulationError,
    file_sentence,
    is_of_a_file,
    kept_notes,
)

COMMANDS = {
    "speed": "speed:Speed",
    "learning": "learning:Learning",
    "press_accuracy": "press_accuracy:PressAccuracy",
    "stress": "stress.suite:Stress",
    "captures": "capture_sets:Captures",
    "images": "images:Images",
    "readings": "readings:Readings",
    "quick": "quick:Quick",
    "compare": "compare:Compare",
    "report": "report.pages:Report",
    "scenes": "scenes:Scenes",
}
"""Modules below ``taccel_lab.benchmarks`` and their classes of options, suites first."""
DESCRIPTION = """Measure speed at a stated error, and compare results.

Suites write a JSON file and a page into --out; `report` makes docs/evidence/benchmarks.md from
benchmarks/results."""


class BenchmarkCommand(Protocol):
    """Options of a command, ready to run."""

    def run(self) -> None: ...


def options_of(command: str) -> type[BenchmarkCommand]:
    """The dataclass of a command's options."""
    module, name = COMMANDS[command].split(":")
    return getattr(import_module(f"taccel_lab.benchmarks.{module}"), name)


def parse(
    arguments: Sequence[str] | None = None, program: str = "python -m taccel_lab.benchmarks"
) -> BenchmarkCommand:
    """The command that the arguments name, with its options; --help and usage errors leave through
    SystemExit (0 and 2)."""
    import tyro
    from tyro.extras import SubcommandApp

    words = list(sys.argv[1:] if arguments is None else arguments)
    app = SubcommandApp()
    # All of them are imported for help, and for errors in the command's name, alone.
    for command in [words[0]] if words and words[0] in COMMANDS else COMMANDS:
        app.command(name=command)(options_of(command))
    return app.cli(
        prog=program,
        description=DESCRIPTION,
        args=words or ["--help"],
        config=(tyro.conf.PositionalRequiredArgs, tyro.conf.PositionalMetavarFromFieldName),
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run; the exit code is 0 done, 1 a difference or failure found, 2 bad input, 3 not solved,
    130 interrupted."""
    try:
        parse(arguments).run()
    except InputError as error:
        return _fail(2, f"error: {error}")
    except OSError as error:
        if not is_of_a_file(error):
            raise
        return _fail(2, f"error: {file_sentence(error)}; {kept_notes(error)}".removesuffix("; "))
    except SimulationError as error:
        return _fail(3, f"simulation failed: {error}")
    except KeyboardInterrupt as error:
        return _fail(130, f"interrupted; {kept_notes(error) or 'nothing is kept'}")
    return 0


def _fail(code: int, message: str) -> int:
    sys.stderr.write(message + "\n")
    return code
