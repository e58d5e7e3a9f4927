# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab export``: a sensor profile as files of another simulator or tool."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from tyro.conf import Positional


@dataclass(frozen=True)
class Export:
    """Export a sensor profile for another simulator or tool.

    export.json in the folder states what the files carry, what is left out and why, and the error
    of each approximation. docs/exporters.md describes the formats.
    """

    profile: Positional[Path]
    """Profile folder."""
    to: Literal[
        "taccel",
        "tacto",
        "taxim",
        "isaac-lab",
        "gs-sdk",
        "onnx",
        "safetensors",
        "opencv",
        "urdf",
    ]
    """Format.
    taccel: Taccel's fabrication list: JSON, tets as VTK, masks and markers, STL.
    tacto: TACTO's sensor configuration: YAML with camera, gel and lights, STL.
    taxim: Calibration folder of the PyPI package taxim and of TacEx: colour table, background.
    isaac-lab: Isaac Lab's GelSight data folder (TacSL) with its configuration.
    gs-sdk: gs_sdk's device file, background and network from colour to gradients.
    onnx: The networks of colour, normals and force as ONNX graphs.
    safetensors: The same networks as safetensors, with settings and formula.
    opencv: Camera matrix, distortion and pose as OpenCV's YAML.
    urdf: A URDF with meshes, inertias and the frames of gel and camera."""
    out: Path
    """Folder to write; an earlier export there is replaced when everything is done."""
    table: Path | None = None
    """Table fitted to captures, written instead of one distilled from the colour model: taxim only.
    calibrate color leaves it in its report folder as polycalib.npz."""
    json: bool = False
    """Print export.json instead of a summary."""

    def run(self) -> None:
        from taccel_lab.cli.console import notes, print_json, results, working
        from taccel_lab.files.output_folder import require_replaceable
        from taccel_lab.processes.start_warp import start_warp
        from taccel_lab.profile import load_profile

        require_replaceable(self.out)
        profile = load_profile(self.profile)

        from taccel_lab.exporters.export import export_profile

        start_warp()
        with working(notes(), f"exporting {profile.sensor.name} to {self.to}"):
            document = export_profile(profile, self.to, self.out, table=self.table)
        if self.json:
            print_json(document)
        else:
            _print_summary(results(), document, self.out)


def _print_summary(console: Any, document: dict[str, Any], out: Path) -> None:
    from rich.table import Table
    from rich.text import Text

    table = Table(title=f"{document['sensor']} for {document['peer']}", title_justify="left")
    table.add_column("", style="cyan", no_wrap=True)
    table.add_column("block", no_wrap=True)
    table.add_column("what", overflow="fold")
    for heading in ("carries", "left_out"):
        for name, text in document[heading].items():
            table.add_row(heading.replace("_", " "), Text(name), Text(text))
    for name, value in document["approximations"].items():
        table.add_row("figure", Text(name), f"{value:.4g}")
    console.print(table)
    for note in document["notes"]:
        console.print(f"- {note}")
    console.print(f"wrote {len(document['files'])} files to {out}")
