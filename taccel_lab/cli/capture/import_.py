# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab capture import``: captures of another layout become a capture folder."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional


@dataclass(frozen=True)
class CaptureImport:
    """Write captures of another project's layout, or a plain folder, as a capture folder.

    Image files are copied unchanged. Assumptions are printed, and kept in captures.toml and in
    every profile that is calibrated with it. Skipped files are listed with the reason. A source of
    several sensors or sets becomes one folder for each.
    """

    source: Positional[Path]
    """Folder, dataPack.npz or video to read."""
    out: Positional[Path]
    """Capture folder to write."""
    layout: str = "auto"
    """Layout of the source: auto, taxim, 9dtact, gs-sdk, printer, markers or plain, or a script,
    which is run: those of other published sets are in docs/examples/layouts
    (docs/capture_import.md)."""
    sensor: str | None = None
    """Sensor of the catalogue, or a profile folder. Default: that of the layout; flat_pad if
    unknown."""
    unit: str | None = None
    """Serial number or nickname of this particular sensor."""
    radius_mm: float | None = None
    """Radius of the ball of the presses or of the force record [mm]; replaces the layout's."""
    mm_per_px_x: float | None = None
    """Scale along the image's rows [mm/px], if you measured it."""
    mm_per_px_y: float | None = None
    """Scale along the image's columns [mm/px]. Default: that of the rows."""
    background: str | None = None
    """Image of the untouched sensor, or "median" for the median of the presses."""
    edge_mm: float | None = None
    """Length of the edge of edge presses [mm]."""
    board: str | None = None
    """The board of the layout, or that of all images of a plain folder, such as
    chessboard:6x6:2.5. The numbers are inner corners or dots along a row x rows, and their pitch
    in mm if known. Kinds: chessboard, charuco, dots."""
    origin: str | None = None
    """Origin of the captures, kept as provenance. Default: from a README or MANIFEST in the
    source, else unknown."""
    license: str | None = None
    """Licence of the captures, kept as provenance. Default: that of a licence file or README in
    the source, else unknown."""
    json: bool = False
    """Print what was written as JSON."""

    def run(self) -> None:
        from taccel_lab.calibration.capture.importers import (
            AUTO,
            ImportOptions,
            detect_layout,
            import_folders,
        )
        from taccel_lab.cli.console import notes, print_json, results, working
        from taccel_lab.files.output_folder import require_replaceable
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
            origin=self.origin,
            license=self.license,
        )
        require_replaceable(self.out)
        layout = self.layout if self.layout != AUTO else detect_layout(self.source).name
        console = notes() if self.json else results()
        with working(console, f"importing {self.source} as {layout}"):
            folders = import_folders(self.source, self.out, layout, options)
        found = []
        for folder in folders:
            origin = {key: folder.provenance[key] for key in ("source", "license")}
            found.append(
                {
                    "path": str(folder.path),
                    "contents": folder.contents,
                    "assumed": folder.assumed,
                    "notes": list(folder.notes),
                    **origin,
                }
            )
            words = f"wrote {folder.path}: {_in_words(folder.contents)}"
            console.print(words)
            said = [
                *(f"{key}: {text}" for key, text in origin.items()),
                *(f"assumed {name}: {text}" for name, text in folder.assumed.items()),
                *folder.notes,
            ]
            for text in said:
                console.print(f"  {text}")
        for folder in folders:
            console.print(
                f"next: taccel-lab capture check {shlex.quote(str(folder.path))}",
            )
        if self.json:
            print_json({"layout": layout, "folders": found})


def _in_words(contents: dict[str, int]) -> str:
    from taccel_lab.printable import counted

    parts = []
    for key, count in contents.items():
        many = key.replace("_", " ")
        one = many.removesuffix("es") if many.endswith("presses") else many.removesuffix("s")
        if count:
            parts.append(counted(count, one, many))
    return ", ".join(parts) or "nothing that calibrates"
