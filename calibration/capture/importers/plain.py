# SPDX-License-Identifier: Apache-2.0
"""A plain folder: images of presses, perhaps a background, a mask, label tables and records."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path
from typing import Any

from taccel_lab.calibration.capture.importers.background_guess import (
    BACKGROUND_NAME,
    guess_background,
)
from taccel_lab.calibration.capture.importers.draft import MEDIAN, Draft, ImportOptions
from taccel_lab.calibration.capture.importers.files import images_in
from taccel_lab.calibration.capture.importers.label_tables import not_used, read_label_tables
from taccel_lab.calibration.capture.importers.layout import Layout
from taccel_lab.calibration.capture.importers.markers import VIDEO_SUFFIXES
from taccel_lab.calibration.capture.records import kind_of_record
from taccel_lab.errors import InputError
from taccel_lab.reading.cell_number import number
from taccel_lab.reading.images import image_size, read_grey

_MASK_NAME = re.compile(r"(^|[_\-. ])mask($|[_\-. \d])", re.IGNORECASE)
_DERIVED_NAME = re.compile(r"(^|[_\-. ])(labeled|labelled|drawing|contours|annotated|pseudo)", re.I)
"""Pictures that scripts drew, not captures."""
_BOARD = re.compile(r"^(chessboard|charuco|dots|pins):([0-9]{1,4})x([0-9]{1,4})(?::([0-9.]+))?$")
_SENSOR_WORDS = (
    ("9dtact", "9dtact"),
    ("ninedtact", "9dtact"),
    ("digit", "digit"),
    ("gelsight_r15", "gelsight_r15"),
    ("wedge", "gelsight_wedge"),
    ("gsmini", "gelsight_mini"),
    ("gs_mini", "gelsight_mini"),
    ("gelsight_mini", "gelsight_mini"),
    ("gelsightmini", "gelsight_mini"),
)
FALLBACK_SENSOR = "flat_pad"


def _recognises(path: Path) -> bool:
    return path.is_dir() and bool(images_in(path, recursive=True))


def _read(path: Path, options: ImportOptions) -> list[Draft]:
    if not path.is_dir():
        raise InputError(f"{path} is a file; a folder with images is needed")
    draft = Draft("", _guess_sensor(path), f"images of {path.name}")
    if options.sensor is None:
        draft.notes.append(f"sensor taken as {draft.sensor}; name another one with --sensor")
    images = [
        image for image in images_in(path, recursive=True) if not _DERIVED_NAME.search(image.stem)
    ]
    images = _of_one_size(images, draft)
    if not images:
        reasons = "".join(f". {note}" for note in draft.notes if note.startswith("left out"))
        raise InputError(f"{path} holds no images; PNG or JPEG is allowed{reasons}")
    if options.board is not None:
        draft.manifest["boards"] = [_board(options.board, images, draft)]
        return [draft]
    images = _take_mask(images, draft)
    images = _take_background(images, draft, options)
    labels = read_label_tables(path)
    draft.notes += labels.unused(images)
    circles = labels.of_images(images)
    for image in images:
        name = "_".join(image.relative_to(path).with_suffix("").parts)
        draft.add_press(image, name, contact=circles.get(image))
    _take_records(path, draft)
    _take_videos(path, draft)
    return [draft]


def _guess_sensor(path: Path) -> str:
    text = "/".join(path.resolve().parts[-3:]).lower().replace("-", "_").replace(" ", "_")
    return next((name for word, name in _SENSOR_WORDS if word in text), FALLBACK_SENSOR)


def _of_one_size(images: list[Path], draft: Draft) -> list[Path]:
    """The images of the commonest size; those and unreadable ones left out are named in notes."""
    sizes, broken = {}, []
    for image in images:
        try:
            sizes[image] = image_size(image)
        except InputError as error:
            broken.append(str(error))
    if broken:
        shown = "; ".join(broken[:3]) + (f"; and {len(broken) - 3} more" if broken[3:] else "")
        draft.notes.append(f"left out, {len(broken)} of {len(images)} files: {shown}")
    if not sizes:
        return []
    common = Counter(sizes.values()).most_common(1)[0][0]
    others = [image.name for image, size in sizes.items() if size != common]
    if others:
        shown = ", ".join(others[:5]) + (f" and {len(others) - 5} more" if len(others) > 5 else "")
        draft.notes.append(
            f"left out, since not {common[0]}x{common[1]} px as most images: {shown}"
        )
    return [image for image, size in sizes.items() if size == common]


def _take_mask(images: list[Path], draft: Draft) -> list[Path]:
    masks = [image for image in images if _MASK_NAME.search(image.stem)]
    if len(masks) == 1 and len(images) > 1:
        if (read_grey(masks[0]) > 0).any():
            draft.manifest["mask"] = draft.add_image(masks[0], "mask")
    elif masks:
        draft.notes.append("several masks were left out; name the one that holds for all frames")
    return [image for image in images if image not in masks]


def _take_background(images: list[Path], draft: Draft, options: ImportOptions) -> list[Path]:
    """Set the background; returns the images that are left as presses."""
    if options.background is not None and options.background != MEDIAN:
        given = Path(options.background).name
        return [image for image in images if image.name != given]
    chosen, why = guess_background(images)
    if options.background == MEDIAN:
        return [image for image in images if not BACKGROUND_NAME.search(image.stem)]
    if chosen is None:
        draft.notes.append(f"no background: {why}; --background median takes that of the presses")
        return images
    draft.set_background(chosen)
    draft.notes.append(f"background: {why}")
    further = [i for i in images if i != chosen and BACKGROUND_NAME.search(i.stem)]
    if further:
        names = [draft.add_image(image, "untouched") for image in further]
        draft.manifest["untouched"] = names
    return [image for image in images if image != chosen and image not in further]


def _board(text: str, images: list[Path], draft: Draft) -> dict[str, Any]:
    match = _BOARD.match(text)
    if match is None:
        raise InputError(
            f"board {text!r}; kind:COLUMNSxROWS[:pitch_mm] is allowed, such as chessboard:6x6:2.5 "
            "(kinds chessboard, charuco, dots, pins)"
        )
    entry: dict[str, Any] = {
        "kind": match[1],
        "columns": int(match[2]),
        "rows": int(match[3]),
        "images": [draft.add_image(image) for image in images],
    }
    if match[4] is not None:
        try:
            entry["pitch_mm"] = number(match[4])
        except ValueError as error:
            raise InputError(f"board {text!r}: the pitch: {error}") from None
    return entry


def _take_records(path: Path, draft: Draft) -> None:
    for table in sorted(path.rglob("*.csv")):
        try:
            kind = kind_of_record(table)
        except InputError as error:
            if (note := not_used(table, error)) not in draft.notes:
                draft.notes.append(note)
            continue
        if kind is None:
            continue
        name = draft.add_file(table, path)
        draft.manifest.setdefault("records", []).append({"file": name, "kind": kind})
        draft.notes.append(f"{name} is taken as a record of kind {kind}; state its tool")


def _take_videos(path: Path, draft: Draft) -> None:
    videos = [p for p in sorted(path.rglob("*")) if p.suffix.lower() in VIDEO_SUFFIXES]
    if videos and "background" in draft.manifest:
        entries = [{"file": draft.add_file(video, path)} for video in videos]
        draft.manifest["markers"] = {"videos": entries}


LAYOUT = Layout("plain", "any folder of images", _recognises, _read, False)
