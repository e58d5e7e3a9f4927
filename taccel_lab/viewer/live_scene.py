# SPDX-License-Identifier: Apache-2.0
"""A scene that steps in a thread while a page shows it, and the page of a recorded task."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from taccel_lab.geometry.shading_normals import split_at_creases
from taccel_lab.report.page_text import PageText, add_note, page_table
from taccel_lab.tasks.bodies import surfaces
from taccel_lab.tasks.replay import GelSnapshot, GelWatch, read_replay
from taccel_lab.viewer.gel_states import Field, SensorImages
from taccel_lab.viewer.page_parts import SensorPanel, TimeSlider, look_at

if TYPE_CHECKING:
    from viser import MeshHandle, ViserServer

    from taccel_lab.signals.gel_faces import Colors
    from taccel_lab.solvers import SolverIPC
    from taccel_lab.state import State


COLORS = {"soft": (127, 178, 217), "affine": (224, 164, 88), "kinematic": (184, 184, 184)}
"""Colours as in the pictures of benchmarks."""
CLEAR = {"kinematic": 0.35, "soft": 0.8}


class BodiesView:
    """Surfaces that move; positions are shown in mm."""

    def __init__(
        self, server: ViserServer, bodies: list[tuple[str, np.ndarray, np.ndarray]]
    ) -> None:
        """``bodies``: kind, vertices [m] and triangles of each; sharp edges are those of now."""
        self._server = server
        split = [split_at_creases(vertices, faces) for _, vertices, faces in bodies]
        self._copied = [copied for copied, _ in split]
        self._meshes: list[MeshHandle] = [
            server.scene.add_mesh_simple(
                f"/bodies/{k}", 1e3 * vertices[copied], faces, color=COLORS[kind],
                opacity=CLEAR.get(kind), side="double", cast_shadow=False, receive_shadow=False,
            )
            for k, ((kind, vertices, _), (copied, faces)) in enumerate(
                zip(bodies, split, strict=True)
            )
        ]  # fmt: skip

    def move(self, vertices_m: list[np.ndarray]) -> None:
        """Show them elsewhere; as many bodies and vertices as at first."""
        with self._server.atomic():
            for mesh, copied, vertices in zip(self._meshes, self._copied, vertices_m, strict=True):
                mesh.vertices = (1e3 * vertices[copied]).astype(np.float32)


LEAST_MM, LEAST_KPA = 0.01, 0.1
"""Least reach of the colour bars: less is noise."""
SHARE = 0.999
"""Share of pixels that the bar of the depth reaches: a face that folds shows a few far away."""


def gel_images(
    rgb: np.ndarray, depth_m: np.ndarray, pressure_pa: np.ndarray, markers_px: np.ndarray
) -> SensorImages:
    """Images of a row of states.

    Args:
        rgb: Tactile images, uint8 [state, height, width, 3].
        depth_m: [state, height, width]; negative where the face rose.
        pressure_pa: [state, height, width].
        markers_px: [state, marker, 2], at rest in the first.
    """
    depth_mm, pressure_kpa = 1e3 * depth_m, 1e-3 * pressure_pa
    known = depth_mm[np.isfinite(depth_mm)]
    low, high = np.quantile(known, (1 - SHARE, SHARE)) if known.size else (0.0, 0.0)
    top = float(np.nanmax(pressure_kpa, initial=0.0))
    maps = (
        Field("depth", "mm", depth_mm, (min(float(low), 0.0), max(float(high), LEAST_MM))),
        Field("contact pressure", "kPa", pressure_kpa, (0.0, max(top, LEAST_KPA))),
    )
    return SensorImages(rgb, markers_px, maps)


DIRECTION = (1.0, -1.4, 0.25)
"""Direction from which scenes are seen: the side, as gels may hide what is below them."""


class Stepping(Protocol):
    """What a page can run: a ``TaskEpisode``, or anything of a user's with these names."""

    solver: SolverIPC
    state: State
    gel: str
    """Name of the soft body whose images are shown."""

    @property
    def over(self) -> bool:
        """Whether there is nothing more to step."""
        ...

    def advance(self) -> None:
        """Take a step."""
        ...

    def forces(self) -> dict[str, float]:
        """What is shown beside the scene, by name [N]."""
        ...

    def outcome(self) -> str:
        """Success or failure in words, once it is over."""
        ...


