# SPDX-License-Identifier: Apache-2.0
"""One page that shows a data set: sampled touches with their images and forces, and what is in it.

The page embeds its pictures and the one script that turns its gels, and loads nothing.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.datasets.reading import Dataset
from taccel_lab.errors import InputError
from taccel_lab.output import atomic_file
from taccel_lab.report.build import report_environment
from taccel_lab.report.mesh_view import MeshView, mesh_view
from taccel_lab.report.style import BLUE, GREEN, GREY, ORANGE, in_report_style, new_figure

STRIP = 7
"""Images of a touch."""
THUMB_PX = 150
"""Width of one."""


def write_page(folders: Sequence[Path | str], out: Path | str, touches: int = 12) -> None:
    """Write the page. Raises InputError for no data set, or one without a step."""
    data = Dataset(folders)
    if not len(data):
        raise InputError("the data set has no step to show")
    chosen = _sampled(data, touches)
    page = (
        report_environment("taccel_lab.datasets")
        .get_template("page.html.j2")
        .render(
            name=data.about[0]["name"],
            folders=[folder.root.name for folder in data.folders],
            figures=_figures(data),
            counts=_counts(data),
            groups=_groups(data),
            channels=data.channels,
            sensors=data.about[0]["sensors"],
            overview=_png(_overview(data)),
            touches=[_touch(data, episode) for episode in chosen],
            gels=_gels(data),
        )
    )
    with atomic_file(out) as staging:
        staging.write_text(page, encoding="utf-8", errors="backslashreplace")


def _gels(data: Dataset) -> list[tuple[str, MeshView]]:
    """Name and gel of every sensor, untouched, as in its profile."""
    first = {row["sensor"]: place for place, row in reversed(list(enumerate(data.episodes)))}
    found = []
    for name, place in sorted(first.items()):
        mesh = data.profile(place).mesh
        view = mesh_view(mesh.nodes_m, mesh.faces, mesh.face_regions)
        if view is not None:
            found.append((str(name), view))
    return found


def _sampled(data: Dataset, count: int) -> list[int]:
    """Episodes with steps; sensors, objects and motions take turns."""
    groups: dict[tuple[Any, ...], list[int]] = {}
    for place, row in enumerate(data.episodes):
        if row["rows"] > 1:
            key = (row["sensor_index"], row["object_index"], row["motion_index"])
            groups.setdefault(key, []).append(place)
    found: list[int] = []
    turn = 0
    while len(found) < count and any(len(group) > turn for group in groups.values()):
        found += [group[turn] for _, group in sorted(groups.items()) if len(group) > turn]
        turn += 1
    return found[:count]


def _counts(data: Dataset) -> dict[str, int]:
    status = data.episode_table["status"].tolist()
    split = data.episode_table["split"].tolist()
    return {
        "touches": len(status),
        "steps": len(data),
        "done": status.count("done"),
        "stopped": status.count("stopped"),
        "failed": status.count("failed"),
        "train": split.count("train"),
        "test": split.count("test"),
    }


def _groups(data: Dataset) -> list[dict[str, Any]]:
    """A row for each sensor, object and motion."""
    table, steps = data.episode_table, data.steps
    force = np.zeros(len(table["episode"]))
    np.maximum.at(force, steps["place"], steps["press_force_z_n"])
    found: dict[tuple[str, str, str], list[int]] = {}
    for place, key in enumerate(
        zip(table["sensor"], table["object"], table["motion"], strict=True)
    ):
        found.setdefault(key, []).append(place)
    return [
        {
            "sensor": key[0],
            "object": key[1],
            "motion": key[2],
            "touches": len(places),
            "steps": int(table["rows"][places].sum()),
            "force": float(force[places].max()),
            "depth": float(table["depth_mm"][places].max()),
            "lost": int((table["status"][places] != "done").sum()),
        }
        for key, places in sorted(found.items())
    ]


def _figures(data: Dataset) -> list[tuple[str, str]]:
    steps = data.steps
    pressed = steps["press_force_z_n"] > 0
    if not pressed.any():
        return []
    share = steps["force_error_n"][pressed] / steps["press_force_z_n"][pressed]
    return [
        ("largest normal force", f"{steps['press_force_z_n'].max():.3g} N"),
        ("largest tangential force", f"{_tangential(steps).max():.3g} N"),
        ("largest contact", f"{steps['contact_area_mm2'].max():.3g} mm²"),
        ("estimated force error, median", f"{100 * float(np.median(share)):.1f} %"),
    ]


def _tangential(steps: dict[str, np.ndarray]) -> np.ndarray:
    return np.hypot(steps["press_force_x_n"], steps["press_force_y_n"])


@in_report_style
def _overview(data: Dataset) -> Any:
    """Histograms of the labels, and where contacts are."""
    steps = data.steps
    pressed = steps["step"] > 0
    figure, axes = new_figure(11, 5.6, 2, 3)
    share = np.divide(
        steps["force_error_n"],
        steps["press_force_z_n"],
        out=np.zeros(len(pressed)),
        where=steps["press_force_z_n"] > 0,
    )
    for axis, values, label, color in (
        (axes[0, 0], steps["press_force_z_n"][pressed], "normal force [N]", BLUE),
        (axes[0, 1], _tangential(steps)[pressed], "tangential force [N]", ORANGE),
        (axes[0, 2], steps["contact_area_mm2"][pressed], "contact area [mm²]", GREEN),
        (axes[1, 0], steps["depth_mm"][pressed], "depth past first touch [mm]", BLUE),
        (axes[1, 1], 100 * share[pressed], "estimated force error [%]", GREY),
    ):
        axis.hist(values, bins=30, color=color)
        axis.set_xlabel(label)
        axis.set_ylabel("steps")
    axis = axes[1, 2]
    x, y = steps["contact_center_x_mm"][pressed], steps["contact_center_y_mm"][pressed]
    shown = axis.scatter(x, y, c=steps["press_force_z_n"][pressed], s=8, cmap="viridis")
    axis.set_xlabel("contact x [mm]")
    axis.set_ylabel("contact y [mm]")
    axis.set_aspect("equal")
    axis.invert_yaxis()
    figure.colorbar(shown, ax=axis, label="normal force [N]")
    return figure


def _touch(data: Dataset, episode: int) -> dict[str, Any]:
    """What the page shows of one touch."""
    row, rows = data.episodes[episode], data.rows_of(episode)
    picked = rows[np.unique(np.linspace(0, len(rows) - 1, STRIP).round().astype(int))]
    strip = [
        {
            "caption": f"step {data.steps['step'][k]}, {data.steps['depth_mm'][k]:.2f} mm, "
            f"{data.steps['press_force_z_n'][k]:.2f} N",
            "image": _image(data.read("rgb", [k])[0]) if "rgb" in data.channels else None,
            "depth": _depth(data, int(k)),
        }
        for k in picked.tolist()
    ]
    return {"row": row, "strip": strip, "forces": _png(_forces(data, rows))}


@in_report_style
def _forces(data: Dataset, rows: np.ndarray) -> Any:
    steps = data.steps
    figure, axes = new_figure(4.4, 2.5)
    number = steps["step"][rows]
    normal = steps["press_force_z_n"][rows]
    axes.plot(number, normal, color=BLUE, marker=".", label="normal")
    axes.fill_between(
        number,
        normal - steps["force_error_n"][rows],
        normal + steps["force_error_n"][rows],
        color=BLUE,
        alpha=0.2,
        linewidth=0,
    )
    axes.plot(number, _tangential(steps)[rows], color=ORANGE, marker=".", label="tangential")
    axes.set_xlabel("step")
    axes.set_ylabel("force [N]")
    axes.set_ylim(top=1.3 * axes.get_ylim()[1])
    axes.xaxis.get_major_locator().set_params(integer=True)
    axes.legend(loc="upper center", ncols=2)
    return figure


def _image(rgb: np.ndarray) -> str:
    """A thumbnail as text that a page embeds."""
    import cv2

    height = round(THUMB_PX * rgb.shape[0] / rgb.shape[1])
    small = cv2.resize(rgb, (THUMB_PX, height), interpolation=cv2.INTER_AREA)
    data = cv2.imencode(".png", small[..., ::-1])[1].tobytes()
    return "data:image/png;base64," + base64.b64encode(data).decode()


def _depth(data: Dataset, step: int) -> str | None:
    """Depth in false colours, dark where nothing sank."""
    if "depth_mm" not in data.channels:
        return None
    import matplotlib as mpl

    depth = data.read("depth_mm", [step])[0]
    scale = max(float(data.steps["depth_mm"][step]), 0.05)
    colors = mpl.colormaps["viridis"](np.clip(depth / scale, 0, 1))[..., :3]
    return _image(np.ascontiguousarray((255 * colors).astype(np.uint8)))


def _png(figure: Any) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=100, format="png", facecolor="white")
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()
