# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab design``: a sensor as CAD files, moulds, drawings, labelled mesh and profile."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from tyro.conf import Positional

from taccel_lab.report.live_page import PageOptions

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rich.console import Console

    from taccel_lab.sensors.base import FamilyParameters, SensorFamily
    from taccel_lab.sensors.design import DesignResult

_STAGES = {
    "sections": "drawing the sections",
    "cad": "building the solid",
    "mesh": "meshing",
    "quality": "measuring the mesh",
    "pad": "writing the gel pad",
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
        else:
            _print_result(results(), result)

    def _serve(self, family: SensorFamily, overrides: Mapping[str, Any]) -> None:
        from taccel_lab.cli.console import notes
        from taccel_lab.files.output_folder import require_replaceable
        from taccel_lab.report.live_page import serve_until_stopped
        from taccel_lab.viewer.design_page import design_page

        # Each kind of file gets a folder of its own there: what else is in it stays.
        require_replaceable(self.out / "everything")

        def say(text: str) -> None:
            notes().print(text, soft_wrap=True)

        with design_page(family, overrides, self.out, self.where, say):
            serve_until_stopped()


def _print_result(console: Console, result: DesignResult) -> None:
    from rich.table import Table

    quality = result.quality
    table = Table(title=f"{result.family.name}: {result.mesher} mesh", title_justify="left")
    table.add_column("figure", style="cyan")
    table.add_column("value", justify="right")
    table.add_column("unit")
    rows: list[tuple[str, float | int | None, str, str]] = [
        ("nodes", quality.node_count, ",", ""),
        ("tets", quality.tet_count, ",", ""),
        ("smallest dihedral angle", quality.min_dihedral_deg, ".1f", "deg"),
        ("its first percentile", quality.p1_dihedral_deg, ".1f", "deg"),
        ("mean ratio, mean", quality.mean_mean_ratio, ".3f", ""),
        ("volume error", quality.volume_error_percent, ".3f", "%"),
        ("Hausdorff distance to the CAD", quality.hausdorff_mm, ".4f", "mm"),
        ("back plane error", quality.back_plane_error_mm, ".1e", "mm"),
        ("meshing time", result.seconds.get("mesh"), ".2f", "s"),
    ]
    for name, value, style, unit in rows:
        table.add_row(name, "-" if value is None else format(value, style), unit)
    console.print(table)
    for kind, path in result.files.items():
        console.print(f"{kind:>16}  {path}", soft_wrap=True)
    for words in result.warnings:
        console.print(f"note: {words}", soft_wrap=True)
