# SPDX-License-Identifier: Apache-2.0
"""Ball presses of a grey sensor at a known scale, rectified where maps are given."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from taccel_lab.calibration.base_profile import MEASURED, captures_on_pad, require_image_of
from taccel_lab.calibration.camera.rectification import RectificationMaps
from taccel_lab.calibration.capture.captures import CapturedPress, CaptureSet
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.shared_remarks import SCALE_NOT_MEASURED
from taccel_lab.errors import InputError
from taccel_lab.profile import SensorProfile
from taccel_lab.report.remark import Remark


def grey_captures(
    folder: CaptureFolder, base: SensorProfile, maps: Path | None
) -> tuple[CaptureSet, list[Remark]]:
    """The presses, and what had to be assumed.

    The scale is that of the maps; else that of the profile's camera where it was measured on this
    unit and has images of this size; else that of the captures; else what the profile says.
    """
    remarks: list[Remark] = []
    if maps is not None:
        rectification = RectificationMaps.load(maps)
        grid = rectification.require_grid()
        captures = folder.ball_presses((grid.mm_per_px_x, grid.mm_per_px_y))
        raw = captures.grid.width_px, captures.grid.height_px
        rectification.require_raw_size(raw, folder.source)
        return _rectified(captures, rectification), remarks
    require_image_of(base, folder)
    grid, kind = base.camera.grid(), base.camera.provenance.kind
    captures = folder.ball_presses((grid.mm_per_px_x, grid.mm_per_px_y))
    same = (captures.grid.width_px, captures.grid.height_px) == (grid.width_px, grid.height_px)
    if folder.mm_per_px is not None and not (same and kind in MEASURED):
        return captures_on_pad(folder.ball_presses(), base), remarks
    if folder.mm_per_px is None and kind not in MEASURED:
        source = f"{grid.mm_per_px_x:.4g} mm/px of the profile ({kind})"
        remarks.append(SCALE_NOT_MEASURED(source=source))
    captures = replace(captures, grid=grid) if same else captures
    return captures_on_pad(captures, base), remarks


def _rectified(captures: CaptureSet, maps: RectificationMaps) -> CaptureSet:
    def press_of(press: CapturedPress) -> CapturedPress:
        if press.circle is not None:
            raise InputError(
                f"{press.source}: contact circles are those of raw images and do not fit "
                "--maps; leave them out, they are found"
            )
        return replace(press, read=lambda: maps.apply(press.image()))

    raw_size = captures.background.shape[:2]
    mask = maps.apply(captures.mask.astype(np.uint8)) > 0
    return replace(
        captures,
        background=maps.apply(captures.background),
        mask=mask & maps.inside(raw_size),
        grid=maps.require_grid(),
        presses=tuple(press_of(press) for press in captures.presses),
    )
