# SPDX-License-Identifier: Apache-2.0
"""A data set as a page: sampled touches with their images and forces, and what is in it."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from taccel_lab.datasets.reading import Dataset
from taccel_lab.datasets.touch_figure import tangential_n
from taccel_lab.errors import InputError
from taccel_lab.report.figures_mesh import draw_mesh
from taccel_lab.report.mesh_view import mesh_view
from taccel_lab.report.page import Page, Picture, Table
from taccel_lab.report.style import BLUE, GREEN, GREY, ORANGE, in_report_style, new_figure

_GROUP_COLUMNS = (
    "sensor", "object", "motion", "touches", "steps", "largest depth [mm]", "largest force [N]",
    "stopped or failed",
)  # fmt: skip


def dataset_page(data: Dataset, touches: int = 12) -> Page:
    """The page of a data set, with some touches of it; InputError for one without a step."""
    if not len(data):
        raise InputError("the data set has no step to show")
    counts, about = _counts(data), data.about[0]
    sensors = "; ".join(
        f"{sensor['name']} ({sensor['grid']['width_px']} x {sensor['grid']['height_px']} px, "
        f"{len(sensor['units'])} units, images by its {sensor['image_from']})"
        for sensor in about["sensors"]
    )
    folders = ", ".join(folder.root.name for folder in data.folders)
    return Page(
        title=str(about["name"]),
        summary=f"{counts['train']:,} touches to train, {counts['test']:,} to test; "
        f"{counts['done']:,} whole, {counts['stopped']:,} stopped early, {counts['failed']:,} "
        f"failed. Sensors: {sensors}. Folders: {folders}.",
        headline=f"{counts['touches']:,} touches, {counts['steps']:,} steps",
        tables=(
            Table("Labels", ("figure", "value"), _figures(data)),
            Table("Sensors, objects and motions", _GROUP_COLUMNS, _groups(data)),
            Table("Channels", ("channel", "of a step", "unit", "what"), _channels(data)),
        ),
        pictures=(
            Picture("labels", lambda: _overview(data), "All steps but those of the untouched gel."),
            *(_touch(data, episode) for episode in _sampled(data, touches)),
            *_gels(data),
        ),
    )


def _gels(data: Dataset) -> list[Picture]:
    """The gel of every sensor, untouched, as in its profile."""
    first = {row["sensor"]: place for place, row in reversed(list(enumerate(data.episodes)))}
    found = []
    for name, place in sorted(first.items()):
        mesh = data.profile(place).mesh
        parts = mesh.nodes_m, mesh.faces, mesh.face_regions
        caption = f"The untouched gel of {name}, faces by region."
        draw = partial(draw_mesh, *parts)
        found.append(Picture(f"gel_{len(found)}", draw, caption, view=mesh_view(*parts)))
    return found


def _channels(data: Dataset) -> list[tuple[str, str, str, str]]:
    return [
        (name, c["dtype"] + (f" [{c['row']}]" if c["row"] else ""), c["unit"], c["what"])
        for name, c in data.channels.items()
    ]


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


def _groups(data: Dataset) -> list[tuple[Any, ...]]:
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
        (
            *key,
            len(places),
            int(table["rows"][places].sum()),
            float(table["depth_mm"][places].max()),
            float(force[places].max()),
            int((table["status"][places] != "done").sum()),
        )
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
        ("largest tangential force", f"{tangential_n(steps).max():.3g} N"),
        ("largest contact", f"{steps['contact_area_mm2'].max():.3g} mm²"),
        ("estimated force error, median", f"{100 * float(np.median(share)):.1f} %"),
    ]


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
        (axes[0, 1], tangential_n(steps)[pressed], "tangential force [N]", ORANGE),
        (axes[0, 2], steps["contact_area_mm2"][pressed], "contact area [mm²]", GREEN),
        (axes[1, 0], steps["depth_mm"][pressed], "depth past first touch [mm]", BLUE),
        # Rounded, as bins cannot part what differs by rounding.
        (axes[1, 1], np.round(100 * share[pressed], 3), "estimated force error [%]", GREY),
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


def _touch(data: Dataset, episode: int) -> Picture:
    """One touch: images, depths and forces over its steps."""
    row = data.episodes[episode]
    moved = "".join(
        f", {name} {row[key]:.2g} {unit}"
        for name, key, unit in (
            ("shear", "shear_mm", "mm"), ("twist", "twist_deg", "deg"), ("roll", "roll_deg", "deg"),
        )
        if row[key]
    )  # fmt: skip
    caption = (
        f"{row['motion']} of {row['object']} on {row['sensor']}: episode {row['episode']}, unit "
        f"{row['unit']}, {row['split']}; at ({row['x_mm']:.2f}, {row['y_mm']:.2f}) mm, yaw "
        f"{row['yaw_deg']:.0f} deg, tilt {row['tilt_deg']:.1f} deg; depth {row['depth_mm']:.2f} mm"
        f"{moved}; friction {row['friction']:.2f}, modulus x {row['young_modulus_factor']:.2f}. "
        f"{row['cause'] or ''}"
    )
    return Picture(f"touch_{episode}", partial(data.plot, episode), caption.strip())
