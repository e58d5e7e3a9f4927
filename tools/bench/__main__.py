# SPDX-License-Identifier: Apache-2.0
"""``python -m tools.bench``: suites whose results, and the page of them, are our documentation."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from taccel_lab.cli.app import main
from taccel_lab.cli.bench import BenchmarkCommand, parse_suite
from taccel_lab.cli.console import be_quiet
from taccel_lab.cli.words import common_words

COMMANDS = {
    "captures": "tools.bench.capture_sets:Captures",
    "images": "tools.bench.images:Images",
    "readings": "tools.bench.readings:Readings",
    "slow_steps": "tools.bench.slow_steps:SlowSteps",
    "quick": "tools.bench.quick:Quick",
    "compare": "tools.bench.compare:Compare",
    "report": "tools.bench.report.pages:Report",
}
"""Modules and their classes of options, suites first."""
DESCRIPTION = """Measure what our documentation states, and compare results.

Suites write a JSON file and a page into --out; `report` makes docs/evidence/benchmarks.md from
benchmarks/results. Speed, learning, press accuracy and stress: taccel-lab bench."""


def parse(words: Sequence[str]) -> BenchmarkCommand:
    """The command that the words name, see ``taccel_lab.cli.bench.parse_suite``."""
    words, quiet = common_words(words)
    be_quiet(quiet)
    return parse_suite(words, COMMANDS, "python -m tools.bench", DESCRIPTION)


if __name__ == "__main__":
    sys.exit(main(parsed=parse))
