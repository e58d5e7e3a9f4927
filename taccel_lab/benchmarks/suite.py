# SPDX-License-Identifier: Apache-2.0
"""What suites have in common: options, a result file, rows that are measured one by one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from taccel_lab.benchmarks.results import ResultFile


@dataclass(frozen=True, kw_only=True)
class Suite:
    """Options of a suite; those of one suite stand in its class, with their help below them."""

    name: ClassVar[str]
    """Of its command and its result file."""
    what: ClassVar[str]
    """A line for the result file."""
    shown: ClassVar[tuple[str, ...]] = ()
    """Figures of a row to show when it is finished, those of inner tables named as on the page; one
    that a row lacks is left out."""
    device: str = "cpu"
    """cpu, cuda:0, ..."""
    budget_s: float | None = None
    """Seconds after which no new row is started."""
    out: Path = Path("out/benchmarks")
    """Folder of the result, or a JSON file."""

    def run(self) -> None:
        """What the command does."""
        self.measure()

    def measure(self) -> ResultFile:
        """Measure all rows and write the result file; InputError for options that cannot be."""
        import warp as wp

        from taccel_lab.processes.start_warp import start_warp

        start_warp()
        wp.config.log_level = wp.LOG_WARNING
        settings = self.settings()
        result = ResultFile(
            self.name, self.what, self.out, self.device, settings, self.budget_s, self.shown
        )
        with result.finishing():
            self.measure_rows(result)
        return result

    def settings(self) -> dict[str, Any]:
        """What the result file says of the options."""
        raise NotImplementedError

    def measure_rows(self, result: ResultFile) -> None:
        """Add a row for everything that the suite measures."""
        raise NotImplementedError
