# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab capture import``: captures of another layout become a capture folder."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

from taccel_lab.calibration.import_options import ImportOptions


@dataclass(frozen=True)
class CaptureImport(ImportOptions):
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
    json: bool = False
    """Print what was written as JSON."""

    def run(self) -> None:
        from taccel_lab.calibration.capture.importers import (
            AUTO,
            detect_layout,
            import_folders,
        )
        from taccel_lab.cli.console import notes, print_json, results, working
        from taccel_lab.files.output_folder import require_replaceable
        from taccel_lab.sensors import sensor_family

        if self.sensor is not None:
            sensor_family(self.sensor)
        require_replaceable(self.out)
        layout = self.layout if self.layout != AUTO else detect_layout(self.source).name
        console = notes() if self.json else results()
        with working(console, f"importing {self.source} as {layout}"):
            folders = import_folders(self.source, self.out, layout, self)
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
