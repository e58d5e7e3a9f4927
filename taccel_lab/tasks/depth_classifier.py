# SPDX-License-Identifier: Apache-2.0
"""A small network that tells parts by the depth maps of two gels, and the nearest grasp beside it.

The hand of two like gels is the same after half a turn about any of its axes, so that each grasp
stands for four: both maps turned by half a turn, the gels exchanged, and both (``alike``).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field

from taccel_lab.files.strict_model import StrictModel, Whole
from taccel_lab.tasks.parameters import Count, Positive

if TYPE_CHECKING:
    import torch

SCALE = 1e3
"""Depths go into the network in mm."""
VARIED_RAD, VARIED_PX = 0.35, 3.0
"""By how much the grasps of a lesson are turned and moved at most."""


class Learner(StrictModel):
    """The network that is taught, and how it is judged."""

    regions: Annotated[Whole, Field(ge=2, le=36)]
    """Equal sectors of the turn, modulo 180 degrees, which the symmetry of the hand makes alike."""
    epochs: Count
    batch: Count
    learning_rate: Positive


def folds(count: int, parts: int) -> np.ndarray:
    """A fold for each of ``count`` grasps, at random, int, as even as can be."""
    return np.random.default_rng(0).permutation(count) % parts


def alike(maps: np.ndarray) -> np.ndarray:
    """The four grasps that each stands for: maps [n, 2, h, w] to [4, n, 2, h, w].

    Gels look at each other: half a turn about the line between them turns both maps, half a turn
    about the vertical exchanges them, as each gel's x points the other way across the hand.
    """
    turned = maps[..., ::-1, ::-1]
    return np.stack([maps, turned, maps[:, ::-1], turned[:, ::-1]])


def nearest(maps: np.ndarray, truth: np.ndarray, fold: np.ndarray) -> np.ndarray:
    """Part of the nearest grasp of other folds, by the squared difference of the maps, [n]."""
    flat = (SCALE * alike(maps)).reshape(4, len(maps), -1)
    predicted = np.empty(len(maps), dtype=int)
    for i in range(len(maps)):
        others = np.flatnonzero(fold != fold[i])
        away = ((flat[:, others] - flat[0, i]) ** 2).sum(axis=2).min(axis=0)
        predicted[i] = truth[others[np.argmin(away)]]
    return predicted


def judge_by_folds(
    maps: np.ndarray,
    truth: np.ndarray,
    fold: np.ndarray,
    learner: Learner,
    device: str | None = None,
) -> np.ndarray:
    """Predict the part of each grasp by a network trained on the other folds.

    Args:
        maps: Depth maps [m], [n, 2, height, width].
        truth: Number of the part, int, [n].
        fold: Of each grasp, int, [n].
        learner: How it is taught.
        device: Where; the CPU when None.
    """
    import torch

    predicted = np.empty(len(maps), dtype=int)
    for number in np.unique(fold):
        held_out = fold == number
        network = taught(maps[~held_out], truth[~held_out], learner, device)
        with torch.no_grad():
            tries = _inputs(maps[held_out], device)
            votes = torch.stack([network(each).softmax(dim=1) for each in tries]).sum(dim=0)
        predicted[held_out] = votes.argmax(dim=1).cpu().numpy()
    return predicted


def taught(
    maps: np.ndarray, truth: np.ndarray, learner: Learner, device: str | None = None
) -> torch.nn.Sequential:
    """A network after its lessons: always the same for the same grasps on the same CPU."""
    import torch
    from torch import nn

    count = int(truth.max()) + 1
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        network = nn.Sequential(
            nn.Conv2d(2, 16, 3, padding=1), nn.BatchNorm2d(16), nn.ReLU(), nn.MaxPool2d(2),
            nn.Conv2d(16, 32, 3, padding=1), nn.BatchNorm2d(32), nn.ReLU(), nn.MaxPool2d(2),
            nn.Conv2d(32, 64, 3, padding=1), nn.BatchNorm2d(64), nn.ReLU(),
            nn.AdaptiveMaxPool2d(2), nn.Flatten(), nn.Dropout(0.3), nn.Linear(256, count),
        ).to(device or "cpu")  # fmt: skip
        inputs, labels = _inputs(maps, device), torch.as_tensor(truth, device=device or "cpu")
        steps = -(-len(maps) // learner.batch)
        adam = torch.optim.Adam(network.parameters(), weight_decay=1e-4)
        schedule = torch.optim.lr_scheduler.OneCycleLR(
            adam, learner.learning_rate, total_steps=learner.epochs * steps
        )
        for _ in range(learner.epochs):
            for chosen in torch.randperm(len(maps)).chunk(steps):
                # Drawn on the host, so that a GPU is taught by the same lessons.
                batch = inputs[torch.randint(4, (len(chosen),)), chosen]
                loss = nn.functional.cross_entropy(network(_varied(batch)), labels[chosen])
                adam.zero_grad()
                loss.backward()
                adam.step()
                schedule.step()
    return network.eval()


def _inputs(maps: np.ndarray, device: str | None) -> torch.Tensor:
    """Of the four grasps that each stands for, [4, n, 2, h, w]."""
    import torch

    return torch.as_tensor((SCALE * alike(maps)).astype(np.float32), device=device or "cpu")


def _varied(batch: torch.Tensor) -> torch.Tensor:
    """Grasps [n, 2, h, w] as of a hand that is turned and moved by a little: the maps of gels that
    look at each other turn the opposite way, and go the opposite way across."""
    import torch
    from torch import nn

    n, _, height, width = batch.shape
    part = 2 * torch.rand(3, n) - 1
    angle = part[0] * VARIED_RAD
    across, up = part[1] * VARIED_PX / (width / 2), part[2] * VARIED_PX / (height / 2)
    shape = height / width
    found = []
    for side, sign in enumerate((1.0, -1.0)):
        c, s = angle.cos(), sign * angle.sin()
        rows = torch.stack([c, -s * shape, sign * across, s / shape, c, up], dim=1)
        size = [n, 1, height, width]
        grid = nn.functional.affine_grid(rows.view(n, 2, 3), size, align_corners=False)
        one = batch[:, side : side + 1]
        found.append(nn.functional.grid_sample(one, grid.to(one), align_corners=False))
    return torch.cat(found, dim=1)
