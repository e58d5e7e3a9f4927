# SPDX-License-Identifier: Apache-2.0
"""Cases in processes of their own, several at once: one that hangs or dies takes nothing along."""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any

from taccel_lab.benchmarks.stress.runner import run_case

CaseId = tuple[str, int]
"""Family and seed."""
RunCase = Callable[[str, int, str, float], dict[str, Any]]
"""``(family, seed, device, seconds)``."""
PATIENCE_S = 900.0
"""Time beyond the budget after which a process is ended: kernels may have to be compiled, during
which no signal is heard."""


def _serve(pipe: Connection, device: str, seconds: float, run: RunCase) -> None:
    """Run the cases that come, until None does."""
    import signal

    import warp as wp

    # Ctrl-C is the parent's: it ends this process when it has written what there is.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    wp.config.quiet = True
    while (case := pipe.recv()) is not None:
        family, number = case
        pipe.send(_timed(run, family, number, device, seconds))


def _timed(run: RunCase, family: str, seed: int, device: str, seconds: float) -> dict[str, Any]:
    """A case; again when its budget went into compiling kernels, which the cache has now."""
    before = _compiled()
    result = run(family, seed, device, seconds)
    if result["outcome"] == "budget" and _compiled() != before:
        result = run(family, seed, device, seconds)
    return result


def _compiled() -> int:
    """Modules in the kernel cache."""
    import warp as wp

    folder = wp.config.kernel_cache_dir
    return len(os.listdir(folder)) if folder and os.path.isdir(folder) else 0


@dataclass
class _Worker:
    process: BaseProcess
    pipe: Connection
    case: CaseId
    since: float


def run_all(
    cases: Sequence[CaseId],
    device: str,
    jobs: int,
    seconds: float,
    run: RunCase = run_case,
) -> Generator[dict[str, Any], None, None]:
    """Results of the cases as they come, from ``jobs`` processes. Closing this ends them."""
    context = multiprocessing.get_context("spawn")
    waiting, workers = list(reversed(cases)), []

    def start() -> _Worker:
        mine, theirs = context.Pipe()
        process = context.Process(target=_serve, args=(theirs, device, seconds, run), daemon=True)
        process.start()
        theirs.close()
        worker = _Worker(process, mine, waiting.pop(), time.monotonic())
        mine.send(worker.case)
        return worker

    try:
        workers = [start() for _ in range(min(jobs, len(waiting)))]
        while workers:
            wait([worker.pipe for worker in workers], timeout=1.0)
            for place, worker in enumerate(list(workers)):
                result = _result(worker, seconds)
                if result is None:
                    continue
                yield result
                if not waiting:
                    _end(worker)
                    workers.remove(worker)
                elif worker.process.is_alive():
                    worker.case, worker.since = waiting.pop(), time.monotonic()
                    worker.pipe.send(worker.case)
                else:
                    workers[place] = start()
    finally:
        for worker in workers:
            _end(worker)


def _result(worker: _Worker, seconds: float) -> dict[str, Any] | None:
    """What a worker has to say, if anything; one that hangs is ended."""
    says = ""
    try:
        if worker.pipe.poll():
            return worker.pipe.recv()
        if time.monotonic() - worker.since > 2 * seconds + PATIENCE_S:
            says = f"no answer after {time.monotonic() - worker.since:.0f} s"
    except (EOFError, ConnectionResetError):
        says = "the process died"
    if not says:
        return None
    worker.process.kill()
    worker.process.join()
    family, seed = worker.case
    return {"family": family, "seed": seed, "outcome": "died", "says": says, "parameters": {}}


def _end(worker: _Worker) -> None:
    worker.pipe.close()
    worker.process.kill()
    worker.process.join()
