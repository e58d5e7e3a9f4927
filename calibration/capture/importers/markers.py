# SPDX-License-Identifier: Apache-2.0
"""A video of a gel with dots: one video file, or many consecutive frames."""

from __future__ import annotations

from pathlib import Path

from calibration.capture.importers.draft import Draft, ImportOptions
from calibration.capture.importers.files import images_in
from calibration.capture.importers.layout import Layout
from calibration.capture.video import read_video
from taccel_lab.errors import InputError

VIDEO_SUFFIXES = (".avi", ".mp4", ".mov", ".mkv")
MIN_FRAMES = 20


def _recognises(path: Path) -> bool:
    if path.is_file():
        return path.suffix.lower() in VIDEO_SUFFIXES
    if not path.is_dir() or any(path.glob("*.toml")):
        return False
    images = images_in(path)
    # Frames of a video count on without a gap, all with as many digits.
    numbers = [image.stem for image in images]
    return (
        len(images) >= MIN_FRAMES
        and all(number.isdigit() for number in numbers)
        and len({len(number) for number in numbers}) == 1
        and int(numbers[-1]) - int(numbers[0]) == len(numbers) - 1
    )


def _read(path: Path, options: ImportOptions) -> list[Draft]:
    draft = Draft("", "gelsight_mini", f"frames of a gel with dots, {path.name}")
    if path.is_file():
        frames = read_video(path)
        draft.files[path.name] = path
        draft.manifest["markers"] = {
            "rest": draft.add_image(frames[0], "rest"),
            "videos": [{"file": path.name}],
        }
    else:
        images = images_in(path)
        if len(images) < 2:
            raise InputError(f"{path} holds {len(images)} images; a video needs at least 2 frames")
        names = [draft.add_image(image, f"frame_{image.stem}") for image in images]
        draft.manifest["markers"] = {"rest": names[0], "videos": [{"frames": names}]}
    draft.notes.append("the first frame is taken as the gel at rest")
    return [draft]


LAYOUT = Layout("markers", "a video, or numbered frames, of a gel with dots", _recognises, _read)
