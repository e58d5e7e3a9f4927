# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab design``, ``import-gel`` and ``preview``: a sensor from its parameters or a gel from
a file, with labelled mesh, profile, moulds and drawings; and what it would see and feel."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from tyro.conf import Positional

from taccel_lab.errors import InputError
from taccel_lab.report.live_page import PageOptions

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from rich.console import Console

    from taccel_lab.cad.gel_import import FaceSelection
    from taccel_lab.sensors.base import FamilyParameters, SensorFamily
    from taccel_lab.studies.report.preview import DesignPreview

_STAGES = {
    "import": "reading and checking the file",
    "sections": "drawing the sections",
    "cad": "building the solid",
    "mesh": "meshing",
    "quality": "measuring the mesh",
    "pad": "writing the gel",
    "assembly": "joining the parts",
    "mould": "building the moulds",
    "drawing": "drawing",
    "files": "writing files",
}


@dataclass(frozen=True)
class Design:
    """Build a sensor: gel, assembly, moulds, drawings, labelled tet mesh (VTU), profile.

    Sections through the sensor are drawn first, and can be looked at while the rest is built.

    With --page: a page in the browser with sliders of all parameters, which shows what a change
    does and writes nothing until asked. Ctrl-C closes it.
    """

    sensor: Positional[str]
    """Sensor of the catalogue, e.g. gelsight; or the design.toml that a page wrote."""
    out: Path
    """Folder to write; an earlier one is replaced when everything is done. What a page exports
    goes into folders below it."""
    set: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE")] = field(default=())
    """Parameters other than the defaults, e.g. thickness_mm=4 crown_radius_mm=0."""
    mesher: Literal["structured", "tetwild"] = "structured"
    """structured: exact, repeatable, at once. tetwild: follows free-form edges, takes longer."""
    edge_mm: float | None = None
    """Target edge length of the mesh [mm]. Default: 1, or the thickness of a thinner gel, or 0.8
    or 0.6 of that if only then the mesh passes its gate."""
    parts: tuple[Literal["pad", "assembly", "mould", "drawing"], ...] = (
        "pad",
        "assembly",
        "mould",
        "drawing",
    )
    """Files for the workshop: pad as STEP, STL, 3MF and DXF; all parts in place; moulds for casting
    the gel; dimensioned drawings."""
    page: bool = False
    """Open the design page (needs the extra view) in place of writing files."""
    where: tyro.conf.OmitArgPrefixes[PageOptions] = field(default_factory=PageOptions)
    """Where the page is served and how it looks."""
    json: bool = False
    """Print quality of the mesh, files and notes as JSON instead of a table."""

    def run(self) -> None:
        from taccel_lab.cad.parameters import parse_overrides
        from taccel_lab.cli.console import notes, print_json, results, say_first_look
        from taccel_lab.progress import stage_words
        from taccel_lab.sensors.design import design_sensor
        from taccel_lab.sensors.registry import sensor_family
        from taccel_lab.sensors.sensor_picture import write_sections

        console = notes()
        name, overrides = self.sensor, parse_overrides(self.set)
        if name.endswith(".toml"):
            from taccel_lab.viewer.design_export import read_design

            name, stored = read_design(Path(name))
            overrides = {**stored, **overrides}
        family = sensor_family(name)
        if self.page:
            self._serve(family, overrides)
            return

        def first_look(parameters: FamilyParameters, folder: Path) -> Path:
            path = write_sections(family, parameters, folder)
            say_first_look(console, path)
            return path

        with stage_words(console) as say:
            result = design_sensor(
                family,
                overrides,
                self.out,
                self.mesher,
                self.edge_mm,
                parts=self.parts,
                first_look=first_look,
                progress=lambda stage, _, __: say(_STAGES[stage]),
            )
        if self.json:
            figures = {"quality": result.quality.to_json(), "files": result.files}
            print_json({**figures, "seconds": result.seconds, "notes": result.warnings})
            return
        quality = result.quality
        figures = (
            ("nodes", quality.node_count, ",", ""),
            ("tets", quality.tet_count, ",", ""),
            ("smallest dihedral angle", quality.min_dihedral_deg, ".1f", "deg"),
            ("its first percentile", quality.p1_dihedral_deg, ".1f", "deg"),
            ("mean ratio, mean", quality.mean_mean_ratio, ".3f", ""),
            ("volume error", quality.volume_error_percent, ".3f", "%"),
            ("Hausdorff distance to the CAD", quality.hausdorff_mm, ".4f", "mm"),
            ("back plane error", quality.back_plane_error_mm, ".1e", "mm"),
            ("meshing time", result.seconds.get("mesh"), ".2f", "s"),
        )
        _print_figures(f"{family.name}: {result.mesher} mesh", figures, result.files)
        for words in result.warnings:
            results().print(f"note: {words}", soft_wrap=True)

    def _serve(self, family: SensorFamily, overrides: Mapping[str, Any]) -> None:
        from taccel_lab.cli.console import say
        from taccel_lab.files.output_folder import require_replaceable
        from taccel_lab.report.live_page import serve_until_stopped
        from taccel_lab.viewer.design_page import design_page

        # Each kind of file gets a folder of its own there: what else is in it stays.
        require_replaceable(self.out / "everything")
        with design_page(family, overrides, self.out, self.where, say):
            serve_until_stopped()


