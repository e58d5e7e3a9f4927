# SPDX-License-Identifier: Apache-2.0
"""One seed of a task, recorded: where all is, what the gel shows, and the forces."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from taccel_lab.geometry import PixelGrid
from taccel_lab.progress import Progress, silent
from taccel_lab.signals.gel_faces import Colors
from taccel_lab.tasks.catalogue import Task
from taccel_lab.tasks.episode import TaskEpisode
from taccel_lab.tasks.gel_watch import GelSnapshot, GelWatch
from taccel_lab.tasks.result import TaskTrial

FRAMES_PER_S = 25
"""A frame shows a step of 1 / 25 s, or of the task's own where these are longer."""


@dataclass
class TaskRecording:
    """Frames of one seed."""

    name: str
    episode: TaskEpisode
    grid: PixelGrid
    times_s: list[float] = field(default_factory=list)
    positions_m: list[np.ndarray] = field(default_factory=list)
    """Of all nodes, [node_count, 3]."""
    gel: list[GelSnapshot] = field(default_factory=list)
    forces_n: list[dict[str, float]] = field(default_factory=list)


def record_seed(
    task: Task,
    seed: int,
    device: str | None = None,
    progress: Progress = silent,
    *,
    colors: Colors,
) -> tuple[TaskRecording, TaskTrial]:
    """Run one seed and record it; ``colors``: of the gel's tactile images."""
    episode = task.begin([seed], device)
    dt = task.parameters.dt_s
    every = max(1, round(1 / (FRAMES_PER_S * dt)))
    watch = GelWatch(episode.solver, episode.gel, colors)
    recording = TaskRecording(task.name, episode, watch.grid)

    def show() -> None:
        recording.times_s.append(episode.taken * dt)
        recording.positions_m.append(episode.state.positions.numpy()[0].copy())
        recording.gel.append(watch.frame(episode.state, stepped=episode.taken > 0))
        recording.forces_n.append(episode.forces())

    show()
    while not episode.over:
        episode.advance()
        progress(task.name, episode.taken, episode.step_limit)
        if episode.taken % every == 0:
            show()
    return recording, episode.trials()[0]
