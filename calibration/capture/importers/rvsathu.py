# SPDX-License-Identifier: Apache-2.0
"""GelSight-Sim2Real (RVSATHU, RA-L 2022): ``calib_<n>_real.png`` and a list of circles.

Facts used: ball of R = 2.92 mm and 0.05926 mm/px (its ``depth_reconstruction`` scripts).
"""

from __future__ import annotations

from pathlib import Path

from taccel_lab.calibration.capture.importers.background_guess import BACKGROUND_NAME
from taccel_lab.calibration.capture.importers.draft import Draft, ImportOptions
from taccel_lab.calibration.capture.importers.files import (
    first_existing,
    images_in,
    label_for,
    labels_of,
)
from taccel_lab.calibration.capture.importers.layout import Layout

SOURCE = "GelSight-Sim2Real (RVSATHU), depth_reconstruction"
BALL_RADIUS_MM = 2.92
MM_PER_PX = 0.05926
_PATTERN = "calib_*_real.*"


def _recognises(path: Path) -> bool:
    return path.is_dir() and any(path.glob(_PATTERN))


def _read(path: Path, options: ImportOptions) -> list[Draft]:
    draft = Draft("", "flat_pad", SOURCE)
    named = [image for image in images_in(path) if BACKGROUND_NAME.search(image.stem)]
    background = first_existing(*sorted(path.glob("background_real.*")), *named)
    if background is not None:
        draft.set_background(background)
    elif options.background is None:
        draft.notes.append(
            "no background: background_real.png is missing; give one with --background, or "
            "--background median for that of the presses"
        )
    draft.set_ball(BALL_RADIUS_MM)
    draft.set_scale(MM_PER_PX)
    labels = labels_of(path)
    for image in images_in(path):
        if image.match(_PATTERN):
            draft.add_press(image, contact=label_for(image, path, labels))
    return [draft]


LAYOUT = Layout(
    "rvsathu", "GelSight-Sim2Real: calib_<n>_real.png, background_real.png", _recognises, _read
)
