# SPDX-License-Identifier: Apache-2.0
"""One seed of a task, recorded: where all is, what the gel shows, and the forces."""

from __future__ import annotations

from typing import Any

import numpy as np

from taccel_lab.progress import Progress, silent
from taccel_lab.signals.gel_faces import Colors
from taccel_lab.tasks.bodies import surfaces
from taccel_lab.tasks.catalogue import Task
from taccel_lab.tasks.gel_watch import GelSnapshot, GelWatch
from taccel_lab.tasks.replay import ReplayBody, TaskReplay
from taccel_lab.tasks.result import TaskTrial

FRAMES_PER_S = 25
"""A frame shows a step of 1 / 25 s, or of the task's own where these are longer."""


def record_seed(
    task: Task,
    seed: int,
    device: str | None = None,
    progress: Progress = silent,
    *,
    colors: Colors,
) -> tuple[TaskReplay, TaskTrial]:
    """Run one seed and record it; ``colors``: of the gel's tactile images."""
    episode = task.begin([seed], device)
    dt = task.parameters.dt_s
    every = max(1, round(1 / (FRAMES_PER_S * dt)))
    watch = GelWatch(episode.solver, episode.gel, colors)
    times_s: list[float] = []
    bodies: list[list[tuple[Any, np.ndarray, np.ndarray]]] = []
    gel: list[GelSnapshot] = []
    forces: list[dict[str, float]] = []

    def show() -> None:
        times_s.append(episode.taken * dt)
        positions = episode.state.positions.numpy()[0].copy()
        bodies.append(surfaces(episode.scene, episode.model, positions))
        gel.append(watch.frame(episode.state, stepped=episode.taken > 0))
        forces.append(episode.forces())

    show()
    while not episode.over:
        episode.advance()
        progress(task.name, episode.taken, episode.step_limit)
        if episode.taken % every == 0:
            show()
    trial = episode.trials()[0]
    replay = TaskReplay(
        task=task.name,
        seed=seed,
        cause=trial.cause,
        times_s=np.array(times_s),
        bodies=[
            ReplayBody(
                f"body {k}",
                kind.name.lower(),
                np.stack([frame[k][1] for frame in bodies]).astype(np.float32),
                np.asarray(faces, dtype=np.int32),
            )
            for k, (kind, _, faces) in enumerate(bodies[0])
        ],
        forces_n={name: np.array([row[name] for row in forces]) for name in forces[0]},
        depth_m=np.array([frame.depth_m for frame in gel]),
        pressure_pa=np.array([frame.pressure_pa for frame in gel]),
        markers_px=np.array([frame.markers_px for frame in gel]),
        rgb=np.array([frame.rgb for frame in gel]),
    )
    return replay, trial
