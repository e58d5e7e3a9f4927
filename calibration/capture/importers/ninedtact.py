# SPDX-License-Identifier: Apache-2.0
"""9DTact (Lin et al., RA-L 2023; MIT): ``camera_calibration`` and ``depth_calibration``.

Each holds ``ref.png`` (untouched) and ``sample.png``: a press of a dot board and one of a ball.
Further images there are results of its own scripts and are left out. Boards of several pitches are
about (the authors' has 9 x 7 dots at 2.5 mm), and a wrong one is a wrong scale: a
``shape_config.yaml`` or a person has to state it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from taccel_lab.calibration.capture.importers.draft import (
    CaptureLayout,
    Draft,
    ImportOptions,
    board_entry,
)
from taccel_lab.calibration.capture.importers.files import first_existing, images_in
from taccel_lab.errors import InputError
from taccel_lab.files.documents import number_at, read_yaml
from taccel_lab.files.inner_path import inner_path, real_path
from taccel_lab.printable import printable

BALL_RADIUS_MM = 4.0
_CAMERA, _DEPTH = "camera_calibration", "depth_calibration"
_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp")
_BOARD_HELP = (
    "measure the distance of two dots and give it with --board dots:COLUMNSxROWS:PITCH_MM (the "
    "authors' board is dots:9x7:2.5)"
)


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
    config, settings = _config(path)
    return [
        _unit(unit, unit.name if len(units) > 1 else "", config, settings, options)
        for unit in units
    ]


def _config(path: Path) -> tuple[Path | None, dict[str, Any]]:
    """A ``shape_config.yaml`` in or near the captures, and what it holds."""
    places = (path / "shape_reconstruction", path, *list(real_path(path).parents)[:3])
    config = first_existing(*(inner_path(place, "shape_config.yaml") for place in places))
    return config, {} if config is None else read_yaml(config)


def _stated(settings: dict[str, Any], key: str, config: Path | None) -> float | None:
    """A number of the configuration; None where it is not there."""
    section, name = key.split(".")
    table = settings.get(section)
    known = isinstance(table, dict) and table.get(name) is not None
    return number_at(settings, key, str(config)) if known else None


def _board(
    unit: Path, config: Path | None, settings: dict[str, Any], options: ImportOptions
) -> dict[str, Any]:
    """Kind, columns, rows and pitch of the board, as a person or the configuration states them."""
    if options.board is not None:
        entry = board_entry(options.board)
        if "pitch_mm" in entry:
            return entry
        raise InputError(f"board {options.board!r}: the pitch is missing; {_BOARD_HELP}")
    keys = ("col_points", "row_points", "grid_distance")
    found = {key: _stated(settings, f"camera_calibration.{key}", config) for key in keys}
    values = [value for value in found.values() if value is not None]
    if len(values) < len(found):
        missing = " and ".join(key for key, value in found.items() if value is None)
        where = config or "a shape_config.yaml"
        raise InputError(
            f"{unit}: the dot board is not known: camera_calibration.{missing} of {where} "
            f"{'is missing' if config else 'would state it'}; {_BOARD_HELP}"
        )
    columns, rows, pitch_mm = values
    for key, value in zip(keys[:2], (columns, rows), strict=True):
        if value % 1:
            raise InputError(
                f"{config}: camera_calibration.{key} is {value:g}; a whole number is needed"
            )
    return {"kind": "dots", "columns": int(columns), "rows": int(rows), "pitch_mm": pitch_mm}


def _unit(
    unit: Path,
    part: str,
    config: Path | None,
    settings: dict[str, Any],
    options: ImportOptions,
) -> Draft:
    draft = Draft(part, "9dtact", unit)
    draft.assume_sensor("whose layout this is")
    if config is not None:
        draft.used.add(config)
    if part:
        draft.manifest["unit"] = printable(unit.name)
    board, board_ref = _image(unit / _CAMERA, "sample"), _image(unit / _CAMERA, "ref")
    ball, ball_ref = _image(unit / _DEPTH, "sample"), _image(unit / _DEPTH, "ref")
    background = ball_ref or board_ref
    if background is not None:
        draft.set_background(background, f"{background.relative_to(unit)}, by its name")
    elif options.background is None:
        raise InputError(
            f"{unit}: no ref image in {_CAMERA} or {_DEPTH}, which shows the bare gel; "
            "--background gives one"
        )
    if board is not None:
        entry = {
            **_board(unit, config, settings, options),
            "on_gel": True,
            "images": [draft.add_image(board, "board")],
        }
        if board_ref is not None and board_ref != background:
            entry["reference"] = draft.add_image(board_ref, "board_reference")
        draft.manifest["boards"] = [entry]
        if options.board is None and config is not None:
            draft.assume("board", f"{config} is of this board and ball")
    if ball is not None:
        radius = options.radius_mm or _stated(settings, "depth_calibration.BallRad", config)
        if radius is None:
            draft.set_ball(BALL_RADIUS_MM, "that of the authors; --radius-mm gives another")
        else:
            draft.set_ball(radius)
        draft.add_press(ball, "ball")
    for folder in (unit / _CAMERA, unit / _DEPTH):
        for image in images_in(folder) if folder.is_dir() else ():
            if image not in draft.used:
                draft.leave_out(image, "neither ref nor sample: a result of 9DTact's scripts")
    return draft


LAYOUT = CaptureLayout(
    "9dtact", "9DTact: camera_calibration and depth_calibration of each unit", _recognises, _read
)
