# SPDX-License-Identifier: Apache-2.0
"""gs_sdk (CMU RPL): ``catalog.csv`` with numbered folders, or the examples of the package.

``<ball>mm/<n>/gelsight.png`` with ``label.npz`` (``center``, ``radius``), ``catalog.csv``
(``experiment_reldir, diameter(mm)``) and ``background.png``. The key ``ppmm`` of its YAML files
holds millimetres per pixel, despite its name.
"""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path
from typing import Any

from taccel_lab.calibration.capture.importers.draft import Draft, ImportOptions
from taccel_lab.calibration.capture.importers.files import (
    first_existing,
    images_in,
    number_in,
    point_in,
    sensor_image,
)
from taccel_lab.calibration.capture.importers.layout import Layout
from taccel_lab.calibration.capture.importers.path_pattern import natural_key
from taccel_lab.calibration.capture.schema import MAX_MM_PER_PX, MIN_MM_PER_PX
from taccel_lab.errors import InputError
from taccel_lab.files.arrays import read_npz
from taccel_lab.files.cell_number import number
from taccel_lab.files.inner_path import inner_path
from taccel_lab.files.plain_values import number_at
from taccel_lab.files.table_file import TABLE_LIMIT_BYTES, read_table
from taccel_lab.files.text_file import read_text, shown
from taccel_lab.files.yaml_file import YAML_LIMIT_BYTES, read_yaml

CATALOG = "catalog.csv"
DIAMETER = "diameter(mm)"
_SCALE = "ppmm"
FOLDER = "experiment_reldir"
_BALL_FOLDER = re.compile(r"([0-9]{1,4}(?:\.[0-9]{0,9})?)\s*mm")
_SENSORS = {"gelsight mini": "gelsight_mini", "digit": "digit"}


def _background(path: Path) -> Path | None:
    return first_existing(
        path / "background.png",
        path / "examples" / "data" / "background.png",
        path / "data" / "background.png",
    )


def _recognises(path: Path) -> bool:
    catalog = path / CATALOG
    if catalog.is_file():
        return DIAMETER in read_text(catalog, TABLE_LIMIT_BYTES, "a table", latin_1=True)
    if (path / "examples" / "data" / "background.png").is_file():
        return True
    labels = _labels(path)
    return bool(labels) and {"center", "radius"} <= read_npz(labels[0]).keys()


def _labels(path: Path) -> list[Path]:
    """Labels of presses where the catalogue is missing, in natural order."""
    found = [*path.glob("*/label.npz"), *path.glob("*/*/label.npz")] if path.is_dir() else []
    return sorted(found, key=lambda label: natural_key(label.relative_to(path)))


def _read(path: Path, options: ImportOptions) -> list[Draft]:
    draft = Draft("", "gelsight_mini", path)
    draft.assume("sensor", "gelsight_mini, the sensor that gs_sdk is mostly used with")
    background = _background(path)
    if background is None and options.background is None:
        raise InputError(
            f"{path}: no background.png; gs_sdk stores one beside {CATALOG}, --background gives "
            "another"
        )
    if background is not None:
        draft.set_background(background, f"{background.relative_to(path)}, by its name")
    _read_config(path, draft, options)
    if (path / CATALOG).is_file():
        _read_catalog(path, draft)
    elif _labels(path):
        _read_labelled(path, draft, options)
    else:
        ball = first_existing(path / "assets" / "ball_image.png")
        if ball is not None:
            draft.add_press(ball)
            draft.assume("presses", f"{ball.name} is a press of a ball, by its name")
            if options.radius_mm is None:
                draft.notes.append("the diameter of the ball is stated nowhere")
        for image in images_in(path, recursive=True):
            if image not in draft.used:
                draft.leave_out(image, "neither background nor ball: no known shape")
    return [draft]


