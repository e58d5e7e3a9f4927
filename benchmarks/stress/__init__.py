# SPDX-License-Identifier: Apache-2.0
"""Stability stress: hundreds of random scenes over extremes, each judged by independent referees.

A *case* is a family (``benchmarks/stress/families``) and a seed, from which its parameters are
drawn: ``python -m taccel_lab.benchmarks.stress replay FAMILY SEED`` runs it again, step by step. It
takes a bounded number of steps within a budget of time. A step that fails with a cause and leaves
the state where it was is a failure that a user can see and act on; one that claims to have
converged while a referee objects (``referees.py``) is *silent*, and must not be.
"""

from __future__ import annotations

import json
import time
from contextlib import closing
from pathlib import Path
from typing import Any

from taccel_lab.benchmarks.stress import families as _families
from taccel_lab.benchmarks.stress.case import FAMILIES
from taccel_lab.benchmarks.stress.pool import CaseId, run_all
from taccel_lab.benchmarks.stress.progress import progress
from taccel_lab.benchmarks.stress.runner import SECONDS
from taccel_lab.benchmarks.stress.summary import plot, summarize, table

__all__ = ["FAMILIES", "load", "plot", "run", "summarize", "table"]

RESULT = Path(__file__).parents[1] / "results" / "stress.json"
SAVE_EVERY_S = 60.0
assert _families


def case_ids(count: int, seed: int, names: list[str] | None = None) -> list[CaseId]:
    """``count`` cases over all families in turn; the first has ``seed``, the next of a family the
    following ones."""
    names = names or list(FAMILIES)
    return [(names[i % len(names)], seed + i // len(names)) for i in range(count)]


def run(
    count: int,
    seed: int,
    out: Path | None,
    device: str = "cpu",
    jobs: int = 1,
    seconds: float = SECONDS,
    names: list[str] | None = None,
) -> dict[str, Any]:
    """Run ``count`` cases from ``seed`` on in ``jobs`` processes and write ``out`` (JSON), beside
    it the table (``.md``) and the picture (``.png``); None writes nothing.

    Files are written anew now and then; Ctrl-C ends the run and keeps what is finished. The result
    is what the JSON holds: ``run`` (machine, commit), ``settings``, ``complete``, ``rows`` (a row a
    family), ``summary`` (see ``table``) and ``cases``.
    """
    ids = case_ids(count, seed, names)
    results: list[dict[str, Any]] = []
    settings = {"count": count, "seed": seed, "budget_s": seconds, "jobs": jobs}
    started = saved = time.perf_counter()

    def record(complete: bool) -> dict[str, Any]:
        order = {case: number for number, case in enumerate(ids)}
        results.sort(key=lambda result: order[(result["family"], result["seed"])])
        made = _record(results, settings, device, time.perf_counter() - started, complete)
        if out is not None:
            _write(made, out)
        return made

    with progress(len(ids)) as advance, closing(run_all(ids, device, jobs, seconds)) as finished:
        try:
            for result in finished:
                results.append(result)
                advance(result)
                if out is not None and time.perf_counter() - saved > SAVE_EVERY_S:
                    record(False)
                    saved = time.perf_counter()
        except KeyboardInterrupt:
            return record(False)
    return record(True)


def _record(
    results: list[dict[str, Any]],
    settings: dict[str, Any],
    device: str,
    seconds: float,
    complete: bool,
) -> dict[str, Any]:
    from taccel_lab.benchmarks.machine import describe_run
    from taccel_lab.benchmarks.results import SCHEMA

    summary = summarize(results)
    return {
        "schema": SCHEMA,
        "suite": "stress",
        "what": "Random scenes over extremes, each judged by independent referees.",
        "run": describe_run(device),
        "settings": settings,
        "complete": complete,
        "rows": [{"family": name, **row} for name, row in summary["families"].items()],
        "seconds": round(seconds, 1),
        "summary": summary,
        "cases": results,
    }


def _write(record: dict[str, Any], out: Path) -> None:
    from taccel_lab.output import atomic_file, write_json

    write_json(out, record)
    with atomic_file(out.with_suffix(".md")) as staging:
        staging.write_text(table(record["summary"]) + "\n")
        staging.chmod(0o644)
    if record["cases"]:
        plot(record["summary"], record["cases"], out.with_suffix(".png"))


def load(path: Path = RESULT) -> dict[str, Any]:
    """A result that ``run`` has written."""
    return json.loads(path.read_text(encoding="utf-8"))
