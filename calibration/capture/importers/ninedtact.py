# SPDX-License-Identifier: Apache-2.0
"""9DTact (Lin et al., RA-L 2023; MIT): ``camera_calibration`` and ``depth_calibration``.

Each holds ``ref.png`` (untouched) and ``sample.png``: a press of the 7 x 9 dot board (2.5 mm) and
one of a ball of 4.0 mm. Further images there are results of its own scripts and are left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from taccel_lab.calibration.capture.importers.draft import Draft, ImportOptions
from taccel_lab.calibration.capture.importers.files import first_existing
from taccel_lab.calibration.capture.importers.layout import Layout
from taccel_lab.errors import InputError
from taccel_lab.printable import printable
from taccel_lab.reading.plain_values import number_at
from taccel_lab.reading.yaml_file import read_yaml

SOURCE = "9DTact (linchangyi1/9DTact)"
LICENSE = "MIT"
BALL_RADIUS_MM = 4.0
DOT_ROWS, DOT_COLUMNS, DOT_PITCH_MM = 7, 9, 2.5
_CAMERA, _DEPTH = "camera_calibration", "depth_calibration"
_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp")


def _units(path: Path) -> list[Path]:
    """Folders that hold one or both calibrations of a sensor."""
    places = (path, path / "calibration", path / "shape_reconstruction" / "calibration")
    found = []
    for place in places:
        if place.is_dir():
            found += [p for p in (place, *sorted(place.iterdir())) if _is_unit(p)]
    return list(dict.fromkeys(found))


def _is_unit(path: Path) -> bool:
    return any(_image(path / part, "sample") is not None for part in (_CAMERA, _DEPTH))


def _image(folder: Path, stem: str) -> Path | None:
    return first_existing(*(folder / f"{stem}{suffix}" for suffix in _SUFFIXES))


def _recognises(path: Path) -> bool:
    return path.is_dir() and bool(_units(path))


def _read(path: Path, options: ImportOptions) -> list[Draft]:
    units = _units(path)
    facts = _facts(path)
    return [_unit(unit, facts, unit.name if len(units) > 1 else "") for unit in units]


@dataclass(frozen=True)
class _Facts:
    """Board and ball."""

    rows: int = DOT_ROWS
    columns: int = DOT_COLUMNS
    pitch_mm: float = DOT_PITCH_MM
    ball_radius_mm: float = BALL_RADIUS_MM


def _facts(path: Path) -> _Facts:
    """Those of a ``shape_config.yaml`` near the captures, or the published ones."""
    places = (path, *list(path.resolve().parents)[:3])
    config = first_existing(*(place / "shape_config.yaml" for place in places))
    if config is None:
        return _Facts()
    settings = read_yaml(config)

    def stated(key: str, default: float) -> float:
        section, name = key.split(".")
        table = settings.get(section)
        known = isinstance(table, dict) and table.get(name) is not None
        return number_at(settings, key, str(config)) if known else default

    def count(key: str, default: int) -> int:
        found = stated(key, default)
        if found % 1:
            raise InputError(f"{config}: {key} is {found:g}; a whole number is needed")
        return int(found)

    return _Facts(
        count("camera_calibration.row_points", DOT_ROWS),
        count("camera_calibration.col_points", DOT_COLUMNS),
        stated("camera_calibration.grid_distance", DOT_PITCH_MM),
        stated("depth_calibration.BallRad", BALL_RADIUS_MM),
    )


def _unit(unit: Path, facts: _Facts, part: str) -> Draft:
    draft = Draft(part, "9dtact", f"{SOURCE}, {unit.name}", LICENSE)
    if part:
        draft.manifest["unit"] = printable(unit.name)
    board, board_ref = _image(unit / _CAMERA, "sample"), _image(unit / _CAMERA, "ref")
    ball, ball_ref = _image(unit / _DEPTH, "sample"), _image(unit / _DEPTH, "ref")
    background = ball_ref or board_ref
    if background is None:
        raise InputError(f"{unit}: no ref image in {_CAMERA} or {_DEPTH}; it shows the bare gel")
    draft.set_background(background)
    if board is not None:
        entry = {
            "kind": "dots",
            "columns": facts.columns,
            "rows": facts.rows,
            "pitch_mm": facts.pitch_mm,
            "on_gel": True,
            "images": [draft.add_image(board, "board")],
        }
        if board_ref is not None and board_ref != background:
            entry["reference"] = draft.add_image(board_ref, "board_reference")
        draft.manifest["boards"] = [entry]
    if ball is not None:
        draft.set_ball(facts.ball_radius_mm)
        draft.add_press(ball, "ball")
    return draft


LAYOUT = Layout(
    "9dtact", "9DTact: camera_calibration and depth_calibration of each unit", _recognises, _read
)
