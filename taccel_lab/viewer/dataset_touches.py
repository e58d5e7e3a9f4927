# SPDX-License-Identifier: Apache-2.0
"""Touches of a data set as rows of states of a gel's contact face."""

from __future__ import annotations

from typing import Any

import numpy as np

from taccel_lab.camera.gel_camera import GelCamera, View
from taccel_lab.datasets.folder import ABOUT
from taccel_lab.datasets.part import STEPS
from taccel_lab.datasets.reading import Dataset
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.viewer.gel_states import Field, GelStates, SensorImages


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
        tets=np.zeros((0, 4), dtype=np.int64),
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
    return [
        f"step {table['step'][k]}: depth {table['depth_mm'][k]:.2f} mm, force "
        f"{table['press_force_z_n'][k]:.3f} N, contact {table['contact_area_mm2'][k]:.2f} mm²"
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
    """Of the object on the nodes [N], [step, node, 3]: the negative of what the object feels."""
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