def _read_config(path: Path, draft: Draft, options: ImportOptions) -> None:
    """Scale and sensor of the YAML file, where there is one."""
    places = (path, path / "configs", path / "examples" / "configs", path.parent)
    configs = [
        found for place in places if place.is_dir() for found in sorted(place.glob("*.y*ml"))
    ]
    for config in configs:
        try:
            values = read_yaml(config)
        except InputError as error:
            if _mentions_scale(config):
                raise
            draft.leave_out(config, f"not used: {error}")
            continue
        if _SCALE not in values:
            continue
        draft.used.add(config)
        _read_device(values, config, draft)
        if options.mm_per_px_x is not None:
            return
        scale = number_at(values, _SCALE, str(config))
        if not MIN_MM_PER_PX <= scale <= MAX_MM_PER_PX:
            raise InputError(
                f"{config}: ppmm is {scale:g}; gs_sdk stores millimetres per pixel under this "
                f"name, {MIN_MM_PER_PX:g} to {MAX_MM_PER_PX:g} is allowed"
            )
        draft.set_scale(
            scale, why=f"the ppmm of {config.name} taken as mm per pixel, as gs_sdk uses it"
        )
        return


def _read_device(values: dict[str, Any], config: Path, draft: Draft) -> None:
    """The sensor that the YAML file names, where the catalogue has it."""
    device = str(values.get("device_name", ""))
    found = next((name for key, name in _SENSORS.items() if key in device.lower()), None)
    if found is not None:
        draft.sensor = found
        draft.assume("sensor", f"{found}, by the device_name {shown(device)} of {config.name}")


def _mentions_scale(config: Path) -> bool:
    """Whether a YAML file that cannot be read is one of gs_sdk; others may lie beside it."""
    try:
        return _SCALE in read_text(config, YAML_LIMIT_BYTES, "a YAML file", latin_1=True)
    except InputError:
        return False


def _read_catalog(path: Path, draft: Draft) -> None:
    table = read_table(path / CATALOG)
    draft.used.add(path / CATALOG)
    place, ball = table.require_column(FOLDER), table.require_column(DIAMETER)
    rows = [(inner_path(path, row.text(place)), row.number(ball)) for row in table.rows()]
    if not rows:
        raise InputError(f"{table.path} has no rows; a press each is needed")
    common = Counter(diameter for _, diameter in rows).most_common(1)[0][0]
    draft.set_ball(common / 2)
    for folder, diameter in rows:
        draft.add_press(
            sensor_image(folder),
            "_".join(folder.relative_to(path).parts),
            radius_mm=None if diameter == common else diameter / 2,
            contact=_circle(folder / "label.npz", draft),
        )


def _read_labelled(path: Path, draft: Draft, options: ImportOptions) -> None:
    """Presses of folders with labels; a folder ``4.760mm`` says the ball's diameter."""
    balls = []
    for label in _labels(path):
        match = _BALL_FOLDER.fullmatch(label.parent.parent.name)
        balls.append(None if match is None else number(match[1]) / 2)
        name = "_".join(label.parent.relative_to(path).parts)
        draft.add_press(
            sensor_image(label.parent), name, radius_mm=balls[-1], contact=_circle(label, draft)
        )
    stated = [ball for ball in balls if ball is not None]
    if stated:
        draft.set_ball(
            Counter(stated).most_common(1)[0][0],
            f"by the names of the folders, taken as diameters: {CATALOG} is missing",
        )
    if stated and None in balls:
        draft.assume(
            "presses",
            f"{balls.count(None)} in folders whose names say no diameter are of the commonest ball",
        )
    elif None in balls and options.radius_mm is None:
        draft.notes.append(
            f"{CATALOG} is missing: the diameter of the ball is stated nowhere; give --radius-mm"
        )


def _circle(label: Path, draft: Draft) -> dict[str, float] | None:
    if not label.is_file():
        return None
    draft.used.add(label)
    arrays = read_npz(label)
    u, v = point_in(arrays, "center", label)
    return {"u_px": u, "v_px": v, "radius_px": number_in(arrays, "radius", label)}


LAYOUT = Layout(
    "gs-sdk", "gs_sdk: catalog.csv with numbered folders, or its examples", _recognises, _read
)
