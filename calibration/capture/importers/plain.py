# SPDX-License-Identifier: Apache-2.0
"""A plain folder: images of presses, perhaps a background, a mask, label tables and records."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

from taccel_lab.calibration.capture.importers.background_guess import (
    BACKGROUND_NAME,
    guess_background,
)
from taccel_lab.calibration.capture.importers.draft import (
    FALLBACK_SENSOR,
    MEDIAN,
    CaptureLayout,
    Draft,
    ImportOptions,
    board_entry,
)
from taccel_lab.calibration.capture.importers.files import capture_folders, images_in
from taccel_lab.calibration.capture.importers.label_tables import without_path
from taccel_lab.calibration.capture.records import is_record
from taccel_lab.calibration.capture.suffixes import is_video
from taccel_lab.errors import InputError
from taccel_lab.files.images import image_size, read_grey
from taccel_lab.files.inner_path import real_path

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


def _recognises(path: Path) -> bool:
    return path.is_dir() and bool(images_in(path, "**/*"))


def _read(path: Path, options: ImportOptions) -> list[Draft]:
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
        raise InputError(f"{path} holds no images; PNG or JPEG is allowed{reasons}")
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


LAYOUT = CaptureLayout("plain", "any folder of images", _recognises, _read)
