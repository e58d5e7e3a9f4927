# SPDX-License-Identifier: Apache-2.0
"""FOTS (Zhao et al., RA-L 2024): ``mlp_calib`` with numbered presses, and ``marker_calib``.

Facts used: ball of 4.70 mm and 19.58 px/mm for the GelSight Mini (``params.py``,
``normal_to_rgb.yaml``); for the DIGIT both 4.7 and 6.0 mm appear in the code, so neither is taken.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from taccel_lab.calibration.capture.importers.draft import Draft, ImportOptions
from taccel_lab.calibration.capture.importers.files import (
    first_existing,
    images_in,
)
from taccel_lab.calibration.capture.importers.label_tables import Circle, read_label_tables
from taccel_lab.calibration.capture.importers.layout import Layout
from taccel_lab.errors import InputError
from taccel_lab.reading.table_file import read_table_text

_PUBLISHED = "params.py and normal_to_rgb.yaml of Rancho-zhao/FOTS"
MINI_BALL_RADIUS_MM = 2.35
MINI_MM_PER_PX = 1 / 19.58


def _recognises(path: Path) -> bool:
    return (path / "mlp_calib").is_dir() or (path / "marker_calib").is_dir()


def _read(path: Path, options: ImportOptions) -> list[Draft]:
    drafts = []
    sensors = {"gelsight": "gelsight_mini", "digit": "digit"}
    folders = [path / "mlp_calib" / part for part in sensors]
    images = {place.name: images_in(place) for place in folders if place.is_dir()}
    labels = read_label_tables(path)
    of_presses = [image for found in images.values() for image in found]
    circles = labels.of_images(of_presses)
    drafts += [
        _presses(path, part, sensors[part], found, circles, options)
        for part, found in images.items()
        if found
    ]
    if (path / "marker_calib" / "data").is_dir():
        drafts.append(_markers(path / "marker_calib" / "data"))
    if drafts:
        labels.tell(drafts[0], of_presses)
    if not drafts:
        raise InputError(
            f"{path}: mlp_calib holds neither gelsight nor digit with images, and there is no "
            "marker_calib/data"
        )
    return drafts


def _presses(
    path: Path,
    part: str,
    sensor: str,
    images: list[Path],
    circles: dict[Path, Circle],
    options: ImportOptions,
) -> Draft:
    calib = path / "mlp_calib"
    draft = Draft(part, sensor, path)
    draft.assume("sensor", f"{sensor}, that of the folder mlp_calib/{part} of the published set")
    assets = path / "assets" / "gel" / f"{part}_bg.png"
    if part == "gelsight":
        background = first_existing(calib / "0000.png", assets)
        draft.set_ball(MINI_BALL_RADIUS_MM, f"that of the published set: {_PUBLISHED}")
        draft.set_scale(MINI_MM_PER_PX, why=f"that of the published set: {_PUBLISHED}")
    else:
        background = first_existing(calib / "scripts" / "0000.png", assets)
        draft.notes.append(
            "ball and scale of the DIGIT set are unproven (4.7 and 6.0 mm appear in its code); "
            "add [indenter] radius_mm and mm_per_px_x, mm_per_px_y where you know them"
        )
    if background is not None:
        draft.set_background(background, f"{background.relative_to(path)}, by its name")
    elif options.background is None:
        raise InputError(
            f"{path}: no background; {assets} or mlp_calib/0000.png is needed, or --background"
        )
    if background is not None and assets.is_file() and assets != background:
        _add_untouched(draft, assets)
    for image in images:
        draft.add_press(image, contact=circles.get(image))
    shadows = path / "shadow_calib" / "shadow_data"
    if part == "digit" and shadows.is_dir():
        for image in images_in(shadows):
            draft.add_press(image)
        draft.assume(
            "presses", "images of shadow_calib/shadow_data are of the same sensor and ball"
        )
    return draft


def _add_untouched(draft: Draft, image: Path) -> None:
    """A further background, unless it is the same image again."""
    from taccel_lab.reading.images import read_image
    from taccel_lab.reading.regular_file import file_sha256

    first = draft.files[draft.manifest["background"]]
    assert isinstance(first, Path)
    if file_sha256(first) == file_sha256(image):
        draft.leave_out(image, "the same image as the background")
    elif read_image(first).shape != read_image(image).shape:
        draft.leave_out(image, "not of the background's size")
    else:
        draft.manifest["untouched"] = [draft.add_image(image, "untouched")]


def _markers(data: Path) -> Draft:
    draft = Draft("markers", "gelsight_mini", data)
    draft.assume("sensor", "gelsight_mini, that of the published set (Rancho-zhao/FOTS)")
    frames = images_in(data)
    if not frames:
        raise InputError(f"{data} holds no images")
    # The table has the dots of the first frame: places without load, and the way from there.
    markers: dict[str, Any] = {"labels_image": draft.add_image(frames[0], "labelled")}
    draft.manifest["markers"] = markers
    table = first_existing(frames[0].with_suffix(".csv"))
    if table is not None:
        head, _, rows = read_table_text(table).partition("\n")
        if head.replace(" ", "") == "Mx,My,dx,dy":
            head = "u_px,v_px,du_px,dv_px"
        draft.files["marker_labels.csv"] = f"{head}\n{rows.removesuffix(chr(10))}\n"
        markers["labels"] = "marker_labels.csv"
        draft.used.add(table)
        draft.assume(
            "labels",
            f"{table.name} has the places of the dots without load and the way from there to where "
            f"{frames[0].name} shows them, that of the published set",
        )
    if len(frames) > 1:
        names = [draft.add_image(frame, f"frame_{frame.stem}") for frame in frames]
        markers["videos"] = [{"frames": names}]
    else:
        draft.notes.append(
            "the only frame is a press: its dots have moved by what marker_labels.csv says, and "
            "there is no picture of the gel at rest, so that calibrate markers refuses; give one "
            "as markers.rest"
        )
    return draft


LAYOUT = Layout("fots", "FOTS: mlp_calib/{gelsight,digit}, marker_calib/data", _recognises, _read)
