# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab sensors list`` and ``taccel-lab sensors show``: the catalogue."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from tyro.conf import Positional

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.cad.parameters import Parameter
    from taccel_lab.sensors import FamilyParameters, SensorFamily

_GROUPS = ("gel", "material", "camera", "lights", "coating", "window", "markers", "housing")

_COLUMNS = {
    "pad": "pad",
    "size_mm": "size [mm]",
    "image_px": "image [px]",
    "mm_per_px": "mm/px",
    "young_modulus_mpa": "E [MPa]",
    "markers": "markers",
}


@dataclass(frozen=True)
class SensorsList:
    """List the sensors of the catalogue, those of installed packages too."""

    json: bool = False
    """Print JSON instead of a table."""

    def run(self) -> None:
        from rich.box import SIMPLE
        from rich.table import Table
        from rich.text import Text

        from taccel_lab.cli.console import print_json, results
        from taccel_lab.sensors.derived import catalogue_row
        from taccel_lab.sensors.registry import catalogue

        known = catalogue()
        rows = {name: catalogue_row(family) for name, family in known.families.items()}
        if self.json:
            broken = {
                name: {"package": item.package, "reason": item.reason}
                for name, item in known.broken.items()
            }
            print_json({"sensors": rows, "broken": broken})
            return
        table = Table(box=SIMPLE, pad_edge=False)
        for heading in ("sensor", *_COLUMNS.values()):
            table.add_column(heading)
        for name, row in rows.items():
            cells = (Text(row[key]) for key in _COLUMNS)
            table.add_row(Text(name, style="cyan"), *cells)
        table.columns[0].no_wrap = True
        console = results()
        console.print(table)
        for name, item in known.broken.items():
            text = Text(f"broken: {name} of the package {item.package}: {item.reason}", style="red")
            console.print(text, soft_wrap=True)


@dataclass(frozen=True)
class SensorsShow:
    """Show a sensor: what its parameters make, and their defaults, bounds and sources."""

    sensor: Positional[str]
    """Sensor of the catalogue, e.g. gelsight_mini, or the folder of a profile."""
    set: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE")] = field(default=())
    """Parameters other than the defaults, e.g. thickness_mm=3 window_thickness_mm=4."""
    json: bool = False
    """Print JSON instead of tables."""
    picture: Path | None = None
    """Draw the sensor to scale into this PNG file: two sections and the view from the front."""

    def run(self) -> None:
        from taccel_lab.cad.parameters import parse_overrides
        from taccel_lab.cli.console import print_json, results
        from taccel_lab.sensors.derived import describe_sensor
        from taccel_lab.sensors.registry import sensor_family

        family = sensor_family(self.sensor)
        parameters = family.parameters(parse_overrides(self.set))
        if self.picture is not None:
            _draw(family, parameters, self.picture)
        if self.json:
            print_json(
                {
                    "sensor": family.name,
                    "title": family.title,
                    "parameters": parameters.describe(),
                    **describe_sensor(parameters),
                    "references": list(family.references),
                }
            )
            return
        console = results()
        _print_sensor(console, family, parameters)
        if self.picture is not None:
            console.print(f"wrote {self.picture}")


def _draw(family: SensorFamily, parameters: FamilyParameters, path: Path) -> None:
    from taccel_lab.errors import InputError
    from taccel_lab.report.style import save_figure
    from taccel_lab.sensors.sensor_picture import draw_sensor

    if path.suffix.lower() != ".png":
        raise InputError(f"--picture {path} must end in .png")
    save_figure(draw_sensor(family, parameters), path)


def _print_sensor(console: Console, family: SensorFamily, parameters: FamilyParameters) -> None:
    from rich.table import Table
    from rich.text import Text

    from taccel_lab.sensors.derived import derived_figures, figure_text

    console.print(Text(family.title, style="bold"))
    figures = Table("figure", "value", title="derived", title_justify="left")
    for name, (value, unit) in derived_figures(parameters).items():
        figures.add_row(Text(name, style="cyan"), Text(figure_text(value, unit)))
    console.print(figures)
    specs, values = parameters.parameters(), parameters.values()
    for group in _groups(specs):
        table = Table(
            "parameter", "value", "allowed", "meaning and source", title=group, show_lines=True
        )
        table.title_justify = "left"
        for name, spec in specs.items():
            if (spec.group or "gel") == group:
                table.add_row(*_cells(spec, values[name]))
        table.columns[0].no_wrap = True
        console.print(table)
    for reference in family.references:
        console.print(Text(f"- {reference}"))


def _groups(specs: dict[str, Parameter]) -> list[str]:
    """Groups that occur, the known ones first."""
    found = {spec.group or "gel" for spec in specs.values()}
    return [g for g in _GROUPS if g in found] + sorted(found - set(_GROUPS))


def _cells(spec: Parameter, value: Any) -> tuple[Any, ...]:
    from rich.text import Text

    meaning = Text(spec.description)
    shown, default = (
        ",".join(map(str, one)) if isinstance(one, (tuple, list)) else str(one)
        for one in (value, spec.default)
    )
    source = spec.source if shown == default else f"set; the default is {default}"
    meaning.append(f"\n{source}", style="dim")
    return Text(spec.name, style="cyan"), Text(shown), Text(spec.allowed()), meaning
