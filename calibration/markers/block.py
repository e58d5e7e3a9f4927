# SPDX-License-Identifier: Apache-2.0
"""Dots on the gel."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taccel_lab.calibration.block import Block, BlockWords, Files, Needs
from taccel_lab.printable import counted

if TYPE_CHECKING:
    from taccel_lab.calibration.capture.folder import CaptureFolder


@dataclass(frozen=True, kw_only=True)
class MarkerWords(BlockWords):
    """Find the dots painted on the gel, fit their grid and follow them through videos.

    Dots may be dark or bright, of any size, in a square, rectangular or hexagonal grid, with some
    missing; nothing needs tuning. The picture at rest is [markers] rest in captures.toml, else the
    background, else still frames of [[markers.videos]]. Without any of these the command fails. A
    base with a calibrated camera or scale gives the millimetres.
    """

    tracks: Path | None = None
    """File for the dots' positions and displacements in every frame, pixels and millimetres:
    .npz or .csv."""

    def check(self) -> None:
        """Refuse a file of tracks of an unknown kind."""
        from taccel_lab.calibration.markers.tracks import require_track_file

        if self.tracks is not None:
            require_track_file(self.tracks)

    def files(self, result: Any) -> Files:
        from taccel_lab.calibration.markers.tracks import write_tracks

        tracks = {video.name: video.tracks for video in result.videos}
        if self.tracks is None:
            return {}
        return {self.tracks: lambda path: write_tracks(path, tracks, result.flows())}


def _needs(folder: CaptureFolder, _: bool | None) -> Needs:
    if folder.markers is None:
        return Needs("", "an image of the dots at rest, videos of them moving")
    videos = len(folder.markers.videos)
    if folder.markers.rest is None and not videos:
        return Needs("an image of pressed dots", "an image of the dots at rest")
    rest = "videos show rest" if folder.markers.rest is None else "dots at rest"
    return Needs(f"{rest}, {counted(videos, 'video')}")


BLOCK = Block(
    name="markers",
    home=__name__,
    words=MarkerWords,
    needs=_needs,
    checked_by="check:check_markers",
    fitted_by="fit:calibrate_markers",
    shown_by="markers_page:markers_page",
    telling=5,
)
