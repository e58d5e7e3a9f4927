# SPDX-License-Identifier: Apache-2.0
"""The folder of a press, read: every step where they were kept, else its end; and its page."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.files.apart import read_apart
from taccel_lab.files.documents import number_at, read_json
from taccel_lab.files.inner_path import require_inner_links
from taccel_lab.files.regular_file import require_regular_file, shown
from taccel_lab.files.tet_file import MAX_BYTES
from taccel_lab.files.vtk_mesh import TETRA, TRIANGLE, cells_of, read_vtk
from taccel_lab.report.page_text import PageText, add_note, page_table
from taccel_lab.viewer.gel_states import Field, GelStates, SensorImages, ShownTool
from taccel_lab.viewer.gel_view import GelView
from taccel_lab.viewer.page_parts import look_at
from taccel_lab.viewer.section import linear_tets
from taccel_lab.with_error import with_error

if TYPE_CHECKING:
    from viser import ViserServer


STATES = "states.npz"
PRESS = "press.json"


def read_press(folder: Path) -> GelStates:
    """What ``taccel-lab press`` wrote to a folder.

    Raises:
        InputError: A file is missing or is not as a press writes it.
    """
    summary(folder)  # What it says of the press is rejected before a page opens, too.
    if (folder / STATES).is_file():
        return _steps(folder / STATES)
    return _end(folder)


def summary(folder: Path) -> list[tuple[str, str]]:
    """Name and value of what a page says about a press; InputError as of ``read_press``."""
    require_inner_links(folder, levels=1)
    about, source = read_json(folder / PRESS), str(folder / PRESS)
    rows = [(name, str(about.get(name, "?"))) for name in ("sensor", "indenter")]
    if "friction_coefficient" in about:
        rows.append(("friction", f"{number_at(about, 'friction_coefficient', source):.3g}"))
    figures = about.get("press", {})
    if not isinstance(figures, dict):
        raise InputError(f"{source}: press is {shown(figures)}; a table of figures is needed")
    if "force_n" in figures:
        error = None
        if figures.get("force_error_n") is not None:
            error = number_at(about, "press.force_error_n", source)
        text = with_error(number_at(about, "press.force_n", source), error)
        rows.append(("force at the end", f"{text} N"))
    if figures.get("contact_radius_mm") is not None:
        radius = number_at(about, "press.contact_radius_mm", source)
        rows.append(("contact radius", f"{radius:.2f} mm"))
    return rows


def _steps(path: Path) -> GelStates:
    from taccel_lab.files.arrays import read_npz

    arrays = read_npz(path)
    try:
        states = _states(arrays)
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise InputError(
            f"{path} is not as `taccel-lab press --states` writes it: {error}"
        ) from None
    return states.checked(path)


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
        tool=ShownTool(1e3 * arrays["indenter_vertices_m"], arrays["indenter_faces"], poses),
        images=images,
    )


def _end(folder: Path) -> GelStates:
    """Rest and end, of a press that kept no steps: the mesh for ParaView has them."""
    path = folder / "gel.vtu"
    if not path.is_file():
        raise InputError(f"{folder} has neither {STATES} nor gel.vtu: press again, with --states")
    require_regular_file(path, MAX_BYTES, "the mesh of a press")
    found = read_apart(str(path), _gel_arrays, path, by="vtkmodules")
    moved = 1e3 * found["displacement_m"]
    fields = [
        Field(label, "kPa", 1e-3 * _twice(found[name]))
        for name, label in (
            ("contact_pressure_pa", "contact pressure"),
            ("von_mises_pa", "von Mises stress"),
        )
        if name in found
    ]
    force = dict(summary(folder)).get("force at the end", "unknown")
    return GelStates(
        rest_mm=1e3 * found["points"] - moved,
        tets=linear_tets(found["tets"]),
        faces=found["faces"],
        moved_mm=_twice(moved),
        captions=["untouched", f"end of the press, force {force} along z"],
        fields=fields,
        forces_n=_twice(found["contact_force_n"]),
        images=_end_image(folder),
    ).checked(path)


def _gel_arrays(path: Path) -> dict[str, np.ndarray]:
    """Points, cells and what a press keeps at the points of a VTU file; by VTK, which answers a
    file that is cut short with an empty grid."""
    grid: Any = read_vtk(path, ".vtu")
    cells = cells_of(path, grid)
    needed = {"displacement_m", "contact_force_n"} - set(grid.point_data.keys())
    if needed or TETRA not in cells or TRIANGLE not in cells:
        what = f"no {', '.join(sorted(needed))}" if needed else "no tets with their skin"
        raise InputError(f"{path} is damaged, or no mesh of a press: it has {what}")
    names = ("displacement_m", "contact_force_n", "contact_pressure_pa", "von_mises_pa")
    there = [name for name in names if name in grid.point_data]
    return {
        "points": np.asarray(grid.points, dtype=np.float64),
        "tets": cells[TETRA],
        "faces": cells[TRIANGLE],
        **{name: np.asarray(grid.point_data[name], dtype=np.float64) for name in there},
    }


def _twice(values: np.ndarray) -> np.ndarray:
    """Zeros of the untouched gel, and what is at the end."""
    return np.stack([np.zeros_like(values), values])


def _end_image(folder: Path) -> SensorImages | None:
    from taccel_lab.files.images import read_image

    for name in ("image_raw.png", "predicted.png"):
        if (folder / name).is_file():
            return SensorImages(read_image(folder / name)[None])
    return None


def fill_press_page(server: ViserServer, folder: Path, states: GelStates) -> GelView:
    """Show the press in a folder, which ``read_press`` has read, at its end."""
    add_note(server.gui, page_table(summary(folder)))
    if not (folder / STATES).is_file():
        words = (
            "Only the end of this press was kept. `taccel-lab press … --states` keeps every step."
        )
        add_note(server.gui, PageText(words))
    look_at(server, states.rest_mm)
    view = GelView(server, states)
    view.choose(state=states.count - 1)
    return view
