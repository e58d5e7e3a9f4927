# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab bench``: the benchmark suites, with the options that
``taccel_lab.benchmarks.options`` has.

The only module that imports ``benchmarks``, when the command line is built and no sooner.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tyro.extras import SubcommandApp

HELP = """Measure speed at a stated error, and compare results.

Suites write JSON to benchmarks/results; `report` makes docs/benchmarks.md from it."""


def bench_commands() -> SubcommandApp:
    """A sub-command for each suite and for what is done with results."""
    from tyro.extras import SubcommandApp

    from taccel_lab.benchmarks.options import COMMANDS, SUITES

    app = SubcommandApp()
    for options in (*SUITES, *COMMANDS):
        app.command(name=options.name)(options)
    return app
