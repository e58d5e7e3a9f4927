# SPDX-License-Identifier: Apache-2.0
"""One seed of a task, recorded: where all is, what the gel shows, and the forces; and the recording
on disk, to be looked at from all sides.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.files.arrays import read_npz
from taccel_lab.files.atomic_file import write_by, write_json
from taccel_lab.files.documents import read_json
from taccel_lab.files.inner_path import inner_path
from taccel_lab.files.regular_file import shown
from taccel_lab.geometry import QuadraticMesh, Region, TetMesh
from taccel_lab.progress import Progress, silent
from taccel_lab.signals.gel_faces import Colors, face_grid, marker_points_mm
from taccel_lab.signals.markers import MarkerLayout
from taccel_lab.signals.tactile import SignalTactile
from taccel_lab.tasks.bodies import surfaces
from taccel_lab.tasks.catalogue import Task
from taccel_lab.tasks.result import TaskTrial

if TYPE_CHECKING:
    from taccel_lab.geometry import PixelGrid
    from taccel_lab.solvers import SolverIPC
    from taccel_lab.state import State

IMAGE_PX = 160
"""Height of the images of a gel."""


@dataclass(frozen=True)
class GelSnapshot:
    """A gel at one time."""

    depth_m: np.ndarray
    """Sink-in since rest, float32 [height, width]; negative where it rose, NaN beside the gel."""
    pressure_pa: np.ndarray
    """Contact pressure, float32 [height, width]; zero before the first step."""
    markers_px: np.ndarray
    """(u, v), float32 [marker, 2]; NaN where they are not seen."""
    rgb: np.ndarray | None
    """Tactile image, uint8 [height, width, 3]; None without colours."""


class GelWatch:
    """Reads environment 0 of one gel of a scene, in the gel's frame."""

    def __init__(self, solver: SolverIPC, gel: str, colors: Colors | None = None) -> None:
        """
        Args:
            solver: Of the scene.
            gel: Name of the soft body.
            colors: Colour network and untouched image of a grid; without them no tactile image.
        """
        index = solver.model.body_id(gel)
        mesh = solver.model.scene.soft_body(index).nodal_mesh
        self.grid: PixelGrid = face_grid(mesh, _size_px(mesh))
        points = MarkerLayout.from_points(mesh, marker_points_mm(self.grid))
        options: dict[str, Any] = {"markers": points}
        if colors is not None:
            options["color_model"], options["background_rgb"] = colors(self.grid)
        self._signal = SignalTactile.from_solver(solver, self.grid, gel=index, **options)
        self._colored = colors is not None

    def frame(self, state: State, stepped: bool) -> GelSnapshot:
        """The gel in a state; ``stepped``: whether the solver's forces are of this state."""
        signal = self._signal
        signal.update(state)
        depth = signal.depth_m.numpy()[0].copy()
        pressure = signal.pressure_pa.numpy()[0].copy() if stepped else np.zeros_like(depth)
        return GelSnapshot(
            depth_m=depth,
            pressure_pa=pressure,
            markers_px=signal.markers_px.numpy()[0].astype(np.float32),
            rgb=signal.rgb.numpy()[0].copy() if self._colored else None,
        )


def _size_px(mesh: TetMesh | QuadraticMesh) -> tuple[int, int]:
    """Square pixels over the contact face."""
    face = mesh.nodes_m[np.unique(mesh.region_faces(Region.CONTACT))][:, :2]
    width, height = np.ptp(face, axis=0)
    return max(1, round(IMAGE_PX * width / height)), IMAGE_PX


REPLAY = "replay.json"
KINDS = ("soft", "affine", "kinematic")
_ARRAYS = "replay.npz"


@dataclass(frozen=True)
class ReplayBody:
    """The surface of a body in every frame."""

    name: str
    kind: str
    """soft, affine or kinematic."""
    vertices_m: np.ndarray
    """Float32 [frame, vertex, 3]."""
    faces: np.ndarray


