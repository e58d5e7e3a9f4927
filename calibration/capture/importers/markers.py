# SPDX-License-Identifier: Apache-2.0
"""A video of a gel with dots: one video file, or many consecutive frames."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from taccel_lab.calibration.capture.importers.draft import CaptureLayout, Draft, ImportOptions
from taccel_lab.calibration.capture.importers.files import images_in
from taccel_lab.calibration.capture.suffixes import is_video
from taccel_lab.calibration.dots.marker_picture import find_markers
from taccel_lab.errors import InputError
from taccel_lab.files.images import read_image

MIN_FRAMES = 20
SAMPLED, STEADY = 12, 0.5
"""Pairs of neighbours that are looked at, and how much nearer than distant frames they have to be.
"""


def _recognises(path: Path) -> bool:
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
        and _shows_dots(images[0])
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


def _shows_dots(path: Path) -> bool:
    try:
        find_markers(read_image(path))
    except InputError:
        return False
    return True


def _read(path: Path, options: ImportOptions) -> list[Draft]:
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


LAYOUT = CaptureLayout(
    "markers", "a video, or numbered frames, of a gel with dots", _recognises, _read
)
