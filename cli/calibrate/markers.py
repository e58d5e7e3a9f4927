# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate markers``: a picture of the dots, and videos of their motion, in; the
profile's markers and the dots' tracks out."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from taccel_lab.cli.calibrate.base import BlockCommand, Fitted

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.calibration.capture.folder import CaptureFolder
    from taccel_lab.calibration.markers.result import MarkerCalibration
    from taccel_lab.progress import Progress


@dataclass(frozen=True)
class CalibrateMarkers(BlockCommand):
    """Find the dots painted on the gel, fit their grid and follow them through videos.

    Dots may be dark or bright, of any size, in a square, rectangular or hexagonal grid, with some
    missing; nothing has to be tuned. The picture at rest is [markers] rest in captures.toml, or the
    background, or else frames of the videos, [[markers.videos]], over which nothing moves; where
    there are none the command refuses.
    """

    base: Path | None = None
    """Profile to extend; the catalogue's design of the sensor when left out. A profile with a
    calibrated camera or scale gives the millimetres."""
    tracks: Path | None = None
    """File for the dots' places and displacements in every frame, pixels and millimetres:
    .json, .npz or .csv."""

    def check(self) -> None:
        """Refuse a file of tracks of an unknown kind."""
        from taccel_lab.calibration.markers.track_files import require_track_file

        if self.tracks is not None:
            require_track_file(self.tracks)

    def fit(self, folder: CaptureFolder, progress: Progress) -> Fitted:
        """Find the dots and follow them."""
        from taccel_lab.calibration.markers.fit import calibrate_markers
        from taccel_lab.calibration.markers.report import marker_page
        from taccel_lab.calibration.markers.track_files import write_tracks

        base = self.profile_to_extend(folder)
        result = calibrate_markers(folder, base, progress)
        tracks = {video.name: video.tracks for video in result.videos}
        files = (
            {}
            if self.tracks is None
            else {self.tracks: lambda path: write_tracks(path, tracks, result.flows())}
        )
        page = marker_page(result)
        return Fitted("markers", base, result, page, partial(_print_figures, result), files)


def _print_figures(result: MarkerCalibration, console: Console) -> None:
    from rich.table import Table

    table = Table(
        "quantity",
        "value",
        "sigma",
        "unit",
        title=f"{result.picture.dots.count} dots, {result.picture.lattice.kind} grid of "
        f"{result.layout_mm.rows} rows and {result.layout_mm.columns} columns",
        title_justify="left",
    )
    for name, estimate in result.estimates().items():
        table.add_row(name, f"{estimate.value:.4f}", f"{estimate.sigma:.4f}", estimate.unit)
    for name, value in result.residuals().items():
        table.add_row(name, f"{value:.4f}", "", name.rsplit("_", 1)[-1])
    console.print(table)
    for video in result.videos:
        figures = video.figures
        line = (
            f"{figures.name}: {figures.frames} frames, {100 * figures.seen_share:.1f} % seen, up "
            f"to {figures.largest_px:.1f} px from rest"
        )
        if figures.jitter_px is not None:
            line += f", jitter {figures.jitter_px:.4f} px over {figures.quiet_frames} frames"
        if figures.return_frame is not None:
            line += (
                f", back to {figures.return_median_px:.2f} px at the median in frame "
                f"{figures.return_frame}"
            )
        console.print(line)
