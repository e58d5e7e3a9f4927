# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab import-step``: a gel from a STEP file as labelled mesh, moulds and drawing."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from tyro.conf import Positional

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.sensors.imported import ImportResult

_STAGES = {
    "import": "reading and checking the STEP file",
    "mesh": "meshing with fTetWild (up to a minute)",
    "quality": "measuring the mesh",
    "pad": "writing the gel",
    "mould": "building the moulds",
    "drawing": "drawing",
    "files": "writing files",
}
_SELECTOR = tyro.conf.arg(metavar="SELECTOR")


@dataclass(frozen=True)
class ImportStep:
    """Import your own gel from STEP: select its faces, check it, mesh it, make its moulds.

    A selector is name:NAME, color:RRGGBB, plane:-z (the outermost plane facing that way),
    normal:+z or normal:+z@45 (facing within that angle), index:3,5-8; several are joined. Faces
    that nothing selects are sides. Without --out the faces of the file are listed.
    """

    step: Positional[Path]
    """STEP file with one solid, or several of which --body names one."""
    out: Path | None = None
    """Folder to write; an earlier one is replaced when everything is done."""
    select: Path | None = None
    """TOML file with the options below as keys (contact, bond, window, normal, ...)."""
    contact: Annotated[tuple[str, ...], _SELECTOR] = field(default=())
    """Faces that are touched. [name:contact]"""
    bond: Annotated[tuple[str, ...], _SELECTOR] = field(default=())
    """Faces that are glued. [name:bond]"""
    window: Annotated[tuple[str, ...], _SELECTOR] = field(default=())
    """Glued faces that the camera looks through, or rect:18x14 to split off. [name:window]"""
    normal: str = ""
    """Direction of the file that points out of the gel. [+z]"""
    right: str = ""
    """Direction of the file that becomes the gel's x. [+x, or +y for a normal along x]"""
    origin: Literal["", "center", "file"] = ""
    """center: middle of the gel in plan, at its apex. file: keep the file's origin. [center]"""
    body: str = ""
    """Name of the solid in a file with several, or its number there, from 1."""
    unit: Literal["", "mm", "cm", "m", "um", "in"] = ""
    """Unit of the numbers, when the file declares a wrong one."""
    edge_mm: float = 2.0
    """Wanted edge length of the mesh [mm]."""
    like: str = "flat_pad"
    """Sensor of the catalogue whose camera, lights, coating and material the profile takes."""
    set: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE")] = field(default=())
    """Parameters of it other than the defaults, e.g. young_modulus_mpa=0.2 camera_distance_mm=25;
    ``taccel-lab sensors show`` lists them. Not those of its gel, which the file gives."""
    parts: tuple[Literal["pad", "mould", "drawing"], ...] = ("pad", "mould", "drawing")
    """Files for the workshop."""
    json: bool = False
    """Print the faces, or the quality of the mesh and the files, as JSON instead of tables."""

    def run(self) -> None:
        from taccel_lab.cad.parameters import parse_overrides
        from taccel_lab.cad.step_import import FaceSelection, list_faces, listing
        from taccel_lab.cli.console import notes, print_json, results
        from taccel_lab.progress import stage_words
        from taccel_lab.sensors.imported import import_design

        console = results()
        if self.out is None:
            table = list_faces(self.step, self.body)
            if self.json:
                print_json([vars(face) for face in table])
                return
            text = listing(table, most=len(table))
            console.print(text, soft_wrap=True)
            return
        given = {name: getattr(self, name) for name in FaceSelection.model_fields}
        stated = FaceSelection.from_toml(self.select).model_dump(exclude_unset=True)
        flags = {name: value for name, value in given.items() if value}
        selection = FaceSelection(**(stated | flags))
        with stage_words(notes()) as say:
            result = import_design(
                self.step,
                selection,
                self.out,
                self.edge_mm,
                like=self.like,
                overrides=parse_overrides(self.set),
                parts=self.parts,
                progress=lambda stage, _, __: say(_STAGES[stage]),
            )
        assumed = selection.assumed()
        if self.json:
            figures = {"quality": result.quality.to_json(), "files": result.files}
            print_json({**figures, "seconds": result.seconds, "assumed": assumed})
            return
        _print_result(console, result)
        for name, text in assumed.items():
            console.print(f"assumed {name}: {text}")


def _print_result(console: Console, result: ImportResult) -> None:
    from rich.table import Table

    table = Table(title=f"{result.gel.name}: imported gel", title_justify="left")
    table.add_column("figure", style="cyan")
    table.add_column("value", justify="right")
    table.add_column("unit")
    quality = result.quality
    for name, area in quality.region_areas_mm2.items():
        table.add_row(f"{name} area", f"{area:.1f}", "mm^2")
    table.add_row("least thickness", f"{result.gel.min_thickness_mm:.3f}", "mm")
    table.add_row("nodes", f"{quality.node_count:,}", "")
    table.add_row("tets", f"{quality.tet_count:,}", "")
    table.add_row("smallest dihedral angle", f"{quality.min_dihedral_deg:.1f}", "deg")
    table.add_row("volume error", f"{quality.volume_error_percent:.3f}", "%")
    table.add_row("Hausdorff distance to the CAD", f"{quality.hausdorff_mm:.4f}", "mm")
    console.print(table)
    for kind, path in result.files.items():
        console.print(f"{kind:>12}  {path}", soft_wrap=True)
