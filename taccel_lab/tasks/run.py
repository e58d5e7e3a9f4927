# SPDX-License-Identifier: Apache-2.0
"""Run the seeds of a task."""

from __future__ import annotations

import time
from collections.abc import Sequence

from taccel_lab.errors import InputError
from taccel_lab.progress import Progress, silent
from taccel_lab.tasks.catalogue import Task
from taccel_lab.tasks.result import TaskResult, TaskTrial


def run_task(
    task: Task,
    seeds: Sequence[int],
    device: str | None = None,
    *,
    steps: int | None = None,
    progress: Progress = silent,
) -> TaskResult:
    """Run seeds, ``parameters.environments`` of them at a time as environments of one solver.

    Ctrl-C ends the run after the last group that is finished; without one it goes on up.

    Args:
        task: The task.
        seeds: Each decides one start.
        device: "cpu" or "cuda:0"; as of ``Scene.finalize`` when None.
        steps: End after so many, for a try; the judgement is then of that moment.
        progress: Told of each step.
    """
    if not seeds:
        raise InputError("a run needs at least one seed")
    limit = steps or task.parameters.steps
    groups = task.made_by.groups(task.parameters, seeds)
    trials: list[TaskTrial] = []
    started = time.perf_counter()
    try:
        for number, group in enumerate(groups):
            episode = task.begin(group, device)
            while not episode.over and episode.taken < limit:
                episode.advance()
                progress(task.name, number * limit + episode.taken, len(groups) * limit)
            trials += episode.trials()
    except KeyboardInterrupt:
        if not trials:
            raise
    trials = task.made_by.conclude(task.parameters, trials, device)
    return TaskResult(task.name, trials, time.perf_counter() - started, len(seeds))
