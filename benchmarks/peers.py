# SPDX-License-Identifier: Apache-2.0
"""The suite ``peers``: run another simulator's driver of the peg scene, and keep what it says.

``peers.json`` holds the field's figures with their conditions. A driver prints, for each number of
environments, a line ``RESULT name ... N=16 ... FPS=123.4 ...``; it runs in its own process,
with this machine's device, so that both figures come from one machine on one day.
"""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from taccel_lab.benchmarks.results import ResultFile
from taccel_lab.benchmarks.suite import Suite
from taccel_lab.errors import InputError, SimulationError

FIELD = Path(__file__).parent / "peers.json"
_PAIR = re.compile(r"(\w+)=(-?[\d.]+(?:e-?\d+)?)")


def read_field() -> dict[str, Any]:
    """Figures of others."""
    return json.loads(FIELD.read_text(encoding="utf-8"))


def parse_results(lines: Iterator[str] | list[str]) -> Iterator[dict[str, Any]]:
    """A row for each RESULT line."""
    for line in lines:
        words = line.split()
        if len(words) < 2 or words[0] != "RESULT":
            continue
        figures = {name: float(value) for name, value in _PAIR.findall(line)}
        if "N" not in figures or "FPS" not in figures:
            raise SimulationError(f"a driver printed a RESULT without N or FPS: {line.strip()}")
        yield {
            "name": words[1],
            "envs": int(figures["N"]),
            "fps": figures["FPS"],
            "line": line.strip(),
        }


@dataclass(frozen=True)
class Peers(Suite):
    """Run another simulator's driver of the peg scene, and keep the figures it prints."""

    name: ClassVar[str] = "peers"
    what: ClassVar[str] = "Frames a second of another simulator on the peg scene, run beside ours."
    shown: ClassVar[tuple[str, ...]] = ("envs", "fps")
    driver: Path
    """Script that prints a line RESULT NAME ... N=16 ... FPS=123.4 for each row."""
    arguments: str = ""
    """Its arguments in quotes, as in --arguments="--N 1,16"."""
    stop: str = "not stated"
    """When its steps end, for the table."""

    def settings(self) -> dict[str, Any]:
        return {"driver": self.driver.name, "arguments": self.arguments, "stop": self.stop}

    def measure_rows(self, result: ResultFile) -> None:
        """Rows of the driver as they come; a budget that is spent ends it."""
        if not self.driver.is_file():
            raise InputError(f"--driver {self.driver} is no file")
        command = [sys.executable, str(self.driver), *shlex.split(self.arguments)]
        process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        tail: list[str] = []
        try:
            for line in process.stdout or ():
                tail = [*tail[-20:], line]
                for row in parse_results([line]):
                    result.measure(row["name"], lambda row=row: row)
                if result.deadline.passed:
                    process.kill()
                    return
            code = process.wait()
        except BaseException:
            process.kill()
            raise
        if code != 0:
            raise SimulationError(f"{self.driver} ended with {code}:\n{''.join(tail)}")
