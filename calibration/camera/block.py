# SPDX-License-Identifier: Apache-2.0
"""The camera, seen by boards."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taccel_lab.calibration.block import Block, BlockWords, Files, Needs
from taccel_lab.calibration.camera.options import CameraOptions
from taccel_lab.errors import InputError
from taccel_lab.printable import counted

if TYPE_CHECKING:
    from taccel_lab.calibration.capture.folder import CaptureFolder


@dataclass(frozen=True, kw_only=True)
class CameraWords(BlockWords, CameraOptions):
    """Fit the camera to views of a calibration board and write a profile.

    Boards held before the camera give the lens (optics block); boards that lie on the gel or are
    pressed into it give mm/px in x and y and the pose of the gel (camera block). Chessboards,
    ChArUco boards, boards of dots and of pins are found, also where points are missing
    (docs/calibration_camera.md).
    """

    maps: Path | None = None
    """File (.npz) for rectification maps: map_u_px and map_v_px for cv2.remap, the pixels that the
    board measured, and the grid's scale."""

    def check(self) -> None:
        """Refuse a file of maps that cannot be written."""
        if self.maps is not None and (self.maps.suffix != ".npz" or self.maps.is_dir()):
            raise InputError(f"--maps writes one .npz file, got {self.maps}")

    def files(self, result: Any) -> Files:
        return {} if self.maps is None else {self.maps: lambda path: result.maps().save(path)}


def _needs(folder: CaptureFolder, _: bool | None) -> Needs:
    views = sum(len(board.frames) for board in folder.boards)
    if not views:
        return Needs("", "views of a board: chessboard, ChArUco or dots")
    return Needs(f"{counted(views, 'view')} of boards")


BLOCK = Block(
    name="camera",
    home=__name__,
    words=CameraWords,
    needs=_needs,
    checked_by="check:check_lens_boards",
    fitted_by="fit:calibrate_camera",
    shown_by="camera_page:camera_page",
    choices="options:CameraOptions",
    reads_folder=True,
    measures_scale=True,
    telling=4,
)
