# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab sensors list`` and ``taccel-lab sensors show``: the catalogue."""

from __future__ import annotations

from dataclasses import dataclass

from tyro.conf import Positional


@dataclass(frozen=True)
class SensorsList:
    """List the sensor families that can be designed."""

    json: bool = False
    """Print JSON instead of a table."""

    def run(self) -> None:
        from rich.console import Console
        from rich.table import Table
        from rich.text import Text

        from sensors.registry import sensor_families
        from taccel_lab.cli.console import print_json

        families = sensor_families()
        if self.json:
            print_json({name: family.title for name, family in families.items()})
            return
        table = Table("sensor", "what it is")
        for name, family in families.items():
            table.add_row(Text(name, style="cyan"), Text(family.title))
        Console().print(table)


@dataclass(frozen=True)
class SensorsShow:
    """Show a sensor family's parameters: defaults, bounds and where each figure comes from."""

    sensor: Positional[str]
    """Sensor of the catalogue, e.g. gelsight."""
    json: bool = False
    """Print JSON instead of a table."""

    def run(self) -> None:
        from rich.console import Console
        from rich.table import Table
        from rich.text import Text

        from sensors.registry import sensor_family
        from taccel_lab.cli.console import print_json

        family = sensor_family(self.sensor)
        if self.json:
            described = family.parameters().describe()
            print_json(
                {
                    "sensor": family.name,
                    "title": family.title,
                    "parameters": described,
                    "references": list(family.references),
                }
            )
            return
        console = Console()
        table = Table("parameter", "default", "allowed", "meaning and source", show_lines=True)
        for name, spec in family.parameters_type.parameters().items():
            meaning = Text(spec.description)
            meaning.append(f"\n{spec.source}", style="dim")
            table.add_row(
                Text(name, style="cyan"), Text(str(spec.default)), Text(spec.allowed()), meaning
            )
        table.columns[0].no_wrap = True
        console.print(Text(family.title, style="bold"))
        console.print(table)
        for reference in family.references:
            console.print(Text(f"- {reference}"))
