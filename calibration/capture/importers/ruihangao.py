# SPDX-License-Identifier: Apache-2.0
"""ShapeMap3D for the GelSight Mini (RuihanGao; MIT): ``calib_ball/frame_<n>``, frame 0 untouched.

Facts used: ball of R = 2.0 mm and 0.08 mm/px (its ``sensorParams.py``). Frame 0 of the published
set is a crop of the framing of the others, which ``capture check`` says.
"""

from __future__ import annotations

from pathlib import Path

from taccel_lab.calibration.capture.importers.draft import Draft, ImportOptions
from taccel_lab.calibration.capture.importers.files import first_existing, images_in
from taccel_lab.calibration.capture.importers.layout import Layout

SOURCE = "ShapeMap3D-GelSightMini (RuihanGao), calib_ball"
LICENSE = "MIT"
BALL_RADIUS_MM = 2.0
MM_PER_PX = 0.08


def _place(path: Path) -> Path:
    return path / "calib_ball" if (path / "calib_ball").is_dir() else path


def _recognises(path: Path) -> bool:
    place = _place(path)
    return place.name == "calib_ball" and place.is_dir() and any(place.glob("frame_*.*"))


def _read(path: Path, options: ImportOptions) -> list[Draft]:
    place = _place(path)
    draft = Draft("", "gelsight_mini", SOURCE, LICENSE)
    draft.set_ball(BALL_RADIUS_MM)
    draft.set_scale(MM_PER_PX)
    background = first_existing(*sorted(place.glob("frame_0.*")))
    if background is not None:
        draft.set_background(background)
    for image in images_in(place):
        if image.stem.startswith("frame_") and image != background:
            draft.add_press(image)
    return [draft]


LAYOUT = Layout("ruihangao", "calib_ball/frame_<n>, frame 0 untouched", _recognises, _read)
