# SPDX-License-Identifier: Apache-2.0
"""9DTact (Lin et al., RA-L 2023; MIT): ``camera_calibration`` and ``depth_calibration``.

Each holds ``ref.png`` (untouched) and ``sample.png``: a press of the 7 x 9 dot board (2.5 mm) and
one of a ball of 4.0 mm. Further images there are results of its own scripts and are left out.
"""

from __future__ import annotations

from pathlib import Path

from taccel_lab.calibration.capture.importers.draft import Draft, ImportOptions
from taccel_lab.calibration.capture.importers.files import first_existing, load_yaml
from taccel_lab.calibration.capture.importers.layout import Layout
from taccel_lab.errors import InputError

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


def _facts(path: Path) -> dict[str, float]:
    """Board and ball of a ``shape_config.yaml`` near the captures, or the published ones."""
    facts = {
        "rows": DOT_ROWS,
        "columns": DOT_COLUMNS,
        "pitch": DOT_PITCH_MM,
        "ball": BALL_RADIUS_MM,
    }
    for place in (path, *list(path.resolve().parents)[:3]):
        config = first_existing(place / "shape_config.yaml")
        if config is not None:
            values = load_yaml(config)
            camera, depth = values.get("camera_calibration"), values.get("depth_calibration")
            if isinstance(camera, dict):
                facts["rows"] = camera.get("row_points", facts["rows"])
                facts["columns"] = camera.get("col_points", facts["columns"])
                facts["pitch"] = camera.get("grid_distance", facts["pitch"])
            if isinstance(depth, dict):
                facts["ball"] = depth.get("BallRad", facts["ball"])
            break
    return facts


def _unit(unit: Path, facts: dict[str, float], part: str) -> Draft:
    draft = Draft(part, "9dtact", f"{SOURCE}, {unit.name}", LICENSE)
    if part:
        draft.manifest["unit"] = unit.name
    board, board_ref = _image(unit / _CAMERA, "sample"), _image(unit / _CAMERA, "ref")
    ball, ball_ref = _image(unit / _DEPTH, "sample"), _image(unit / _DEPTH, "ref")
    background = ball_ref or board_ref
    if background is None:
        raise InputError(f"{unit}: no ref image in {_CAMERA} or {_DEPTH}; it shows the bare gel")
    draft.set_background(background)
    if board is not None:
        entry = {
            "kind": "dots",
            "columns": int(facts["columns"]),
            "rows": int(facts["rows"]),
            "pitch_mm": float(facts["pitch"]),
            "on_gel": True,
            "images": [draft.add_image(board, "board")],
        }
        if board_ref is not None and board_ref != background:
            entry["reference"] = draft.add_image(board_ref, "board_reference")
        draft.manifest["boards"] = [entry]
    if ball is not None:
        draft.set_ball(float(facts["ball"]))
        draft.add_press(ball, "ball")
    return draft


LAYOUT = Layout(
    "9dtact", "9DTact: camera_calibration and depth_calibration of each unit", _recognises, _read
)
