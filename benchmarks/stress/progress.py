# SPDX-License-Identifier: Apache-2.0
"""A bar while cases finish; plain lines where there is no terminal or rich is not installed."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any

from taccel_lab.benchmarks.stress.summary import GOOD, case_id

Advance = Callable[[dict[str, Any]], None]


@contextmanager
def progress(total: int) -> Iterator[Advance]:
    """Yield a function that counts a finished case."""
    done = bad = 0

    def count(result: dict[str, Any]) -> str:
        nonlocal done, bad
        done += 1
        bad += result["outcome"] not in GOOD
        return f"{done}/{total}, {bad} failed; {case_id(result)} {result['outcome']}"

    if not (find_spec("rich") and sys.stdout.isatty()):
        yield lambda result: print(count(result), flush=True)
        return
    from rich.progress import Progress

    with Progress(transient=True) as bar:
        task = bar.add_task("stress", total=total)
        yield lambda result: bar.update(task, advance=1, description=count(result))
