# SPDX-License-Identifier: Apache-2.0
"""Observations on the host; changed copies of the peg insertion."""

from __future__ import annotations

import numpy as np
import torch

from taccel_lab.tasks.catalogue import Task
from tests.tasks.changed import task_with


def as_numpy(observation: dict[str, torch.Tensor]) -> dict[str, np.ndarray]:
    return {name: part.numpy() for name, part in observation.items()}


def short_task(steps: int = 7) -> Task:
    """Episodes of a few steps: a peg that goes down at once succeeds in the fifth."""
    return task_with("peg-insertion", steps=steps, goal={"depth_mm": 0.5})
