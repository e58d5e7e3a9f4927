# SPDX-License-Identifier: Apache-2.0
"""Python in its own process, which imports the package from a folder of choice."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import taccel_lab
from taccel_lab.errors import SimulationError

ROOT = Path(taccel_lab.__file__).parents[1]
"""Where this package is imported from."""


def run_python(
    what: str,
    arguments: list[str],
    root: Path = ROOT,
    cwd: Path | None = None,
    environment: dict[str, str] | None = None,
) -> str:
    """What ``python *arguments`` prints.

    Args:
        what: Begins the message of a failure.
        root: Folder that the package is imported from.
        cwd: Where it runs; here when None.
        environment: Variables besides this process's own.

    Raises:
        SimulationError: It failed; the message ends with what it said.
    """
    path = os.pathsep.join([str(root), os.environ.get("PYTHONPATH", "")])
    run = subprocess.run(
        [sys.executable, *arguments],
        cwd=cwd,
        env={**os.environ, **(environment or {}), "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    if run.returncode != 0:
        raise SimulationError(f"{what} failed:\n{run.stderr[-2000:]}")
    return run.stdout
