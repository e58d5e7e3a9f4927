# SPDX-License-Identifier: Apache-2.0
"""The page of a study: designs sorted by a metric; a click shows the gel and the presses of one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.files.arrays import finite_numbers, read_npz
from taccel_lab.files.inner_path import inner_path
from taccel_lab.report.page_text import PageText, add_note, page_table
from taccel_lab.sensors.registry import sensor_family
from taccel_lab.studies.evaluate.design_row import DesignRow
from taccel_lab.studies.evaluate.study_folder import StudyFolder
from taccel_lab.viewer.gel_states import GelStates
from taccel_lab.viewer.gel_view import GelView
from taccel_lab.viewer.page_parts import look_at

if TYPE_CHECKING:
    from viser import ViserServer


_NEEDED = ("depth_mm", "force_n", "contact_rest_m", "contact_moved_m", "contact_faces")


def design_gel(row: DesignRow) -> GelStates:
    """The untouched gel of a design, at the resolution of profiles."""
    from taccel_lab.cad.mesh.gel_mesh import gel_mesh

    pad = sensor_family(row.family).parameters(row.parameters).pad()
    return GelStates.untouched(gel_mesh(pad))


def press_files(root: Path, row: DesignRow) -> dict[str, Path]:
    """The presses that a design's folder keeps, by name."""
    folder = root / "designs" / row.id
    found = sorted(path.relative_to(root).as_posix() for path in folder.glob("press_*.npz"))
    paths = [inner_path(root, name) for name in found]
    return {path.stem.removeprefix("press_"): path for path in paths}


def read_design_press(path: Path) -> GelStates:
    """The contact face at rest and after each step of a press of a study.

    Raises InputError for a file that is not one, or that has no step.
    """
    arrays = read_npz(path, _NEEDED)
    moved = 1e3 * finite_numbers(arrays, "contact_moved_m", path)
    if len(moved) == 0:
        raise InputError(f"{path}: no step of this press converged")
    depths, forces = (finite_numbers(arrays, name, path) for name in ("depth_mm", "force_n"))
    if depths.shape != moved.shape[:1] or forces.shape != (*depths.shape, 3):
        raise InputError(f"{path}: its depths and forces are not those of {len(moved)} steps")
    captions = [
        f"depth {depth:.2f} mm, force {force[2]:.3f} N along the press"
        for depth, force in zip(depths, forces, strict=True)
    ]
    return GelStates(
        rest_mm=1e3 * finite_numbers(arrays, "contact_rest_m", path),
        faces=arrays["contact_faces"].astype(np.int64),
        moved_mm=np.concatenate([np.zeros_like(moved[:1]), moved]),
        captions=["untouched", *captions],
    ).checked(path)


ROWS = 8
"""Designs that are listed at a time."""
GEL = "the gel alone"


class StudyPage:
    """The list of designs, and the one that is chosen."""

    def __init__(self, server: ViserServer, root: Path) -> None:
        folder = StudyFolder(root)
        found = [folder.read(one) for one in folder.ids()]
        self._root = root
        self._designs = [row for row in found if row and row.figures and row.status == "done"]
        if not self._designs:
            raise InputError(f"{root} has no design with a figure yet: run its study first")
        self._swept = _swept(self._designs)
        metrics = sorted({name for row in self._designs for name in row.figures})
        gui = server.gui
        add_note(gui, f"{len(found)} designs, {len(self._designs)} with figures")
        with gui.add_folder("Designs"):
            self._metric = gui.add_dropdown("sorted by", metrics)
            self._order = gui.add_dropdown("first", ("largest", "smallest"))
            self._from = gui.add_slider("from place", 1, max(len(self._designs), 2), 1, 1)
            self._buttons = [gui.add_button("", visible=False, color="gray") for _ in range(ROWS)]
        self._about = add_note(gui)
        self._press = gui.add_dropdown("press", [GEL])
        self._panel = gui.add_panel(visible=False)
        with self._panel.add_tab("Picture of the design"):
            self._picture = gui.add_image(np.full((4, 4, 3), 255, dtype=np.uint8), format="png")
        self._panel.dock_left()
        self._panel.set_width(340)
        first = self._sorted()[0]
        states = design_gel(first)
        look_at(server, states.rest_mm, distance=2.0)
        self.view = GelView(server, states)
        for control in (self._metric, self._order, self._from):
            control.on_update(lambda _: self._list())
        for k, button in enumerate(self._buttons):
            button.on_click(lambda _, k=k: self.choose(int(self._from.value) - 1 + k))
        self._press.on_update(lambda _: self._draw())
        self._chosen = first
        self._list()
        self.choose(0)

    def _sorted(self) -> list[DesignRow]:
        metric, sign = str(self._metric.value), -1 if self._order.value == "largest" else 1

        def place(row: DesignRow) -> tuple[bool, float]:
            value = row.figures.get(metric)
            return value is None, 0.0 if value is None else sign * value

        return sorted(self._designs, key=place)

    def _list(self) -> None:
        """Labels of the buttons: place, value, parameters."""
        rows, metric = self._sorted(), str(self._metric.value)
        start = int(self._from.value) - 1
        for k, button in enumerate(self._buttons):
            button.visible = start + k < len(rows)
            if button.visible:
                row = rows[start + k]
                value = row.figures.get(metric)
                shown = "no figure" if value is None else f"{value:.4g}"
                button.label = f"{start + k + 1}.  {shown}  |  {_parameters(row, self._swept)}"

    def choose(self, place: int) -> None:
        """Show the design at a place of the sorted list, counted from 0."""
        rows = self._sorted()
        if not 0 <= place < len(rows):
            return
        self._chosen = row = rows[place]
        figures = [
            (name, "-" if value is None else format(value, ".4g"))
            for name, value in sorted(row.figures.items())
        ]
        table = page_table(figures, ("figure", "value"))
        self._about.content = PageText("**{}**\n\n{}").format(_parameters(row), table)
        self._show_picture(row)
        options = (GEL, *press_files(self._root, row))
        kept = self._press.value if self._press.value in options else options[-1]
        self._press.options = options
        self._press.value = kept
        self._draw()

    def _draw(self) -> None:
        """The gel of the design, or the steps of its press."""
        chosen = str(self._press.value)
        if chosen == GEL:
            self.view.show_states(design_gel(self._chosen))
            return
        path = press_files(self._root, self._chosen).get(chosen)
        if path is not None:
            try:
                states = read_design_press(path)
            except InputError as error:
                self._about.content = f"This press cannot be shown: {error}"
                return
            self.view.show_states(states, states.count - 1)

    def _show_picture(self, row: DesignRow) -> None:
        from taccel_lab.files.images import read_image

        path = self._root / row.files.get("picture", "none")
        self._panel.visible = path.is_file()
        if path.is_file():
            try:
                self._picture.image = read_image(path)
            except InputError as error:
                self._panel.visible = False
                self._about.content += PageText("\n\nIts picture cannot be shown: {}").format(error)


def _swept(rows: list[DesignRow]) -> list[str]:
    """Parameters in which designs differ."""
    names = dict.fromkeys(name for row in rows for name in row.parameters)
    return [name for name in names if len({str(row.parameters.get(name)) for row in rows}) > 1]


def _parameters(row: DesignRow, names: list[str] | None = None) -> str:
    """Values in words, of all parameters when ``names`` is None or empty."""
    known = sensor_family(row.family).parameters_type.parameters()
    return ", ".join(
        known[name].worded(value)
        for name, value in row.parameters.items()
        if not names or name in names
    )
