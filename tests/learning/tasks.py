# SPDX-License-Identifier: Apache-2.0
"""Changed copies of the peg insertion."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from taccel_lab.tasks.catalogue import Task, named
from taccel_lab.tasks.peg_insertion import PegInsertionParameters


def peg_parameters() -> PegInsertionParameters:
    """Of the package's file."""
    parameters = named("peg-insertion").parameters
    assert isinstance(parameters, PegInsertionParameters)
    return parameters


def peg_task(**changes: Any) -> Task:
    """The task of the package, with other parameters."""
    return replace(named("peg-insertion"), parameters=peg_parameters().replace(**changes))


def short_task(steps: int = 7, depth_mm: float = 0.5) -> Task:
    """Episodes of a few steps: a peg that goes down at once succeeds in the fifth."""
    return peg_task(steps=steps, goal=peg_parameters().goal.replace(depth_mm=depth_mm))