def _print_figures(
    title: str, figures: Iterable[tuple[str, float | None, str, str]], files: Mapping[str, Path]
) -> None:
    """A table of figures (name, value, format, unit), and the files that were written."""
    from taccel_lab.cli.console import print_table, results

    rows = [
        (name, "-" if value is None else format(value, style), unit)
        for name, value, style, unit in figures
    ]
    print_table(("figure", "value", "unit"), rows, title)
    for kind, path in files.items():
        results().print(f"{kind:>16}  {path}", soft_wrap=True)


_IMPORT_STAGES = _STAGES | {"mesh": "meshing with fTetWild (up to a minute)"}
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
    thickness_mm: float = 0.0
    """Thickness of the gel [mm] in place of the file's: the glued surface moves along the normal,
    contact face and outline stay. [0: as in the file]"""
    edge_mm: float | None = None
    """Target edge length of the mesh [mm]. [2, or the tets of the file where they are good]"""
    like: str = "flat_pad"
    """Sensor of the catalogue whose camera, lights, coating and material the profile takes."""
    set: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE")] = field(default=())
    """Parameters of it other than the defaults, e.g. young_modulus_mpa=0.2 camera_distance_mm=25;
    ``taccel-lab sensors show`` lists them. Not those of its gel, which the file gives."""
    parts: tuple[Literal["pad", "mould", "drawing"], ...] = ("pad", "mould", "drawing")
    """Files for the workshop; --parts alone for none."""
    tolerance_mm: float = 0.05
    """Largest distance of moulds and drawings from the file's triangles, where these are more than
    1,000 and are simplified [mm]."""
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
                tolerance_mm=self.tolerance_mm,
                progress=lambda stage, _, __: say(_IMPORT_STAGES[stage]),
            )
        if self.json:
            figures = {"quality": result.quality.to_json(), "files": result.files}
            figures |= {"seconds": result.seconds, "assumed": result.assumed}
            print_json({**figures, "workshop": result.deviation})
            return
        quality = result.quality
        figures = (
            *((f"{name} area", a, ".1f", "mm^2") for name, a in quality.region_areas_mm2.items()),
            ("least thickness", result.gel.min_thickness_mm, ".3f", "mm"),
            ("nodes", quality.node_count, ",", ""),
            ("tets", quality.tet_count, ",", ""),
            ("smallest dihedral angle", quality.min_dihedral_deg, ".1f", "deg"),
            ("volume error", quality.volume_error_percent, ".3f", "%"),
            ("Hausdorff distance of the mesh", quality.hausdorff_mm, ".4f", "mm"),
            ("Hausdorff distance of moulds", result.deviation.get("hausdorff_mm"), ".4f", "mm"),
        )
        _print_figures(f"{result.gel.name}: imported gel", figures, result.files)
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


