# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab capture rectify``: the distortion of the lens taken out of captures."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

from tyro.conf import Positional


@dataclass(frozen=True)
class CaptureRectify:
    """Rectify every image of a capture folder, so that one scale holds everywhere.

    The maps come from a board on the gel (taccel-lab calibrate camera --maps). Contact circles are
    left out, since they are positions in the raw images; they are found again.
    """

    captures: Positional[Path]
    """Capture folder with captures.toml."""
    maps: Positional[Path]
    """Rectification maps (.npz) of `taccel-lab calibrate camera --maps`."""
    out: Positional[Path]
    """Capture folder to write."""
    json: bool = False
    """Print size, scale and notes as JSON."""

    def run(self) -> None:
        from taccel_lab.calibration.camera.rectification import RectificationMaps, rectify_captures
        from taccel_lab.calibration.capture import load_capture_folder
        from taccel_lab.cli.console import notes, print_json, working
        from taccel_lab.files.output_folder import require_replaceable

        require_replaceable(self.out)
        console = notes()
        folder, maps = load_capture_folder(self.captures), RectificationMaps.load(self.maps)
        with working(console, "rectifying the images"):
            remarks = rectify_captures(folder, maps, self.out)
        for remark in remarks:
            console.print(f"note: {remark}")
        grid = maps.require_grid()
        console.print(
            f"wrote {self.out}: {grid.width_px}x{grid.height_px} px at {grid.mm_per_px_x:.5g} x "
            f"{grid.mm_per_px_y:.5g} mm/px",
        )
        if self.json:
            print_json({"folder": str(self.out), **asdict(grid), "notes": remarks})
