# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab bench``: the commands of ``taccel_lab.benchmarks``, whose options stand in their
files. A command's module is imported on demand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Protocol

COMMANDS = {
    "speed": "speed:Speed",
    "learning": "learning:Learning",
    "slow_steps": "slow_steps:SlowSteps",
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


@dataclass(frozen=True)
class BenchCommand:
    """Measure speed at a stated error, and compare results."""

    def run(self) -> None:
        """Say which commands there are."""
        parse_bench([]).run()


def options_of(command: str) -> type[BenchmarkCommand]:
    """The dataclass of a command's options."""
    module, name = COMMANDS[command].split(":")
    return getattr(import_module(f"taccel_lab.benchmarks.{module}"), name)


def parse_bench(words: Sequence[str]) -> BenchmarkCommand:
    """The command that the words after ``bench`` name, with its options; --help and usage errors
    leave through SystemExit (0 and 2)."""
    import tyro
    from tyro.extras import SubcommandApp

    from taccel_lab.cli.words import require_command

    if words:
        known = [name.replace("_", "-") for name in COMMANDS]
        require_command(words[0].replace("_", "-"), known, "taccel-lab bench")
    app = SubcommandApp()
    # All of them are imported for help, and for errors in the command's name, alone.
    for command in [words[0]] if words and words[0] in COMMANDS else COMMANDS:
        app.command(name=command)(options_of(command))
    return app.cli(
        prog="taccel-lab bench",
        description=DESCRIPTION,
        args=list(words) or ["--help"],
        config=(tyro.conf.PositionalRequiredArgs, tyro.conf.PositionalMetavarFromFieldName),
    )
