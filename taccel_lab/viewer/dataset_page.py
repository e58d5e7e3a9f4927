# SPDX-License-Identifier: Apache-2.0
"""The page of a data set: its touches one by one, step by step."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.report.page_text import PageText, add_note
from taccel_lab.viewer.camera_place import look_at
from taccel_lab.viewer.dataset_touches import read_touch
from taccel_lab.viewer.gel_view import GelView

if TYPE_CHECKING:
    from viser import ViserServer

    from taccel_lab.datasets.reading import Dataset

ANY = "any"


def open_dataset(folders: Sequence[Path]) -> Dataset:
    """The data set in some folders.

    Raises:
        InputError: No data set, none of its touches has steps, or the extra ``datasets`` is not
            installed.
    """
    try:
        import pyarrow
        import zarr
    except ImportError:
        raise InputError(
            "data sets are read by zarr and pyarrow, which are not installed: "
            "pip install 'taccel-lab[datasets]'"
        ) from None
    del pyarrow, zarr
    from taccel_lab.datasets.reading import Dataset

    data = Dataset(folders)
    if not any(row["rows"] > 0 for row in data.episodes):
        raise InputError(f"{folders[0]} has no touch with a step yet")
    return data


class DatasetPage:
    """Chooses touches by sensor, object and motion, and shows them."""

    def __init__(self, server: ViserServer, data: Dataset) -> None:
        self._data, self._lock = data, threading.Lock()
        gui = server.gui
        rows = data.episodes
        about = PageText("**{}**: {} touches, {} steps")
        add_note(gui, about.format(data.about[0]["name"], len(rows), len(data)))
        with gui.add_folder("Touch"):
            self._filters = {
                name: gui.add_dropdown(name, [ANY, *sorted({str(row[name]) for row in rows})])
                for name in ("sensor", "object", "motion", "status")
            }
            self._touch = gui.add_slider("touch", 0, 1, 1, 0)
            self._what = add_note(gui)
        self._chosen: list[int] = []
        first = next(place for place, row in enumerate(rows) if row["rows"] > 0)
        states = read_touch(data, first)
        look_at(server, states.rest_mm, distance=2.0)
        self.view = GelView(server, states)
        self.view.choose(arrows="by patch")
        for control in self._filters.values():
            control.on_update(lambda _: self._filter())
        self._touch.on_update(lambda _: self._show())
        self._filter()

    def _filter(self) -> None:
        """Touches that have steps and what is requested."""
        wanted = {name: box.value for name, box in self._filters.items() if box.value != ANY}
        self._chosen = [
            place
            for place, row in enumerate(self._data.episodes)
            if row["rows"] > 0 and all(str(row[name]) == value for name, value in wanted.items())
        ]
        self._touch.max = max(len(self._chosen) - 1, 1)
        self._touch.value = 0
        self._show()

    def show(self, number: int) -> None:
        """Show one of the touches that are chosen, at its largest force."""
        self._touch.value = number

    def _show(self) -> None:
        with self._lock:
            if not self._chosen:
                self._what.content = "No touch with steps is of this kind."
                return
            number = min(int(self._touch.value), len(self._chosen) - 1)
            place = self._chosen[number]
            row = self._data.episodes[place]
            place_text = f"{number + 1} of {len(self._chosen)}"
            cause = f" ({row['cause']})" if row["cause"] else ""
            self._what.content = PageText(
                "{place}: **{object}**, {motion}, to {depth_mm:.2f} mm, {split}, {status}{cause}"
            ).format_map({**row, "place": place_text, "cause": cause})
            rows = self._data.rows_of(place)
            try:
                states = read_touch(self._data, place)
            except InputError as error:
                self._what.content += PageText("\n\nIt cannot be shown: {}").format(error)
                return
            deepest = int(np.argmax(self._data.steps["press_force_z_n"][rows]))
            self.view.show_states(states, deepest)
