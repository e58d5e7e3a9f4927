# SPDX-License-Identifier: Apache-2.0
"""gs_sdk (CMU RPL): labelled presses, or the example of the package.

The key ``ppmm`` of its YAML files holds millimetres per pixel, despite its name. Folders of presses
are called by the ball's diameter.
"""

from __future__ import annotations

from pathlib import Path

from taccel_lab.calibration.capture.importers.draft import CaptureLayout, Draft, ImportOptions
from taccel_lab.calibration.capture.importers.files import (
    first_existing,
    images_in,
    label_numbers,
    natural_key,
    stated_number,
)
from taccel_lab.errors import InputError
from taccel_lab.files.arrays import read_npz
from taccel_lab.files.inner_path import real_path
from taccel_lab.files.table_file import number

_LABEL = ("center", "radius")
_EXAMPLE = "assets/ball_image.png"
_CONFIGS = ("gsmini.yaml", "digit.yaml", "configs/gsmini.yaml", "examples/configs/gsmini.yaml")


def _archives(path: Path) -> list[Path]:
    """Labels of presses of balls; none where the first is a label of something else."""
    found = sorted(path.glob("*mm/*/label.npz"), key=natural_key)
    return found if found and set(_LABEL) <= read_npz(found[0]).keys() else []


def _recognises(path: Path) -> bool:
    return path.is_dir() and ((path / _EXAMPLE).is_file() or bool(_archives(path)))


def _read(path: Path, options: ImportOptions) -> list[Draft]:
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


LAYOUT = CaptureLayout(
    "gs-sdk",
    "gs_sdk: <ball>mm/<n>/gelsight.png with label.npz, or its examples",
    _recognises,
    _read,
)
