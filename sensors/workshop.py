# SPDX-License-Identifier: Apache-2.0
"""Files for the workshop: pad, assembly, moulds and drawings of one design; its parts together."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taccel_lab.cad.mesh.quality import GateResult, MeshQuality
from taccel_lab.files.atomic_file import content_id, write_json
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.sensors.base import FamilyParameters, all_optics
from taccel_lab.version import __version__

if TYPE_CHECKING:
    from taccel_lab.cad.assembly import Assembly
    from taccel_lab.cad.drawing.title import Issue
    from taccel_lab.cad.mesh.surface import LabelledSurface
    from taccel_lab.cad.parts.part import LabelledSolid, Part

WORKSHOP_PARTS = ("pad", "assembly", "mould", "drawing")
"""What can be left out of a design's folder."""


@dataclass
class Workshop:
    """One gel and what is made around it; every method writes files and notes their names."""

    name: str
    folder: Path
    solid: LabelledSolid | None
    """None of a gel of triangles of which nobody asks for files; only its mesh is written."""
    surface: LabelledSurface
    layers: Mapping[str, LabelledSolid]
    """The gel's layers by name, core first."""
    assembly: Assembly | None = None
    table: Mapping[str, tuple[float | int | str, str]] = field(default_factory=dict)
    """Name -> (value, unit) for the table of a drawing."""
    stiffness: str = ""
    """How hard the gel is, in words for its drawing."""
    faceted: str = ""
    """How the solid stands for triangles of a file, in words; empty for an exact one."""
    facets_mm: float = 0.0
    """How far its facets may lie off the faces that they stand for [mm]."""
    issue: Issue | None = None
    """Revision and date on drawings."""
    files: dict[str, str] = field(default_factory=dict)
    """Names of the files written, by kind."""
    warnings: list[str] = field(default_factory=list)
    """What a maker should know, in words."""

    @property
    def gel(self) -> LabelledSolid:
        """The solid that its files are made of."""
        assert self.solid is not None  # Nobody asks for files of such a gel.
        return self.solid

    def path(self, kind: str, name: str) -> Path:
        """Where the file of a kind goes; notes its name."""
        self.files[kind] = name
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def write(self, kind: str) -> None:
        """Write the files of one of ``WORKSHOP_PARTS``."""
        getattr(self, f"write_{kind}")()

    def write_pad(self) -> None:
        """The gel as STEP with named faces, STL, 3MF (a body each layer) and DXF."""
        from taccel_lab.cad.export import write_3mf, write_dxf, write_step, write_stl
        from taccel_lab.cad.parts.part import gel_part

        write_step(self.gel, self.path("step", "pad.step"), name=f"{self.name}_gel_pad")
        write_stl(self.surface, self.path("stl", "pad.stl"))
        whole = [gel_part(self.gel, f"{self.name}_gel_pad")]
        write_3mf(self._layer_parts() or whole, self.path("3mf", "pad.3mf"))
        seat = [] if self.assembly is None else [p for p in self.assembly.parts if p.made_beside]
        write_dxf(self.gel, self.path("dxf", "pad.dxf"), others=seat)

    def _layer_parts(self) -> list[Part]:
        from taccel_lab.cad.parts.part import gel_part

        if len(self.layers) < 2:
            return []
        return [gel_part(layer, f"{self.name}_{name}") for name, layer in self.layers.items()]

    def write_assembly(self) -> None:
        """All parts in their places as one STEP, rigid ones also by themselves, and a report."""
        from taccel_lab.cad.assembly import require_no_overlap
        from taccel_lab.cad.export import write_assembly_step, write_part_step, write_part_stl

        assembly = self.assembly
        assert assembly is not None  # It is built where its files are wanted.
        clearances = assembly.clearances()
        self.warnings += [*assembly.notes, *require_no_overlap(clearances)]
        write_assembly_step(
            assembly.parts, self.path("assembly", "assembly.step"), name=assembly.name
        )
        write_json(self.path("assembly_report", "assembly.json"), assembly.to_json(clearances))
        for part in assembly.parts:
            if not part.made_beside:
                continue
            write_part_step(part, self.path(f"{part.name}_step", f"parts/{part.name}.step"))
            write_part_stl(part, self.path(f"{part.name}_stl", f"parts/{part.name}.stl"))

    def write_mould(self) -> None:
        """One mould a casting step: STEP of cavity and lid, 3MF of both, a report of the checks."""
        from taccel_lab.cad.export import write_3mf, write_part_step
        from taccel_lab.cad.moulds import casting_moulds

        report: dict[str, Any] = {}
        for mould, checked in casting_moulds(self.gel, self.layers, self.facets_mm):
            for part in mould.parts:
                write_part_step(part, self.path(part.name, f"{part.name}.step"))
            write_3mf(mould.parts, self.path(f"{mould.name}_3mf", f"{mould.name}.3mf"))
            report[mould.name] = {
                "options": mould.options.describe(),
                "gates": [vars(gate) for gate in mould.gates],
                **asdict(checked),
            }
        write_json(self.path("mould_report", "mould.json"), report)

    def write_drawing(self) -> None:
        """The dimensioned drawing of the gel, and the assembly in section."""
        from taccel_lab.cad.drawing.assembly_drawing import assembly_drawing
        from taccel_lab.cad.drawing.pad_drawing import pad_drawing

        layers = dict(self.layers) if len(self.layers) > 1 else {}
        material = "silicone" + (f" ({' and '.join(self.layers)})" if layers else "")
        material += f", {self.stiffness}" if self.stiffness else ""
        pad_drawing(
            self.gel,
            title=f"{self.name}: gel",
            material=material,
            parameters=self.table,
            layers=layers,
            faceted=self.faceted,
            issue=self.issue,
        ).save(self.path("drawing", "drawing.svg"), self.path("drawing_pdf", "drawing.pdf"))
        if self.assembly is not None:
            assembly_drawing(
                self.assembly,
                title=f"{self.name}: assembly",
                notes=self.assembly.notes,
                issue=self.issue,
            ).save(self.path("assembly_drawing", "assembly.svg"))

    def write_mesh(self, mesh: TetMesh, mesher: str) -> None:
        """The mesh with its labels and a picture of it."""
        from taccel_lab.cad.preview import write_preview
        from taccel_lab.geometry.vtu import write_mesh_vtu

        write_mesh_vtu(self.path("mesh", "pad.vtu"), mesh)
        title = f"{self.name} ({mesher} mesh)"
        write_preview(mesh, self.path("preview", "preview.png"), title=title)

    def write_quality(
        self,
        quality: MeshQuality,
        passed: GateResult,
        mesher: str,
        edge_mm: float,
        seconds: Mapping[str, float],
    ) -> None:
        """Figures of the mesh, the gate that it passed, and how long each stage took."""
        write_json(
            self.path("quality", "quality.json"),
            {
                "mesher": mesher,
                "edge_mm": edge_mm,
                **quality.to_json(),
                "gate": passed.to_json(),
                "seconds": seconds,
            },
        )


