# SPDX-License-Identifier: Apache-2.0
"""Tasks of the catalogue with changed parameters."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from taccel_lab.tasks.catalogue import Task, named, run_task
from taccel_lab.tasks.result import TaskTrial


def parameters(name: str) -> Any:
    return named(name).parameters


def task_with(name: str, **changes: Any) -> Task:
    """The task with other parameters; a dict changes entries of a table."""
    found = parameters(name)
    for part, change in changes.items():
        if isinstance(change, dict):
            change = getattr(found, part).replace(**change)
        found = found.replace(**{part: change})
    return replace(named(name), parameters=found)


def first_trial(task: Task, seed: int = 0, **options: Any) -> TaskTrial:
    (trial,) = run_task(task, [seed], "cpu", **options).trials
    return trial
