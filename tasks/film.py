# SPDX-License-Identifier: Apache-2.0
"""A film of one seed: the scene, the gel's change in height, and the forces, side by side."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from taccel_lab.files.atomic_file import write_image
from taccel_lab.geometry import PixelGrid
from taccel_lab.progress import Progress, silent
from taccel_lab.report.style import BLUE, GREEN, ORANGE, PURPLE, in_report_style, new_figure
from taccel_lab.signals.gel_faces import Colors
from taccel_lab.tasks.catalogue import Task
from taccel_lab.tasks.episode import TaskEpisode
from taccel_lab.tasks.gel_watch import GelSnapshot, GelWatch
from taccel_lab.tasks.result import TaskTrial
from taccel_lab.tasks.scene_picture import SceneCamera, surfaces

FRAMES_PER_S = 25
"""Of films; a frame shows a step of 1 / 25 s, or of the task's own where these are longer."""


@dataclass
class Film:
    """Frames of one seed."""

    name: str
    episode: TaskEpisode
    grid: PixelGrid
    times_s: list[float] = field(default_factory=list)
    positions_m: list[np.ndarray] = field(default_factory=list)
    """Of all nodes, [node_count, 3]."""
    gel: list[GelSnapshot] = field(default_factory=list)
    forces_n: list[dict[str, float]] = field(default_factory=list)


def film_seed(
    task: Task,
    seed: int,
    device: str | None = None,
    progress: Progress = silent,
    colors: Colors | None = None,
) -> tuple[Film, TaskTrial]:
    """Run one seed and record it; ``colors``: of the gel's tactile images, none without."""
    episode = task.begin([seed], device)
    dt = task.parameters.dt_s
    every = max(1, round(1 / (FRAMES_PER_S * dt)))
    watch = GelWatch(episode.solver, episode.gel, colors)
    film = Film(task.name, episode, watch.grid)

    def show() -> None:
        film.times_s.append(episode.taken * dt)
        film.positions_m.append(episode.state.positions.numpy()[0].copy())
        film.gel.append(watch.frame(episode.state, stepped=episode.taken > 0))
        film.forces_n.append(episode.forces())

    show()
    while not episode.over:
        episode.advance()
        progress(task.name, episode.taken, episode.step_limit)
        if episode.taken % every == 0:
            show()
    return film, episode.trials()[0]


def _scene_pictures(film: Film) -> Iterator[np.ndarray]:
    """Pictures of the scene, frame by frame, from where all of them are in view."""
    scene, model = film.episode.scene, film.episode.model
    frames = (surfaces(scene, model, positions) for positions in film.positions_m)
    seen = [np.concatenate([vertices for _, vertices, _ in bodies]) for bodies in frames]
    low = np.min([points.min(axis=0) for points in seen], axis=0)
    high = np.max([points.max(axis=0) for points in seen], axis=0)
    ground = scene.planes[0].point_m[2] if scene.planes else None
    first = surfaces(scene, model, film.positions_m[0])
    camera = SceneCamera(
        first, film.episode.direction, box_m=np.stack([low, high]), ground_m=ground
    )
    try:
        for positions in film.positions_m:
            yield camera.picture(surfaces(scene, model, positions))
    finally:
        camera.close()


@in_report_style
def write_film(film: Film, path: Path) -> np.ndarray:
    """Write an MP4 file (MPEG-4 part 2) by OpenCV, and return the last frame, RGB.

    Raises OSError where the file cannot be written.
    """
    import cv2

    names = list(film.forces_n[0])
    forces = np.array([[row[name] for name in names] for row in film.forces_n])
    figure, (left, middle, right) = new_figure(
        12.8, 4.4, 1, 3, gridspec_kw={"width_ratios": [1.15, 1.0, 1.25]}
    )
    pictures = _scene_pictures(film)
    scene = left.imshow(np.zeros((520, 520, 3), dtype=np.uint8))
    left.axis("off")
    title = left.set_title("")
    rises = -1e3 * np.array([frame.depth_m for frame in film.gel])
    # A face that is folded over has a few pixels that look millimetres down its side.
    reach = max(float(np.nanquantile(np.abs(rises), 0.99)), 1e-6)
    side = (film.grid.x_mm()[[0, -1]], film.grid.y_mm()[[0, -1]])
    gel = middle.imshow(
        rises[0],
        extent=(side[0][0], side[0][1], side[1][1], side[1][0]),
        cmap="RdBu_r",
        vmin=-reach,
        vmax=reach,
    )
    middle.set_title("gel: change in height")
    middle.set(xlabel="x [mm]", ylabel="y [mm]")
    figure.colorbar(gel, ax=middle, label="[mm]", shrink=0.8)
    colors = (BLUE, ORANGE, GREEN, PURPLE)
    lines = [
        right.plot([], [], label=name, color=color)[0]
        for name, color in zip(names, colors, strict=False)
    ]
    right.set_xlim(0, max(film.times_s[-1], 1 / FRAMES_PER_S))
    right.set_ylim(0, 1.05 * max(float(forces.max()), 1e-3))
    right.set_xlabel("time [s]")
    right.set_ylabel("force [N]")
    # Above the lines: beside them it would hide some, or jump about as they grow.
    right.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False)
    writer, pixels = None, np.zeros(0)
    try:
        for i, (time_s, picture) in enumerate(zip(film.times_s, pictures, strict=True)):
            scene.set_data(picture)
            gel.set_data(rises[i])
            title.set_text(f"{film.name}, {time_s:.2f} s")
            for k, line in enumerate(lines):
                line.set_data(film.times_s[: i + 1], forces[: i + 1, k])
            figure.canvas.draw()
            pixels = np.asarray(figure.canvas.buffer_rgba())[..., :3].copy()  # type: ignore[attr-defined]
            pixels = pixels[: pixels.shape[0] // 2 * 2, : pixels.shape[1] // 2 * 2]
            if writer is None:
                size = (pixels.shape[1], pixels.shape[0])
                code = cv2.VideoWriter.fourcc(*"mp4v")
                writer = cv2.VideoWriter(str(path), code, float(FRAMES_PER_S), size)
                if not writer.isOpened():
                    raise OSError(f"{path} could not be written as MP4 by OpenCV")
            writer.write(np.ascontiguousarray(pixels[..., ::-1]))
    finally:
        if writer is not None:
            writer.release()
    return pixels


def write_film_files(film: Film, folder: Path) -> None:
    """``film.mp4`` and its last frame, ``film.png``."""
    write_image(folder / "film.png", write_film(film, folder / "film.mp4")[..., ::-1])
