# SPDX-License-Identifier: Apache-2.0
"""The page of a data set: its touches one by one, step by step."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.camera.gel_camera import GelCamera, View
from taccel_lab.datasets.folder import ABOUT
from taccel_lab.datasets.part import STEPS
from taccel_lab.datasets.reading import Dataset
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.report.page_text import PageText, add_note
from taccel_lab.viewer.gel_states import Field, GelStates, SensorImages
from taccel_lab.viewer.gel_view import GelView
from taccel_lab.viewer.page_parts import look_at

if TYPE_CHECKING:
    from viser import ViserServer


def read_touch(data: Dataset, episode: int) -> GelStates:
    """The steps of a touch. Motion and forces are those of the nodes where the data set has them;
    else the face sinks by the depth image and forces of patches act at the node that is nearest to
    the patch's middle.

    Args:
        data: One or several folders.
        episode: Place in ``data.episodes``, of one that has steps.
    """
    rows, row = data.rows_of(episode), data.episodes[episode]
    root, number = data.folders[row["folder"]].root, row["episode"]
    if len(rows) == 0:
        raise InputError(f"{root}: touch {number} has no step in {STEPS}")
    view = _view(data, row)
    nodes, faces = data.mesh(episode)
    rest = 1e3 * nodes.astype(np.float64)
    steps = len(rows)
    moved = np.zeros((steps, *rest.shape))
    fields: list[Field] = []
    if "node_moved_mm" in data.channels:
        moved = data.read("node_moved_mm", rows).astype(np.float64)[:, : len(rest)]
    if "depth_mm" in data.channels:
        depth = data.read("depth_mm", rows).astype(np.float64)
        sunk = np.stack([_sampled(image, view, rest) for image in depth])
        fields.append(Field("depth image", "mm", sunk))
        if "node_moved_mm" not in data.channels:
            moved[..., 2] = -np.nan_to_num(sunk)
    if "node_pressures_kpa" in data.channels:
        pressure = data.read("node_pressures_kpa", rows).astype(np.float64)[:, : len(rest)]
        fields.insert(0, Field("contact pressure", "kPa", pressure))
    images = None
    if "rgb" in data.channels:
        rgb = data.read("rgb", rows)
        markers = None
        if "markers_px" in data.channels:
            scale = np.array([rgb.shape[2] / view.width_px, rgb.shape[1] / view.height_px])
            markers = (data.read("markers_px", rows) + 0.5) * scale - 0.5
        images = SensorImages(rgb, markers)
    return GelStates(
        rest_mm=rest,
        faces=faces.astype(np.int64),
        moved_mm=moved,
        captions=_captions(data, rows),
        fields=fields,
        forces_n=_forces(data, rows, view, rest),
        images=images,
    ).checked(f"{root}: touch {number}")


def _view(data: Dataset, row: dict[str, Any]) -> View:
    """What the pixels of the unit that was touched see."""
    folder = data.folders[row["folder"]]
    try:
        units = data.about[row["folder"]]["sensors"][row["sensor_index"]]["units"]
        unit = units[row["unit"]] if len(units) > 1 else units[0]
        # None for the grid, and in data sets of earlier versions.
        if unit.get("camera") is None:
            return PixelGrid(**unit["grid"])
        return GelCamera.of_record(unit["camera"])
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise InputError(
            f"{folder.root / ABOUT} does not describe sensor {row['sensor_index']}, unit "
            f"{row['unit']}, of touch {row['episode']} ({type(error).__name__}: {error})"
        ) from None


def _captions(data: Dataset, rows: np.ndarray) -> list[str]:
    table = data.steps
    faults = table["faults"].tolist() if "faults" in table else [""] * len(data)
    return [
        f"step {table['step'][k]}: depth {table['depth_mm'][k]:.2f} mm, force "
        f"{table['press_force_z_n'][k]:.3f} N, contact {table['contact_area_mm2'][k]:.2f} mm²"
        + (f", {faults[k].replace('+', ', ')}" if faults[k] else "")
        for k in rows
    ]


def _sampled(image: np.ndarray, view: View, points_mm: np.ndarray) -> np.ndarray:
    """A picture of the gel's pixels at points [n, 3], by the nearest pixel; NaN beside it."""
    height, width = image.shape
    size = np.array([width / view.width_px, height / view.height_px])
    places = (view.pixel_from_gel(points_mm) + 0.5) * size - 0.5
    column, row = np.round(np.nan_to_num(places, nan=-1.0)).astype(int).T
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    values = np.full(len(points_mm), np.nan)
    values[inside] = image[row[inside], column[inside]]
    return values


def _forces(data: Dataset, rows: np.ndarray, view: View, rest_mm: np.ndarray) -> np.ndarray | None:
    """Forces of the object on the nodes [N], [step, node, 3]: the negative of what it feels."""
    if "node_forces_n" in data.channels:
        return -data.read("node_forces_n", rows).astype(np.float64)[:, : len(rest_mm)]
    if "patch_forces_n" not in data.channels:
        return None
    patches = -data.read("patch_forces_n", rows).astype(np.float64)
    down, across = patches.shape[1:3]
    u = (np.arange(across) + 0.5) * view.width_px / across - 0.5
    v = (np.arange(down) + 0.5) * view.height_px / down - 0.5
    middles = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    seen = view.pixel_from_gel(rest_mm)
    away = np.linalg.norm(middles[:, None] - seen[None], axis=2)
    away = np.nan_to_num(away, nan=np.inf)
    nearest = away.argmin(axis=1)
    found = np.zeros((len(rows), *rest_mm.shape))
    for step in range(len(rows)):
        np.add.at(found[step], nearest, patches[step].reshape(-1, 3))
    return found


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