class LiveScene:
    """Environment 0 of what ``begin`` makes.

    ``begin`` is called in the page's own thread, again at each restart; ``close`` ends the thread
    after the step that it is in.
    """

    def __init__(
        self,
        server: ViserServer,
        title: str,
        begin: Callable[[], Stepping],
        colors: Colors | None = None,
    ) -> None:
        """``colors``: of the tactile images; those of a starter profile when None."""
        self._colors = colors
        self._watch: GelWatch | None = None
        self._frames: list[GelSnapshot] = []
        """Frames at rest, and now."""
        self._server, self._begin, self._title = server, begin, title
        self._play, self._end, self._restart = threading.Event(), threading.Event(), True
        self._single = False
        self._view: BodiesView | None = None
        self.taken = 0
        """Steps since the start."""
        gui = server.gui
        self._caption = add_note(gui, PageText("**{}**: the scene is built …").format(title))
        self._buttons = gui.add_button_group("run", ("play", "pause", "step", "restart"))
        self._pace = gui.add_checkbox("no faster than real time", True)
        self._table = add_note(gui)
        self._panel = SensorPanel(server, "Gel")
        self._buttons.on_click(lambda event: self.press(event.target.value))
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def press(self, button: str) -> None:
        """Acts as if the button was pressed: play, pause, step, restart."""
        if button == "play":
            self._play.set()
        else:
            self._play.clear()
            self._single = button == "step"
            self._restart = self._restart or button == "restart"

    def close(self) -> None:
        """End after the step at hand."""
        self._end.set()
        self._thread.join(timeout=30)

    def _run(self) -> None:
        from taccel_lab.errors import SimulationError

        scene: Stepping | None = None
        while not self._end.is_set():
            if self._restart or scene is None:
                self._restart, self.taken = False, 0
                scene = self._begin()
                self._watch = GelWatch(scene.solver, scene.gel, self._colors or _starter_colors())
                self._show(scene, first=True)
            if scene.over or not (self._play.is_set() or self._single):
                self._end.wait(0.05)
                continue
            self._single = False
            began = time.perf_counter()
            try:
                scene.advance()
            except SimulationError as error:
                self._play.clear()
                self._caption.content = PageText("**{}** stopped: {}").format(self._title, error)
                continue
            self.taken += 1
            self._show(scene, seconds=time.perf_counter() - began)
            left = scene.solver.model.scene.time.dt_s
            if self._pace.value:
                self._end.wait(max(0.0, left - (time.perf_counter() - began)))

    def _show(self, scene: Stepping, first: bool = False, seconds: float = 0.0) -> None:
        positions = scene.state.positions.numpy()[0].copy()
        model = scene.solver.model
        bodies = surfaces(model.scene, model, positions)
        places = [vertices for _, vertices, _ in bodies]
        if first or self._view is None:
            if self._view is None:
                look_at(self._server, 1e3 * np.concatenate(places), DIRECTION)
            kinds = [(kind.name.lower(), vertices, faces) for kind, vertices, faces in bodies]
            self._view = BodiesView(self._server, kinds)
        else:
            self._view.move(places)
        done = PageText(", **{}**").format(scene.outcome()) if scene.over else ""
        took = f", {seconds:.2f} s a step" if seconds else ""
        caption = PageText("**{}**, step {}{}{}")
        self._caption.content = caption.format(self._title, self.taken, took, done)
        if not first:
            forces = [(name, f"{value:.3f} N") for name, value in scene.forces().items()]
            self._table.content = page_table(forces, ("force", ""))
        self._show_gel(scene)

    def _show_gel(self, scene: Stepping) -> None:
        assert self._watch is not None
        now = self._watch.frame(scene.state, stepped=self.taken > 0)
        self._frames = [self._frames[0] if self.taken and self._frames else now, now]
        both = self._frames
        assert now.rgb is not None
        rgb, depth, pressure, markers = (
            np.stack([getattr(frame, name) for frame in both])
            for name in ("rgb", "depth_m", "pressure_pa", "markers_px")
        )
        self._panel.show(gel_images(rgb, depth, pressure, markers), 1)


def _starter_colors() -> Colors:
    from taccel_lab.learning.gel_colors import default_colors

    return default_colors(None)


def fill_replay_page(server: ViserServer, folder: Path) -> TimeSlider:
    """Show what ``taccel-lab task record`` kept."""
    replay = read_replay(folder)
    every = np.concatenate([body.vertices_m.reshape(-1, 3) for body in replay.bodies])
    look_at(server, 1e3 * every.astype(np.float64), DIRECTION)
    view = BodiesView(server, [(b.kind, b.vertices_m[0], b.faces) for b in replay.bodies])
    images = gel_images(replay.rgb, replay.depth_m, replay.pressure_pa, replay.markers_px)
    caption = add_note(server.gui)
    panel = SensorPanel(server, "Gel")

    def show(frame: int) -> None:
        view.move([body.vertices_m[frame] for body in replay.bodies])
        forces = [(name, f"{values[frame]:.3f} N") for name, values in replay.forces_n.items()]
        caption.content = PageText("**{}**, seed {}: {}\n\n{:.2f} s\n\n{}").format(
            replay.task, replay.seed, replay.outcome, replay.times_s[frame],
            page_table(forces, ("force", "")),
        )  # fmt: skip
        panel.show(images, frame)

    slider = TimeSlider(server, len(replay.times_s), show)
    show(0)
    return slider
