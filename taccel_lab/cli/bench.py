# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab bench``: the commands of ``taccel_lab.benchmarks``, whose options stand in their
files. A command's module is imported on demand.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Protocol

from taccel_lab.errors import InputError

COMMANDS = {
    "speed": "taccel_lab.benchmarks.speed:Speed",
    "learning": "taccel_lab.benchmarks.learning:Learning",
    "press_accuracy": "taccel_lab.benchmarks.press_accuracy:PressAccuracy",
    "stress": "taccel_lab.benchmarks.stress.suite:Stress",
    "scenes": "taccel_lab.benchmarks.scenes:Scenes",
}
"""Modules and their classes of options, suites first."""
MOVED = ("captures", "compare", "images", "quick", "readings", "report", "slow_steps")
"""Commands that were here, and are of ``tools.bench`` now."""
DESCRIPTION = """Measure speed at a stated error.

Suites write a JSON file and a page into --out. Those that only make our documentation are in a
checkout: python -m tools.bench."""


class BenchmarkCommand(Protocol):
    """Options of a command, ready to run."""

    def run(self) -> None: ...


@dataclass(frozen=True)
class BenchCommand:
    """Measure speed at a stated error."""

    def run(self) -> None:
        """Say which commands there are."""
        parse_bench([]).run()


def options_of(place: str) -> type[BenchmarkCommand]:
    """The dataclass of a command's options, by its place as in ``COMMANDS``."""
    module, name = place.split(":")
    return getattr(import_module(module), name)


def parse_bench(words: Sequence[str]) -> BenchmarkCommand:
    """The command that the words after ``bench`` name, see ``parse_suite``.

    Raises:
        InputError: It has moved.
    """
    if words and words[0].replace("-", "_") in MOVED:
        raise InputError(
            f"taccel-lab bench has no {words[0]} any more; run python -m tools.bench {words[0]} "
            "in a checkout"
        )
    return parse_suite(words, COMMANDS, "taccel-lab bench", DESCRIPTION)


def parse_suite(
    words: Sequence[str], commands: Mapping[str, str], prog: str, description: str
) -> BenchmarkCommand:
    """The command of ``prog`` that the words name, with its options; --help and usage errors leave
    through SystemExit (0 and 2).

    ``commands``: places of their options by name, as in ``COMMANDS``.
    """
    import tyro
    from tyro.extras import SubcommandApp

    from taccel_lab.cli.words import require_command

    if words:
        known = [name.replace("_", "-") for name in commands]
        require_command(words[0].replace("_", "-"), known, prog)
    app = SubcommandApp()
    # All of them are imported for help, and for errors in the command's name, alone.
    for command in [words[0]] if words and words[0] in commands else commands:
        app.command(name=command)(options_of(commands[command]))
    return app.cli(
        prog=prog,
        description=description,
        args=list(words) or ["--help"],
        config=(tyro.conf.PositionalRequiredArgs, tyro.conf.PositionalMetavarFromFieldName),
    )