@dataclass(frozen=True)
class Preview:
    """Show a design before it is built: camera picture, photometric figures, stiffness.

    The picture comes from the family's camera, lights and coating, ray-cast against the gel; the
    presses are simulated. Sections through the sensor are drawn first, and can be looked at while
    the rest is computed. One design in seconds; many are a study (taccel-lab study).

    Example: taccel-lab preview gelsight_mini --set thickness_mm=3 --out out/thin
    """

    sensor: Positional[str]
    """Sensor of the catalogue, e.g. gelsight_mini, or the folder of a profile, such as that of
    taccel-lab import-gel."""
    out: Path
    """Folder to write; an earlier one is replaced when everything is done."""
    set: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE")] = field(default=())
    """Parameters other than the defaults, e.g. thickness_mm=3 marker_pitch_mm=1.5."""
    presses: tuple[str, ...] = ("sphere",)
    """Standard presses to simulate (taccel-lab study --list-presses); the picture shows the
    first. Each takes some seconds; give --presses without a name for none."""
    size_px: int = 640
    """Longest side of the pictures."""
    device: str = "cpu"
    """Device of solver and renderer: cpu, cuda:0 or auto."""
    json: bool = False
    """Print the figures as JSON instead of a table."""

    def run(self) -> None:
        from taccel_lab.cad.parameters import parse_overrides
        from taccel_lab.cli.console import notes, print_json, say_first_look
        from taccel_lab.files.output_folder import atomic_directory, require_replaceable
        from taccel_lab.model.launches import require_device
        from taccel_lab.processes.start_warp import first_step, start_warp
        from taccel_lab.progress import stage_words
        from taccel_lab.sensors.registry import sensor_family
        from taccel_lab.sensors.sensor_picture import write_sections
        from taccel_lab.studies.report.preview import preview_design, write_preview

        start_warp()
        require_replaceable(self.out)
        require_device(self.device)
        console = notes()
        family, overrides = sensor_family(self.sensor), parse_overrides(self.set)
        with stage_words(console) as say, atomic_directory(self.out) as folder:
            say("drawing the sections")
            first = write_sections(family, family.parameters(overrides), folder)
            say_first_look(console, first)

            def tell(what: str, done: int, total: int) -> None:
                begins = f"; {first_step()}" if total and not done else ""
                say(f"{what}: {done} of {total} presses done{begins}")

            say("meshing")
            preview = preview_design(
                family,
                overrides,
                presses=self.presses,
                size_px=self.size_px,
                device=self.device,
                progress=tell,
            )
            say("drawing")
            files = {"sections": first, **write_preview(preview, folder)}
        if self.json:
            print_json(preview.to_json())
        else:
            _print_preview(console, preview)
        for kind, path in files.items():
            console.print(f"{kind:>9}  {self.out / path.name}", soft_wrap=True)


def _print_preview(console: Console, preview: DesignPreview) -> None:
    """A table of the figures, and the causes of those that are missing."""
    from rich.text import Text

    from taccel_lab.cli.console import print_table

    figures, causes, rows = preview.result.figures, preview.result.causes, []
    for metric in preview.metrics:
        words = Text(metric.description)
        if metric.name in causes:
            words.append(f"\nmissing: {causes[metric.name]}", style="yellow")
        value = figures.get(metric.name)
        shown = "-" if value is None else f"{value:.4g}"
        rows.append((metric.name, shown, metric.unit, words))
    print_table(("figure", "value", "unit", "meaning"), rows, preview.family.label, console)
    for name in causes:
        if name in figures:
            continue
        console.print(f"{name}: {causes[name]}", style="yellow")
