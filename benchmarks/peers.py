# SPDX-License-Identifier: Apache-2.0
"""The suite ``peers``: run another simulator's driver of the peg scene, and keep what it says.

``peers.json`` holds the field's figures with their conditions. A driver prints, for each number of
environments, a line ``RESULT name ... N=16 ... FPS=123.4 ...``; it runs in a process of its own,
with this machine's device, so that both figures come from one machine on one day.
"""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from taccel_lab.benchmarks.options import Peers
from taccel_lab.benchmarks.results import ResultFile, note
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


def run_peers(options: Peers) -> None:
    """Run the driver and write its rows as they come."""
    if not options.driver.is_file():
        raise InputError(f"--driver {options.driver} is no file")
    command = [sys.executable, str(options.driver), *shlex.split(options.arguments)]
    what = "Frames a second of another simulator on the peg scene, run beside ours."
    settings = {"driver": options.driver.name, "arguments": options.arguments, "stop": options.stop}
    with ResultFile("peers", what, options.out, options.device, settings).finishing() as result:
        process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        tail: list[str] = []
        try:
            for line in process.stdout or ():
                tail = [*tail[-20:], line]
                for row in parse_results([line]):
                    result.add(row)
                    note(f"{row['name']}, {row['envs']} environments: {row['fps']:,.1f} FPS")
            code = process.wait()
        except BaseException:
            process.kill()
            raise
        if code != 0:
            raise SimulationError(f"{options.driver} ended with {code}:\n{''.join(tail)}")