@dataclass(frozen=True)
class TaskReplay:
    """Frames of one seed."""

    task: str
    seed: int
    cause: str
    """Why the seed failed; empty for success."""
    times_s: np.ndarray
    """[frame]."""
    bodies: list[ReplayBody]
    forces_n: dict[str, np.ndarray]
    """Forces by name, [frame]."""
    depth_m: np.ndarray
    """Depths as of ``GelSnapshot``, float32 [frame, height_px, width_px]."""
    pressure_pa: np.ndarray
    """Float32 [frame, height_px, width_px]."""
    markers_px: np.ndarray
    """Float32 [frame, marker, 2]."""
    rgb: np.ndarray
    """Tactile images, uint8 [frame, height_px, width_px, 3]."""

    @property
    def outcome(self) -> str:
        """Success or failure, in words."""
        return f"failure: {self.cause}" if self.cause else "success"


def write_replay(replay: TaskReplay, folder: Path) -> None:
    """Write ``replay.json`` and ``replay.npz`` into a folder that exists."""
    names = ("times_s", "depth_m", "pressure_pa", "markers_px", "rgb")
    arrays = {name: getattr(replay, name) for name in names}
    arrays["forces_n"] = np.stack(list(replay.forces_n.values()), axis=1)
    for k, body in enumerate(replay.bodies):
        arrays |= {f"vertices_m_{k}": body.vertices_m, f"faces_{k}": body.faces}
    write_by(folder / _ARRAYS, partial(np.savez_compressed, **arrays))
    about = {"task": replay.task, "seed": replay.seed, "cause": replay.cause}
    bodies = [{"name": body.name, "kind": body.kind} for body in replay.bodies]
    write_json(folder / REPLAY, {**about, "bodies": bodies, "forces": list(replay.forces_n)})


def read_replay(folder: Path) -> TaskReplay:
    """What ``write_replay`` wrote; InputError for anything else."""
    about = read_json(inner_path(folder, REPLAY))
    arrays = read_npz(inner_path(folder, _ARRAYS))
    try:
        bodies = [
            ReplayBody(body["name"], body["kind"], arrays[f"vertices_m_{k}"], arrays[f"faces_{k}"])
            for k, body in enumerate(about["bodies"])
        ]
        forces = {name: arrays["forces_n"][:, k] for k, name in enumerate(about["forces"])}
        replay = TaskReplay(
            about["task"], int(about["seed"]), str(about["cause"]), arrays["times_s"], bodies,
            forces, arrays["depth_m"], arrays["pressure_pa"], arrays["markers_px"],
            arrays["rgb"],
        )  # fmt: skip
        _check(replay)
        return replay
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise InputError(f"{folder} is no replay of a task as it is recorded: {error}") from None


def _check(replay: TaskReplay) -> None:
    """ValueError for arrays that are not those of as many frames."""
    frames = replay.times_s.shape
    wanted: list[tuple[str, np.ndarray, bool]] = [
        ("times_s", replay.times_s, len(frames) == 1 and replay.times_s.size > 0),
        ("depth_m", replay.depth_m, replay.depth_m.ndim == 3 and replay.depth_m.size > 0),
        ("pressure_pa", replay.pressure_pa, replay.pressure_pa.shape == replay.depth_m.shape),
        ("markers_px", replay.markers_px, replay.markers_px.shape[2:] == (2,)),
        ("rgb", replay.rgb, replay.rgb.shape == (*replay.depth_m.shape, 3)),
        *((f"force {name}", force, force.ndim == 1) for name, force in replay.forces_n.items()),
    ]
    for k, body in enumerate(replay.bodies):
        places, faces = body.vertices_m, body.faces
        shaped = places.ndim == 3 and places.shape[2] == 3 and places.size > 0
        wanted.append((f"vertices_m_{k}", places, shaped and bool(np.isfinite(places).all())))
        if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu":
            raise ValueError(f"faces_{k} are {faces.shape} of {faces.dtype}, not triangles")
        if faces.size and not 0 <= faces.min() <= faces.max() < places.shape[1]:
            raise ValueError(f"faces_{k} name vertices that are not there")
        if body.kind not in KINDS:
            raise ValueError(f"body {k} is {shown(body.kind)}, not {', '.join(KINDS)}")
    if not replay.bodies:
        raise ValueError("there is no body in it")
    for name, array, right in wanted:
        if not right or array.shape[:1] != frames or array.dtype.kind not in "fiu":
            raise ValueError(f"{name} is {array.shape} of {array.dtype}, for {frames} frames")


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
