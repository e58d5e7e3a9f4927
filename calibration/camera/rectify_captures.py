# SPDX-License-Identifier: Apache-2.0
"""A capture folder whose images were rectified: one scale everywhere, boards done with."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.calibration.camera.rectification import RectificationMaps
from taccel_lab.calibration.capture.captures import CapturedPress
from taccel_lab.calibration.capture.folder import CaptureFolder, Frame, MarkerCaptures
from taccel_lab.calibration.capture.schema import MANIFEST_NAME, SCHEMA_VERSION
from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import write_image
from taccel_lab.files.documents import read_toml
from taccel_lab.files.inner_path import copy_inner
from taccel_lab.files.output_folder import atomic_directory

LEFT_OUT = "{} were left out"
_Write = Callable[[str, np.ndarray], str]


def rectify_captures(folder: CaptureFolder, maps: RectificationMaps, out: Path) -> list[str]:
    """Write the captures of ``folder``, rectified, as the capture folder ``out``.

    Images become PNG, videos numbered PNG; force records and paths are copied. Boards are left out,
    since the maps were made of them, and so are contact circles and edge lines, which are places in
    raw images: both are found again. Pixels that the raw image does not show are masked.

    Returns:
        What was left out, in sentences.

    Raises:
        InputError: Maps without a scale, or of another image size than the captures.
    """
    grid = maps.require_grid()
    height, width = folder.require_background().image().shape[:2]
    maps.require_raw_size((width, height), folder.source)
    if not (folder.root / MANIFEST_NAME).is_file():
        raise InputError(
            f"{folder.source} has no {MANIFEST_NAME}; make a capture folder of it first "
            "(taccel-lab capture import)"
        )
    import tomli_w

    document = read_toml(folder.root / MANIFEST_NAME)
    notes: list[str] = []
    with atomic_directory(out) as target:

        def write(name: str, image: np.ndarray) -> str:
            """Write an image, rectified; returns its file name."""
            write_image(target / f"{name}.png", maps.apply(image))
            return f"{name}.png"

        document["schema_version"] = SCHEMA_VERSION
        document["rectified"] = True
        document["mm_per_px_x"], document["mm_per_px_y"] = grid.mm_per_px_x, grid.mm_per_px_y
        document.get("assumed", {}).pop("mm_per_px", None)  # The maps have measured it.
        if folder.background is not None:
            document["background"] = write("background", folder.background.image())
            document["mask"] = "mask.png"
            # Pixels that the raw image shows and that were not masked in it.
            usable = maps.inside((height, width))
            if folder.mask is not None:
                usable &= maps.apply(folder.mask.astype(np.uint8)) > 0
            write_image(target / "mask.png", usable.astype(np.uint8) * 255)
        if folder.untouched:
            document["untouched"] = [
                write(f"untouched_{i}", frame.image()) for i, frame in enumerate(folder.untouched)
            ]
        if document.get("presses"):
            document["presses"] = _presses(document["presses"], folder, write, notes)
        for i, (entry, edge) in enumerate(
            zip(document.get("edges", []), folder.edges, strict=True)
        ):
            entry["image"] = write(f"edge_{i:03d}", edge.frame.image())
            entry.pop("line", None)
        if document.pop("boards", None):
            notes.append(LEFT_OUT.format("boards"))
        if folder.markers is not None:
            document["markers"] = _markers(document["markers"], folder.markers, write)
        for entry in document.get("records", []):
            copy_inner(folder.root, entry["file"], target)
        # What the rectified images were made of: their own hashes say nothing about that.
        document["raw_sha256"] = {"captures.toml": folder.provenance["manifest_sha256"]} | {
            Path(frame.source).name: frame.sha256 for frame in _raw_frames(folder)
        }
        (target / MANIFEST_NAME).write_text(tomli_w.dumps(document), encoding="utf-8")
    return notes


def _raw_frames(folder: CaptureFolder) -> list[Frame | CapturedPress]:
    frames: list[Frame | CapturedPress] = [*folder.untouched, *folder.presses]
    frames += [edge.frame for edge in folder.edges]
    return frames if folder.background is None else [folder.background, *frames]


def _presses(
    entries: list[dict[str, Any]], folder: CaptureFolder, write: _Write, notes: list[str]
) -> list[dict[str, Any]]:
    """Entries of the presses that contacts.toml does not skip."""
    kept, skipped = [], []
    left = list(folder.presses)
    for entry in entries:
        name = entry.get("name") or Path(entry["image"]).stem
        # In the order of the manifest; two may have one name.
        if not left or left[0].name != name:
            skipped.append(name)
            continue
        i, press = len(kept), left.pop(0)
        entry["image"] = write(f"press_{i:03d}", press.image())
        entry.setdefault("name", press.name)
        if entry.pop("contact", None) is not None or press.checked:
            notes.append(f"the contact circle of {press.name} was left out")
        kept.append(entry)
    if skipped:
        notes.append(f"presses that contacts.toml skips were left out: {', '.join(skipped)}")
    return kept


def _markers(entry: dict[str, Any], markers: MarkerCaptures, write: _Write) -> dict[str, Any]:
    entry = {k: value for k, value in entry.items() if k not in ("labels", "labels_image")}
    if markers.rest is not None:
        entry["rest"] = write("markers_rest", markers.rest.image())
    videos = []
    for i, (table, video) in enumerate(zip(entry.get("videos", []), markers.videos, strict=True)):
        frames = [write(f"video_{i}_{k:05d}", frame) for k, frame in enumerate(video.frames())]
        kept = {key: value for key, value in table.items() if key not in ("file", "frames")}
        videos.append({**kept, "frames": frames})
    if videos:
        entry["videos"] = videos
    return entry
