# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab import-gel``: a gel from a file as labelled mesh, profile, moulds and drawing."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from tyro.conf import Positional

from taccel_lab.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.cad.gel_import import FaceSelection
    from taccel_lab.sensors.imported import ImportResult

_STAGES = {
    "import": "reading and checking the file",
    "mesh": "meshing with fTetWild (up to a minute)",
    "quality": "measuring the mesh",
    "pad": "writing the gel",
    "mould": "building the moulds",
    "drawing": "drawing",
    "files": "writing files",
}
_SELECTOR = tyro.conf.arg(metavar="SELECTOR")


@dataclass(frozen=True)
class ImportGel:
    """Import your own gel from STEP, STL, OBJ, 3MF, .msh or .vtu: a profile, its mesh, its moulds.

    Without selectors contact, bond and window are those of the file's names, or proposed. A
    selector is name:NAME, color:RRGGBB, plane:-z (the outermost plane facing that way),
    normal:+z or normal:+z@45 (facing within that angle), index:3,5-8; several are joined. Faces
    that nothing selects are sides. Without --out the faces of the file are listed.
    """

    gel: Positional[Path]
    """File with one body, or several of which --body names one."""
    out: Path | None = None
    """Folder to write; an earlier one is replaced when everything is done."""
    picture: Path | None = None
    """Picture (.png) to write, without --out, of the part with the numbers of its faces. With it,
    the folder has one."""
    select: Path | None = None
    """TOML file with the options below as keys (contact, bond, window, normal, ...)."""
    contact: Annotated[tuple[str, ...], _SELECTOR] = field(default=())
    """Touched faces. [name:contact, or those within 60 degrees of the normal]"""
    bond: Annotated[tuple[str, ...], _SELECTOR] = field(default=())
    """Glued faces. [name:bond, or the largest plane side]"""
    window: Annotated[tuple[str, ...], _SELECTOR] = field(default=())
    """Glued faces that the camera looks through, or rect:18x14 to split off. [name:window,
    or a part of the bond]"""
    normal: str = ""
    """Direction of the file that points out of the gel. [away from a plane bond, or +z]"""
    right: str = ""
    """Direction of the file that becomes the gel's x. [+x, or +y for a normal along x]"""
    origin: Literal["", "center", "file"] = ""
    """center: middle of the gel in plan, at its apex. file: keep the file's origin. [center]"""
    body: str = ""
    """Name of the solid in a file with several, or its number there, from 1."""
    unit: Literal["", "mm", "cm", "m", "um", "in"] = ""
    """Unit of the numbers, when the file declares none or a wrong one. [mm]"""
    edge_mm: float | None = None
    """Target edge length of the mesh [mm]. [2, or the tets of the file where they are good]"""
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
        from taccel_lab.cad.gel_import import FaceSelection
        from taccel_lab.cad.parameters import parse_overrides
        from taccel_lab.cli.console import notes, print_json, results
        from taccel_lab.processes.start_warp import start_warp
        from taccel_lab.progress import stage_words
        from taccel_lab.sensors.imported import family_like, import_design

        start_warp()
        console = results()
        given = {name: getattr(self, name) for name in FaceSelection.model_fields}
        stated = FaceSelection.from_toml(self.select).model_dump(exclude_unset=True)
        flags = {name: value for name, value in given.items() if value}
        selection = FaceSelection(**(stated | flags))
        overrides = parse_overrides(self.set)
        family_like(self.like, overrides)
        if self.out is None:
            self._show(console, selection)
            return
        if self.picture is not None:
            raise InputError("--picture goes without --out, whose folder has faces.png")
        with stage_words(notes()) as say:
            result = import_design(
                self.gel,
                selection,
                self.out,
                self.edge_mm,
                like=self.like,
                overrides=overrides,
                parts=self.parts,
                progress=lambda stage, _, __: say(_STAGES[stage]),
            )
        if self.json:
            figures = {"quality": result.quality.to_json(), "files": result.files}
            print_json({**figures, "seconds": result.seconds, "assumed": result.assumed})
            return
        _print_result(console, result)
        for name, text in result.assumed.items():
            said = "assumed " if name in FaceSelection.model_fields else ""
            console.print(f"{said}{name}: {text}", soft_wrap=True)

    def _show(self, console: Console, selection: FaceSelection) -> None:
        """The faces, and what would be contact, bond and window."""
        from taccel_lab.cad.gel_import import listing, part_faces, propose
        from taccel_lab.cli.console import print_json
        from taccel_lab.geometry import Region

        faces = part_faces(self.gel, selection.body, selection.unit)
        labels, why = propose(faces, selection)
        if self.picture is not None:
            from taccel_lab.cad.preview import write_faces
            from taccel_lab.files.atomic_file import atomic_file

            regions = [Region.SIDE] * len(faces.table) if labels is None else labels.regions
            outline = None if labels is None else labels.outline
            with atomic_file(self.picture) as staging:
                write_faces(faces, regions, outline, staging, title=self.gel.name)
        if self.json:
            print_json([vars(face) for face in faces.table])
            return
        console.print(listing(faces.table, most=len(faces.table)), soft_wrap=True)
        if labels is None:
            console.print(f"proposed: nothing, {why}", soft_wrap=True)
            return
        for name in ("contact", "bond", "window", "normal"):
            chosen = getattr(labels.selection, name)
            words = chosen if isinstance(chosen, str) else " ".join(chosen)
            console.print(f"--{name} {words}", soft_wrap=True)


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
