# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab capture import``: captures of another layout become a capture folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional


@dataclass(frozen=True)
class CaptureImport:
    """Write captures of another project's layout, or a plain folder, as a capture folder.

    Image files are copied unchanged. What had to be assumed is printed, and written as comments at
    the top of captures.toml. A source of several sensors or sets becomes one folder for each.
    """

    source: Positional[Path]
    """Folder, dataPack.npz or video to read."""
    out: Positional[Path]
    """Capture folder to write."""
    layout: str = "auto"
    """Layout of the source: auto, taxim, fots, 9dtact, feats, py3dcal, gs-sdk, cube-edges, rvsathu,
    ruihangao, gelslim, osaka, markers or plain (described in docs/captures.md)."""
    sensor: str | None = None
    """Sensor of the catalogue; that of the layout when left out, flat_pad for an unknown one."""
    unit: str | None = None
    """Serial number or nickname of this particular sensor."""
    radius_mm: float | None = None
    """Radius of the ball of the presses or of the force record [mm]; replaces the layout's."""
    mm_per_px_x: float | None = None
    """Scale along the image's rows [mm/px], where you have measured it."""
    mm_per_px_y: float | None = None
    """Scale along the image's columns [mm/px]; that of the rows when left out."""
    background: str | None = None
    """Image of the untouched sensor, or "median" for the median of the presses."""
    edge_mm: float | None = None
    """Length of the edge of edge presses [mm]."""
    board: str | None = None
    """The images of a plain folder are views of this board, such as chessboard:6x6:2.5 (inner
    corners or dots along a row x rows, and their pitch in mm where it is known; kinds chessboard,
    charuco, dots, pins)."""
    crop: str | None = None
    """Background and presses are framed differently: the part of the presses that the background
    shows, as LEFT,TOP,WIDTHxHEIGHT in pixels, or auto to find which part of one the other shows.
    Both are cut to it; pixels of the presses keep their size."""
    json: bool = False
    """Print what was written as JSON."""

    def run(self) -> None:
        from rich.console import Console

        from taccel_lab.calibration.capture import (
            ImportOptions,
            import_captures,
            load_capture_folder,
        )
        from taccel_lab.calibration.capture.importers import AUTO, detect_layout
        from taccel_lab.cli.console import print_json
        from taccel_lab.output_folder import require_replaceable
        from taccel_lab.sensors import sensor_family

        if self.sensor is not None:
            sensor_family(self.sensor)
        options = ImportOptions(
            sensor=self.sensor,
            unit=self.unit,
            radius_mm=self.radius_mm,
            mm_per_px_x=self.mm_per_px_x,
            mm_per_px_y=self.mm_per_px_y,
            background=self.background,
            edge_mm=self.edge_mm,
            board=self.board,
            crop=self.crop,
        )
        require_replaceable(self.out)
        layout = self.layout if self.layout != AUTO else detect_layout(self.source).name
        console = Console(stderr=self.json)
        with console.status(f"importing {self.source} as {layout}"):
            folders = import_captures(self.source, self.out, layout, options)
        found = []
        for path in folders:
            captures = load_capture_folder(path)
            found.append({"path": str(path), "contents": captures.contents()})
            console.print(f"wrote {path}: {_in_words(captures.contents())}", highlight=False)
            for line in (path / "captures.toml").read_text(encoding="utf-8").splitlines():
                if line.startswith("# "):
                    console.print(f"  note: {line[2:]}", highlight=False, markup=False)
        console.print(f"next: taccel-lab capture check {folders[0]}", highlight=False)
        if self.json:
            print_json({"layout": layout, "folders": found})


def _in_words(contents: dict[str, int]) -> str:
    parts = [f"{count} {name.replace('_', ' ')}" for name, count in contents.items() if count]
    return ", ".join(parts) or "nothing that calibrates"
