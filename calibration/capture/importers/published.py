# SPDX-License-Identifier: Apache-2.0
"""Layouts of published sets: Taxim, gs_sdk and 9DTact.

Taxim (Si and Yuan, RA-L 2022; MIT) has a ``dataPack.npz`` with a ``params.json`` beside it.

gs_sdk (CMU RPL) has labelled presses, or the example of the package. The key ``ppmm`` of its YAML
files holds millimetres per pixel, despite its name. Folders of presses are called by the ball's
diameter.

9DTact (Lin et al., RA-L 2023; MIT) has ``camera_calibration`` and ``depth_calibration``. Each holds
``ref.png`` (untouched) and ``sample.png``: a press of a dot board and one of a ball. Further images
there are results of its scripts and are left out. Boards of several pitches are about (the
authors' has 9 x 7 dots at 2.5 mm), and a wrong one is a wrong scale: a ``shape_config.yaml`` or a
person has to state it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from taccel_lab.calibration.capture.camera.recording import natural_key
from taccel_lab.calibration.capture.importers.draft import (
    Draft,
    ImportOptions,
    board_entry,
)
from taccel_lab.calibration.capture.importers.files import (
    UNKNOWN,
    first_existing,
    images_in,
    label_numbers,
    stated_number,
)
from taccel_lab.calibration.capture.taxim_pack import (
    PACK_NAME,
    PARAMS_NAME,
    TAXIM_BALL_WHY,
    load_taxim_folder,
)
from taccel_lab.errors import InputError
from taccel_lab.files.arrays import read_npz
from taccel_lab.files.documents import number_at, read_yaml
from taccel_lab.files.inner_path import inner_path, real_path
from taccel_lab.files.table_file import number
from taccel_lab.printable import printable


def _pack(path: Path) -> Path:
    return path / PACK_NAME if path.is_dir() else path


def is_taxim(path: Path) -> bool:
    return _pack(path).is_file() and _pack(path).suffix == ".npz"


def read_taxim(path: Path, options: ImportOptions) -> list[Draft]:
    if not is_taxim(path):
        return []
    pack = _pack(path)
    stated = None
    if options.mm_per_px_x is not None:
        stated = (options.mm_per_px_x, options.mm_per_px_y or options.mm_per_px_x)
    folder = load_taxim_folder(pack, stated)
    draft = Draft("", folder.sensor, path, assumed=dict(folder.assumed))
    draft.used |= {pack} if stated else {pack, pack.parent / PARAMS_NAME}
    draft.source = folder.provenance.get("source", UNKNOWN)
    draft.license = folder.provenance.get("license", UNKNOWN)
    draft.set_background(folder.require_background().image())
    if folder.mm_per_px is not None:
        draft.set_scale(*folder.mm_per_px)
    if folder.ball_radius_mm is not None:
        draft.set_ball(folder.ball_radius_mm, TAXIM_BALL_WHY)
    elif options.radius_mm is None:
        draft.notes.append("the radius of the ball is stated nowhere; give --radius-mm")
    for press in folder.presses:
        circle = press.circle
        contact = None
        if circle is not None:
            contact = {"u_px": circle.u_px, "v_px": circle.v_px, "radius_px": circle.radius_px}
        draft.add_press(press.image(), press.name, contact=contact)
    return [draft]


_LABEL = ("center", "radius")
_EXAMPLE = "assets/ball_image.png"
_CONFIGS = ("gsmini.yaml", "digit.yaml", "configs/gsmini.yaml", "examples/configs/gsmini.yaml")


def _archives(path: Path) -> list[Path]:
    """Labels of presses of balls; none where the first is a label of something else."""
    found = sorted(path.glob("*mm/*/label.npz"), key=natural_key)
    return found if found and set(_LABEL) <= read_npz(found[0]).keys() else []


def is_gs_sdk(path: Path) -> bool:
    return path.is_dir() and ((path / _EXAMPLE).is_file() or bool(_archives(path)))


def read_gs_sdk(path: Path, options: ImportOptions) -> list[Draft]:
    archives = _archives(path) if path.is_dir() else []
    if not archives and not (path / _EXAMPLE).is_file():
        return []
    in_path = "digit" in "/".join(real_path(path).parts[-3:]).lower() and bool(archives)
    draft = Draft("", "digit" if in_path else "gelsight_mini", path)
    draft.assume_sensor(
        "by the folder's path" if in_path else "the sensor that gs_sdk is mostly used with"
    )
    if not archives:
        draft.find_background(options, "examples/data/background.png")
        _state_scale(draft, options, _CONFIGS[-1:])
        draft.notes.append("the diameter of the ball is stated nowhere")
        draft.add_presses(images_in(path, _EXAMPLE))
        return [draft]
    places = ("background.png", "data/background.png", "examples/data/background.png")
    draft.find_background(options, *places)
    _state_scale(draft, options, _CONFIGS)
    draft.notes.append(
        "ppmm is taken as mm per pixel, as gs_sdk uses it; folders are called by the ball's "
        "diameter"
    )
    for archive in archives:
        _add_press(draft, archive)
    if (path / "catalog.csv").is_file():
        draft.leave_out(path / "catalog.csv", "the names of the folders say the balls' diameters")
    return [draft]


def _state_scale(draft: Draft, options: ImportOptions, names: tuple[str, ...]) -> None:
    configs = [path for name in names if (path := draft.place / name).is_file()]
    if not configs and options.mm_per_px_x is None:
        draft.notes.append(f"{names[0]} is missing; --mm-per-px-x give what it states")
    elif options.mm_per_px_x is None:
        draft.used.add(configs[0])
        draft.set_scale(stated_number(configs[0], "ppmm"))
    for path in configs[1:]:
        draft.leave_out(path, f"{configs[0].name} is read instead")


def _add_press(draft: Draft, archive: Path) -> None:
    folder = archive.parent
    places = [folder / "gelsight.png", folder / "digit.png"]
    image = first_existing(*places)
    if image is None:
        raise InputError(f"{places[0]} does not exist")
    ball = folder.parent.name
    try:
        diameter_mm = number(ball.removesuffix("mm"))
    except ValueError as error:
        raise InputError(f"{folder.parent}: {error}, the ball's diameter") from None
    contact = label_numbers(archive, _LABEL, ("u_px", "v_px", "radius_px"))
    draft.used.add(archive)
    draft.add_press(image, f"{ball}_{folder.name}", contact=contact, radius_mm=diameter_mm / 2)


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
            found += [
                unit
                for unit in (place, *sorted(place.iterdir()))
                if _image(unit / _CAMERA, "sample") or _image(unit / _DEPTH, "sample")
            ]
    return list(dict.fromkeys(found))


def _image(folder: Path, stem: str) -> Path | None:
    return first_existing(*(folder / f"{stem}{suffix}" for suffix in _SUFFIXES))


def is_ninedtact(path: Path) -> bool:
    return path.is_dir() and bool(_units(path))


def read_ninedtact(path: Path, options: ImportOptions) -> list[Draft]:
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
