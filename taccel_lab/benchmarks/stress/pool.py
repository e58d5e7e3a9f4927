# SPDX-License-Identifier: Apache-2.0
"""Cases in their own processes, several at once: one that hangs or dies takes nothing along."""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Sequence
from functools import partial
from typing import Any

from taccel_lab.benchmarks.stress.runner import run_case
from taccel_lab.processes.process_pool import Died, Finished, ProcessPool
from taccel_lab.progress import Progress

CaseId = tuple[str, int]
"""Family and seed."""
RunCase = Callable[[str, int, str, float], dict[str, Any]]
"""``(family, seed, device, seconds)``."""
PATIENCE_S = 900.0
"""Time beyond the budget after which a process is ended: kernels may have to be compiled, during
which no signal is heard."""


def run_all(
    cases: Sequence[CaseId],
    device: str,
    jobs: int,
    seconds: float,
    run: RunCase = run_case,
) -> Generator[dict[str, Any], None, None]:
    """Results of the cases as they come, from ``jobs`` processes. Closing this ends them."""
    work = partial(_run, run, device, seconds)
    with ProcessPool(work, jobs, limit_s=2 * seconds + PATIENCE_S) as pool:
        for event in pool.run(cases):
            if isinstance(event, Finished):
                yield event.result
            elif isinstance(event, Died):
                family, seed = event.item
                lost = {"outcome": "died", "says": event.cause, "parameters": {}}
                yield {"family": family, "seed": seed, **lost}


def _run(
    run: RunCase, device: str, seconds: float, case: CaseId, progress: Progress
) -> dict[str, Any]:
    """A case; again when its budget went into compiling kernels, which the cache has now."""
    before = _compiled()
    result = run(*case, device, seconds)
    if result["outcome"] == "budget" and _compiled() != before:
        result = run(*case, device, seconds)
    return result


def _compiled() -> int:
    """Modules in the kernel cache."""
    import warp as wp

    folder = wp.config.kernel_cache_dir
    return len(os.listdir(folder)) if folder and os.path.isdir(folder) else 0
