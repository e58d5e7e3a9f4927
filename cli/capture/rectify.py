# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab capture rectify``: the distortion of the lens taken out of captures."""

from __future__ import annotations

from dataclasses import dataclass
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

    def run(self) -> None:
        from rich.console import Console

        from taccel_lab.calibration.camera.rectification import RectificationMaps
        from taccel_lab.calibration.camera.rectify_captures import rectify_captures
        from taccel_lab.calibration.capture import load_capture_folder
        from taccel_lab.output_folder import require_replaceable

        require_replaceable(self.out)
        console = Console(stderr=True)
        folder, maps = load_capture_folder(self.captures), RectificationMaps.load(self.maps)
        with console.status("rectifying the images"):
            notes = rectify_captures(folder, maps, self.out)
        for note in notes:
            console.print(f"note: {note}", highlight=False)
        grid = maps.require_grid()
        console.print(
            f"wrote {self.out}: {grid.width_px}x{grid.height_px} px at {grid.mm_per_px_x:.5g} x "
            f"{grid.mm_per_px_y:.5g} mm/px",
            highlight=False,
        )
