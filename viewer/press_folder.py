# SPDX-License-Identifier: Apache-2.0
"""The folder of a press, read: every step where they were kept, else its end."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.reading.json_file import read_json
from taccel_lab.viewer.gel_states import Field, GelStates, SensorImages, Tool
from taccel_lab.viewer.section import linear_tets

STATES = "states.npz"
PRESS = "press.json"


def read_press(folder: Path) -> GelStates:
    """What ``taccel-lab press`` wrote to a folder.

    Raises:
        InputError: A file is missing or is not as a press writes it.
    """
    about = read_json(folder / PRESS)
    if (folder / STATES).is_file():
        return _steps(folder / STATES)
    return _end(folder, about)


def summary(folder: Path) -> list[tuple[str, str]]:
    """Name and value of what a page says about a press."""
    about = read_json(folder / PRESS)
    figures = about.get("press", {})
    rows = [
        ("sensor", str(about.get("sensor", "?"))),
        ("indenter", str(about.get("indenter", "?"))),
        ("friction", f"{about.get('friction_coefficient', float('nan')):.3g}"),
    ]
    if "force_n" in figures:
        force, error = figures["force_n"], figures.get("force_error_n", 0.0)
        rows.append(("force at the end", f"{force:.3f} ± {error:.3f} N"))
    if "contact_radius_mm" in figures:
        rows.append(("contact radius", f"{figures['contact_radius_mm']:.2f} mm"))
    return rows


def _steps(path: Path) -> GelStates:
    from taccel_lab.reading.arrays import read_npz

    arrays = read_npz(path)
    try:
        return _states(arrays)
    except (KeyError, IndexError, ValueError) as error:
        raise InputError(
            f"{path} is not as `taccel-lab press --states` writes it: {error}"
        ) from None


def _states(arrays: dict[str, np.ndarray]) -> GelStates:
    moved = 1e3 * arrays["moved_m"].astype(np.float64)
    captions = [
        f"depth {depth:.2f} mm, force {force[2]:.3f} N along z, "
        f"{np.hypot(force[0], force[1]):.3f} N sideways"
        for depth, force in zip(arrays["depth_mm"], arrays["force_n"], strict=True)
    ]
    captions[0] = "untouched"
    poses = arrays["indenter_poses"].astype(np.float64)
    poses[:, :3] *= 1e3
    poses[0, 2] += arrays["depth_mm"][1] + 0.3  # Kept at its first step; above the untouched gel.
    images = None
    if "images" in arrays:
        rgb, markers = arrays["images"], arrays.get("markers_px")
        if markers is not None:
            scale = np.array(rgb.shape[2:0:-1]) / arrays["image_px"]
            markers = (markers + 0.5) * scale - 0.5
        images = SensorImages(rgb, markers)
    return GelStates(
        rest_mm=1e3 * arrays["nodes_m"],
        tets=linear_tets(arrays["tets"]),
        faces=arrays["faces"].astype(np.int64),
        moved_mm=moved,
        captions=captions,
        fields=[
            Field("contact pressure", "kPa", 1e-3 * arrays["contact_pressures_pa"]),
            Field("von Mises stress", "kPa", 1e-3 * arrays["von_mises_pa"]),
        ],
        forces_n=arrays["contact_forces_n"].astype(np.float64),
        tool=Tool(1e3 * arrays["indenter_vertices_m"], arrays["indenter_faces"], poses),
        images=images,
    )


def _end(folder: Path, about: dict[str, Any]) -> GelStates:
    """Rest and end, of a press that kept no steps: the mesh for ParaView has them."""
    import pyvista

    path = folder / "gel.vtu"
    if not path.is_file():
        raise InputError(f"{folder} has neither {STATES} nor gel.vtu: press again, with --states")
    grid: Any = pyvista.read(path)
    cells = grid.cells_dict
    moved = 1e3 * np.asarray(grid.point_data["displacement_m"], dtype=np.float64)
    fields = [
        Field(label, "kPa", 1e-3 * _twice(np.asarray(grid.point_data[name], dtype=np.float64)))
        for name, label in (
            ("contact_pressure_pa", "contact pressure"),
            ("von_mises_pa", "von Mises stress"),
        )
        if name in grid.point_data
    ]
    force = about.get("press", {}).get("force_n", float("nan"))
    return GelStates(
        rest_mm=1e3 * np.asarray(grid.points, dtype=np.float64) - moved,
        tets=linear_tets(cells[pyvista.CellType.TETRA]),
        faces=cells[pyvista.CellType.TRIANGLE].astype(np.int64),
        moved_mm=_twice(moved),
        captions=["untouched", f"end of the press, force {force:.3f} N along z"],
        fields=fields,
        forces_n=_twice(np.asarray(grid.point_data["contact_force_n"], dtype=np.float64)),
        images=_end_image(folder),
    )


def _twice(values: np.ndarray) -> np.ndarray:
    """Zeros of the untouched gel, and what is at the end."""
    return np.stack([np.zeros_like(values), values])


def _end_image(folder: Path) -> SensorImages | None:
    from PIL import Image

    for name in ("image_raw.png", "predicted.png"):
        if (folder / name).is_file():
            with Image.open(folder / name) as file:
                rgb = np.asarray(file.convert("RGB"))
            return SensorImages(rgb[None])
    return None
