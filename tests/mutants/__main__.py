# SPDX-License-Identifier: Apache-2.0
"""``make mutants``: plant each fault of the table in a copy of the tree and run the tests that
should notice it.

    python -m tests.mutants --only 'barrier-*' snell --jobs 2 --out out/mutants

A fault is noticed when a test fails; a run that passes or takes longer than ``--limit-s`` did
not notice it. Exit code 1: fewer were noticed than ``--least``.
"""

from __future__ import annotations

import fnmatch
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from queue import SimpleQueue

import tyro

from tests.mutants.table import ROOT, Fault, read_faults

_FAILED = re.compile(r"^(?:FAILED|ERROR) (.+?)(?: - |$)", re.MULTILINE)


@dataclass(frozen=True)
class Mutants:
    """Plant faults in a copy of the tree, one at a time, and see whether the tests notice."""

    only: tuple[str, ...] = ("*",)
    """Faults by patterns of their ids."""
    jobs: int = 2
    """Faults that are tried side by side."""
    least: float = 0.95
    """Share that has to be noticed."""
    limit_s: float = 900.0
    """For the tests of one fault [s]."""
    quick: bool = False
    """Whether the tests of ``make test`` have to notice it, without those of ``make thorough``."""
    out: Path = Path("out/mutants")
    """Folder of mutants.json, which is written anew after every fault."""


@dataclass(frozen=True)
class Outcome:
    """What became of a fault."""

    id: str
    kind: str
    noticed: bool
    by: str
    """The first test that failed."""
    seconds: float


def copy_of_the_tree(folder: Path) -> Path:
    """Of the files that git knows or would add, and links as they are."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT, check=True, capture_output=True, text=True,
    )  # fmt: skip
    for name in filter(None, listed.stdout.split("\0")):
        source, target = ROOT / name, folder / name
        if os.path.lexists(source) and not name.startswith(".venv"):
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, target, follow_symlinks=False)
    shared = ROOT.parent / "shared" / "data"
    os.environ.setdefault("TACCEL_LAB_DATA", str(shared))
    return folder


def run_tests(fault: Fault, root: Path, options: Mutants) -> Outcome:
    """Run the tests of a fault that is planted in ``root`` until one fails."""
    started = time.monotonic()
    by = ""
    for tests in fault.tests:
        left = options.limit_s - (time.monotonic() - started)
        if not (root / tests).exists() or left <= 0:
            continue
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", tests]
        command += ["-m", "not slow and not thorough"] if options.quick else []
        environment = os.environ | {"PYTHONPATH": str(root), "OMP_NUM_THREADS": "1"}
        try:
            run = subprocess.run(
                command, cwd=root, env=environment, timeout=left, capture_output=True, text=True
            )
        except subprocess.TimeoutExpired:
            break
        if run.returncode == 1 or (run.returncode and _FAILED.search(run.stdout)):
            found = _FAILED.search(run.stdout)
            by = found[1] if found else f"exit code {run.returncode}"
            break
        if run.returncode not in (0, 5):  # 5: no test was collected.
            raise RuntimeError(f"{fault.id}: {run.stdout[-2000:]}{run.stderr[-2000:]}")
    return Outcome(fault.id, fault.kind, bool(by), by, round(time.monotonic() - started, 1))


def plant(fault: Fault, root: Path, options: Mutants) -> Outcome:
    """Plant, run, restore."""
    path = root / fault.file
    sound, planted = path.read_text(encoding="utf-8"), fault.planted(root)
    path.write_text(planted, encoding="utf-8")
    try:
        return run_tests(fault, root, options)
    finally:
        path.write_text(sound, encoding="utf-8")


def main(options: Mutants) -> int:
    """Try all of them; the exit code."""
    faults = [
        fault
        for fault in read_faults()
        if any(fnmatch.fnmatch(fault.id, pattern) for pattern in options.only)
    ]
    for fault in faults:
        fault.planted(ROOT)  # A table that is out of date is said before anything runs.
    options = replace(options, out=options.out.absolute())
    options.out.mkdir(parents=True, exist_ok=True)
    outcomes: list[Outcome] = []
    with tempfile.TemporaryDirectory(prefix="mutants") as folder:
        roots: SimpleQueue[Path] = SimpleQueue()
        for number in range(options.jobs):
            roots.put(copy_of_the_tree(Path(folder) / str(number)))

        def turn(fault: Fault) -> Outcome:
            root = roots.get()
            try:
                return plant(fault, root, options)
            finally:
                roots.put(root)

        with ThreadPoolExecutor(options.jobs) as pool:
            for outcome in pool.map(turn, faults):
                outcomes.append(outcome)
                said = f"noticed by {outcome.by}" if outcome.noticed else "NOT NOTICED"
                print(f"{outcome.id:32s} {outcome.seconds:6.1f} s  {said}", flush=True)
                rows = [asdict(one) for one in outcomes]
                (options.out / "mutants.json").write_text(json.dumps(rows, indent=1) + "\n")
    noticed = sum(outcome.noticed for outcome in outcomes)
    print(f"{noticed} of {len(outcomes)} planted faults are noticed")
    return 0 if outcomes and noticed >= options.least * len(outcomes) else 1


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Mutants, description=__doc__)))
