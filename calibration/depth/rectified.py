# SPDX-License-Identifier: Apache-2.0
"""Ball presses of a grey sensor at a known scale, rectified where maps are given."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from calibration.capture.captures import CaptureSet, Press
from calibration.capture.folder import CaptureFolder
from calibration.capture.load import load_capture_folder
from calibration.result import Remark, Severity
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import SensorProfile


@dataclass(frozen=True)
class Rectification:
    """Maps from a rectified image to a raw one, as ``taccel-lab calibrate camera`` writes them."""

    map_u_px: np.ndarray
    """float32, shape [height_px, width_px]."""
    map_v_px: np.ndarray
    grid: PixelGrid

    @classmethod
    def load(cls, path: Path) -> Rectification:
        """Read the npz; InputError says what it lacks."""
        try:
            with np.load(path, allow_pickle=False) as stored:
                wanted = ("map_u_px", "map_v_px", "mm_per_px", "center_px")
                missing = [key for key in wanted if key not in stored.files]
                if missing:
                    raise InputError(
                        f"{path} lacks {', '.join(missing)}; maps with a scale are written by "
                        "taccel-lab calibrate camera --maps from a board on the gel"
                    )
                u, v = (np.asarray(stored[key], dtype=np.float32) for key in wanted[:2])
                scale, center = (np.asarray(stored[key], dtype=float) for key in wanted[2:])
        except (OSError, EOFError, zipfile.BadZipFile, ValueError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{path} is not a readable .npz of plain arrays: {error}") from error
        if u.shape != v.shape or u.ndim != 2 or scale.shape != (2,) or center.shape != (2,):
            raise InputError(
                f"{path}: maps {u.shape} and {v.shape}, scale {scale.shape} and middle "
                f"{center.shape}; two maps of one size and two numbers each are needed"
            )
        grid = PixelGrid(
            u.shape[1],
            u.shape[0],
            float(scale[0]),
            float(scale[1]),
            float(center[0]),
            float(center[1]),
        )
        return cls(u, v, grid)

    def apply(self, image: np.ndarray) -> np.ndarray:
        """The rectified image; black where the raw one shows nothing."""
        return cv2.remap(image, self.map_u_px, self.map_v_px, cv2.INTER_LINEAR)

    def inside(self, raw_size: tuple[int, int]) -> np.ndarray:
        """Pixels that the raw image, of (height, width), shows, bool."""
        height, width = raw_size
        u, v = self.map_u_px, self.map_v_px
        return (u >= 0) & (v >= 0) & (u <= width - 1) & (v <= height - 1)


def grey_captures(
    path: Path, base_of: Callable[[CaptureFolder], SensorProfile], maps: Path | None
) -> tuple[CaptureSet, SensorProfile, list[Remark]]:
    """The presses, the profile to extend, and what had to be assumed.

    The scale is that of the maps, else that of the captures, else that of the profile.
    """
    folder = load_capture_folder(path)
    base = base_of(folder)
    remarks: list[Remark] = []
    if maps is not None:
        rectification = Rectification.load(maps)
        captures = folder.ball_presses(
            (rectification.grid.mm_per_px_x, rectification.grid.mm_per_px_y)
        )
        return _rectified(captures, rectification), base, remarks
    scale = folder.mm_per_px
    if scale is None:
        scale = (base.camera.mm_per_px_x, base.camera.mm_per_px_y)
        kind = base.camera.provenance.kind
        remarks.append(
            Remark(
                Severity.INFO if kind in ("calibrated", "measured") else Severity.WARNING,
                "scale_of_profile",
                f"the captures state no scale; {scale[0]:.4g} mm/px is that of the profile "
                f"({kind}). Calibrate the camera on a board (taccel-lab calibrate camera)",
            )
        )
        grid = base.camera.grid()
        captures = folder.ball_presses(scale)
        if (captures.grid.width_px, captures.grid.height_px) == (grid.width_px, grid.height_px):
            captures = replace(captures, grid=grid)
        return captures, base, remarks
    return folder.ball_presses(scale), base, remarks


def _rectified(captures: CaptureSet, maps: Rectification) -> CaptureSet:
    def press_of(press: Press) -> Press:
        if press.circle is not None:
            raise InputError(
                f"{press.source}: contact circles are those of raw images and do not go with "
                "--maps; leave them out, they are found"
            )
        return replace(press, read=lambda: maps.apply(press.image()))

    raw_size = captures.background.shape[:2]
    mask = maps.apply(captures.mask.astype(np.uint8)) > 0
    return replace(
        captures,
        background=maps.apply(captures.background),
        mask=mask & maps.inside(raw_size),
        grid=maps.grid,
        presses=tuple(press_of(press) for press in captures.presses),
    )
