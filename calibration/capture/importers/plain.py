# SPDX-License-Identifier: Apache-2.0
"""Layouts of one's own captures: presses of a printer, a video of dots, a folder of images."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import cv2
import numpy as np

from taccel_lab.calibration.capture.camera.recording import is_video
from taccel_lab.calibration.capture.framing import (
    BACKGROUND_NAME,
    guess_background,
)
from taccel_lab.calibration.capture.importers.draft import (
    FALLBACK_SENSOR,
    MEDIAN,
    Draft,
    ImportOptions,
    board_entry,
)
from taccel_lab.calibration.capture.importers.files import (
    capture_folders,
    files_of,
    images_in,
    press_rows,
)
from taccel_lab.calibration.capture.importers.label_tables import without_path
from taccel_lab.calibration.capture.printer import COLUMNS, PRESSES_TABLE
from taccel_lab.calibration.capture.records import is_record
from taccel_lab.errors import InputError
from taccel_lab.files.foreign_images import unread_pictures
from taccel_lab.files.images import image_size, read_grey, read_image
from taccel_lab.files.inner_path import real_path
from taccel_lab.reading.dots.marker_picture import markers_or_none


def is_printed(path: Path) -> bool:
    return (path / PRESSES_TABLE).is_file()


def read_printed(path: Path, options: ImportOptions) -> list[Draft]:
    if not is_printed(path):
        return []
    table = path / PRESSES_TABLE
    draft = Draft("", FALLBACK_SENSOR, path)
    draft.assume_sensor()
    draft.used.add(table)
    background = draft.find_background(options, "background.png", "background.jpg")
    for image in images_in(path, "untouched_*"):
        if background not in (None, image):
            draft.add_untouched(image)
    image_column, x, y, depth, radius = COLUMNS
    rows = [row for row in press_rows(table, path, image_column) if row.image != background]
    stated = [
        {"depth_mm": r.first(depth), "stage_mm": r.together(x, y), "radius_mm": r.first(radius)}
        for r in rows
    ]
    draft.add_presses([row.image for row in rows], stated=stated)
    for name in (x, y, depth, radius) if rows else ():
        if rows[0].row.table.column(name) is None:
            draft.notes.append(f"no press has its {name}: no column is called so")
    return [draft]


MIN_FRAMES = 20
SAMPLED, STEADY = 12, 0.5
"""Pairs of neighbours that are looked at, and how much nearer than distant frames they have to be.
"""


def is_video_of_dots(path: Path) -> bool:
    if path.is_file():
        return is_video(path)
    if not path.is_dir() or any(path.glob("*.toml")):
        return False
    images = images_in(path)
    if not images:
        return bool(_videos(path))
    # Frames of a video count on without a gap, all with as many digits.
    numbers = [image.stem for image in images]
    return (
        len(images) >= MIN_FRAMES
        and all(number.isascii() and number.isdigit() for number in numbers)
        and int(numbers[-1]) - int(numbers[0]) == len(numbers) - 1
        and _moves_steadily(images)
        and markers_or_none(read_image(images[0])) is not None
    )


def _videos(path: Path) -> list[Path]:
    return [p for p in sorted(path.iterdir()) if is_video(p)]


def _moves_steadily(images: list[Path]) -> bool:
    """Whether neighbours are alike and distant frames are not: presses are all unlike."""
    pick = np.unique(np.linspace(0, len(images) - 2, SAMPLED).astype(int))
    small = {k: _small(images[k]) for k in {*pick, *(pick + 1)}}
    if len({image.shape for image in small.values()}) > 1:
        return False
    steps = [_distance(small[k], small[k + 1]) for k in pick]
    far = [_distance(small[a], small[b]) for a in pick for b in pick if a < b]
    return float(np.median(steps)) < STEADY * float(np.percentile(far, 90))


def _small(path: Path) -> np.ndarray:
    return cv2.resize(read_image(path), (64, 48), interpolation=cv2.INTER_AREA).astype(np.float32)


def _distance(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.abs(a - b).mean())


def read_video(path: Path, options: ImportOptions) -> list[Draft]:
    draft = Draft("", "gelsight_mini", path)
    draft.assume_sensor("the usual sensor with dots; --sensor names another")
    videos = [path] if path.is_file() else [] if images_in(path) else _videos(path)
    if videos:
        root = path.parent if path.is_file() else path
        entries = [{"file": draft.add_file(video, root)} for video in videos]
        draft.manifest["markers"] = {"videos": entries}
    else:
        images = images_in(path)
        if len(images) < 2:
            raise InputError(f"{path} holds {len(images)} images; a video needs at least 2 frames")
        names = [draft.add_image(image, f"frame_{image.stem}") for image in images]
        draft.manifest["markers"] = {"videos": [{"frames": names}]}
    draft.notes.append(
        "no picture at rest is stated: calibrate markers looks for frames in which the gel rests, "
        "and refuses where there are none"
    )
    return [draft]


_MASK_NAME = re.compile(r"(^|[_\-. ])mask($|[_\-. \d])", re.IGNORECASE)
_DERIVED_NAME = re.compile(r"(^|[_\-. ])(labeled|labelled|drawing|contours|annotated|pseudo)", re.I)
"""Pictures that scripts drew, not captures."""
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


def has_images(path: Path) -> bool:
    return path.is_dir() and bool(images_in(path, "**/*"))


def read_plain(path: Path, options: ImportOptions) -> list[Draft]:
    if not path.is_dir():
        raise InputError(f"{path} is a file; a folder with images is needed")
    draft = _draft(path)
    images = []
    for image in images_in(path, "**/*"):
        if _DERIVED_NAME.search(image.stem):
            draft.leave_out(image, "a drawing, by its name; rename it if it is none")
        else:
            images.append(image)
    images = _of_one_size(images, draft)
    if not images:
        reasons = "".join(f". {note}" for note in draft.remarks())
        other = unread_pictures(files_of(path))
        raise InputError(f"{path} holds no images; PNG or JPEG is allowed{reasons}{other}")
    if options.board is not None:
        entry = board_entry(options.board)
        draft.manifest["boards"] = [entry | {"images": [draft.add_image(i) for i in images]}]
        return [draft]
    images = _take_mask(images, draft)
    images = _take_background(path, images, draft, options)
    if images:
        draft.assume(
            "presses",
            "all images that are called neither background nor mask show one and the same ball",
        )
    draft.add_presses(images, lambda image: "_".join(image.relative_to(path).with_suffix("").parts))
    _take_records(path, draft)
    _take_videos(path, draft)
    return [draft]


def _draft(path: Path) -> Draft:
    """An empty draft of the sensor that the folder's path names, or else of any flat gel."""
    text = "/".join(real_path(path).parts[-3:]).lower().replace("-", "_").replace(" ", "_")
    for word, name in _SENSOR_WORDS:
        if word in text:
            draft = Draft("", name, path)
            draft.assume_sensor(f"by {word!r} in the path; --sensor names another")
            return draft
    draft = Draft("", FALLBACK_SENSOR, path)
    draft.assume_sensor()
    return draft