def sensor_parts(
    name: str, parameters: FamilyParameters, gel: LabelledSolid | None = None
) -> Assembly:
    """The assembly of a sensor; ``gel`` is the solid of its pad if it is already at hand.

    Raises InputError when a part cannot be built, naming the bound that is broken.
    """
    from taccel_lab.cad.assembly import sensor_assembly
    from taccel_lab.cad.parts.pad_solid import gel_parts, labelled_solid

    pad, optics = parameters.pad(), parameters.optics()
    gel = gel or labelled_solid(pad)
    return sensor_assembly(
        name,
        gel_parts(pad, gel),
        pad.thickness_mm,
        window=None if optics is None else optics.window,
        housing=parameters.housing(),
        cameras=tuple(design.camera for design in all_optics(parameters)),
        leds=() if optics is None else optics.lights,
        view_mm=_view_mm(gel),
    )


def _view_mm(gel: LabelledSolid) -> tuple[float, float]:
    """Extents of the gel's window face in plan [mm]."""
    boxes = [face.bounding_box() for face in gel.faces(Region.WINDOW)]
    if not boxes:
        return (0.0, 0.0)
    return (
        max(b.max.X for b in boxes) - min(b.min.X for b in boxes),
        max(b.max.Y for b in boxes) - min(b.min.Y for b in boxes),
    )


def issue_of(content: Any) -> Issue:
    """The issue of a design with this content, today: on the day of ``SOURCE_DATE_EPOCH`` [s since
    1970, UTC] where that is set, as in builds that are to be repeated to the byte."""
    from taccel_lab.cad.drawing.title import Issue

    seconds = float(os.environ.get("SOURCE_DATE_EPOCH") or time.time())
    day = datetime.fromtimestamp(seconds, UTC).date().isoformat()
    return Issue(f"{content_id(content)[:8]}, taccel-lab {__version__}", day)
