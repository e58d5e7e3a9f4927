# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab bench``: the commands of ``taccel_lab.benchmarks``, which reads their options."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from taccel_lab.benchmarks.command_line import BenchmarkCommand


@dataclass(frozen=True)
class BenchCommand:
    """Measure speed at a stated error, and compare results."""

    def run(self) -> None:
        """Say which commands there are."""
        parse_bench([]).run()


def parse_bench(arguments: Sequence[str]) -> BenchmarkCommand:
    """The command that the words after ``bench`` name."""
    from taccel_lab.benchmarks.command_line import parse

    return parse(arguments, "taccel-lab bench")