def _of_one_size(images: list[Path], draft: Draft) -> list[Path]:
    """The images of the commonest size; others and unreadable ones are left out."""
    sizes = {}
    for image in images:
        try:
            sizes[image] = image_size(image)
        except InputError as error:
            draft.leave_out(image, without_path(image, error))
    if not sizes:
        return []
    common = Counter(sizes.values()).most_common(1)[0][0]
    for image, size in sizes.items():
        if size != common:
            draft.leave_out(
                image, f"{size[0]}x{size[1]} px, not {common[0]}x{common[1]} px as most images"
            )
    return [image for image, size in sizes.items() if size == common]


def _take_mask(images: list[Path], draft: Draft) -> list[Path]:
    masks = [image for image in images if _MASK_NAME.search(image.stem)]
    if len(masks) == 1 and len(images) > 1:
        if (read_grey(masks[0]) > 0).any():
            draft.manifest["mask"] = draft.add_image(masks[0], "mask")
            draft.assume("mask", f"{masks[0].name}, by its name")
        else:
            draft.leave_out(masks[0], "a mask without a pixel that is not 0")
    else:
        for mask in masks:
            draft.leave_out(
                mask, "one of several masks; call the one that holds for all frames mask alone"
            )
    return [image for image in images if image not in masks]


def _take_background(
    path: Path, images: list[Path], draft: Draft, options: ImportOptions
) -> list[Path]:
    """Set the background; returns the images that are left as presses."""
    named = [image for image in images if BACKGROUND_NAME.search(image.stem)]
    rest = [image for image in images if image not in named]
    if options.background == MEDIAN:
        for image in named:
            draft.leave_out(image, "called a background, which --background median replaces")
        return rest
    chosen = None
    if options.background is None:
        chosen, why = guess_background(images)
        if chosen is None:
            draft.notes.append(
                f"no background: {why}; --background median takes that of the presses"
            )
            return images
        draft.set_background(chosen, why)
    else:
        places = (Path(options.background), path / options.background)
        given = {real_path(place) for place in places if place.is_file()}
        named = [image for image in named if real_path(image) not in given]
    further = [image for image in named if image != chosen]
    if further:
        draft.manifest["untouched"] = [draft.add_image(image, "untouched") for image in further]
        draft.assume("untouched", f"{', '.join(i.name for i in further)}, by the names")
    return [image for image in images if image != chosen and image not in further]


def _take_records(path: Path, draft: Draft) -> None:
    written = capture_folders(path)
    for table in sorted(path.rglob("*.csv")):
        if not written.isdisjoint(table.parents):
            continue
        try:
            if not is_record(table):
                continue
        except InputError as error:
            draft.leave_out(table, without_path(table, error))
            continue
        draft.left_out.pop(table, None)
        name = draft.add_file(table, path)
        draft.manifest.setdefault("records", []).append({"file": name, "kind": "indentation"})
        draft.assume(name, "a record of an indentation, by its columns; state its tool")


def _take_videos(path: Path, draft: Draft) -> None:
    written = capture_folders(path)
    videos = [p for p in sorted(path.rglob("*")) if is_video(p) and written.isdisjoint(p.parents)]
    if "background" not in draft.manifest:
        for video in videos:
            draft.leave_out(video, "a video of dots needs a background, which shows them at rest")
    elif videos:
        entries = [{"file": draft.add_file(video, path)} for video in videos]
        draft.manifest["markers"] = {"videos": entries}
        draft.assume("markers", "the videos are of dots on the gel, at rest in the background")
