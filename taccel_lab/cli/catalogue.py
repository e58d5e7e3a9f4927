# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab sensors`` and ``taccel-lab robot``: what the catalogues have, listed and shown."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from tyro.conf import Positional

from taccel_lab.errors import InputError

if TYPE_CHECKING:
    from taccel_lab.cad.parameters import Parameter
    from taccel_lab.robots import Robot
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
        from taccel_lab.cli.console import print_json, print_table, results
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
        print_table(
            ("sensor", *_COLUMNS.values()),
            [(name, *(row[key] for key in _COLUMNS)) for name, row in rows.items()],
        )
        for name, item in known.broken.items():
            words = f"broken: {name} of the package {item.package}: {item.reason}"
            results().print(words, style="red", soft_wrap=True)


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
            from taccel_lab.report.style import save_figure
            from taccel_lab.sensors.sensor_picture import draw_sensor

            _require_png(self.picture)
            save_figure(draw_sensor(family, parameters), self.picture)
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
        _print_sensor(family, parameters)
        if self.picture is not None:
            results().print(f"wrote {self.picture}")


def _require_png(path: Path) -> None:
    if path.suffix.lower() != ".png":
        raise InputError(f"--picture {path} must end in .png")


def _print_sensor(family: SensorFamily, parameters: FamilyParameters) -> None:
    from taccel_lab.cli.console import print_table, results
    from taccel_lab.sensors.derived import derived_figures, figure_text

    results().print(family.title, style="bold")
    figures = [
        (name, figure_text(value, unit))
        for name, (value, unit) in derived_figures(parameters).items()
    ]
    print_table(("figure", "value"), figures, "derived")
    specs, values = parameters.parameters(), parameters.values()
    found = {spec.group or "gel" for spec in specs.values()}
    for group in [g for g in _GROUPS if g in found] + sorted(found - set(_GROUPS)):
        rows = [
            _cells(spec, values[name])
            for name, spec in specs.items()
            if (spec.group or "gel") == group
        ]
        print_table(("parameter", "value", "allowed", "meaning and source"), rows, group)
    for reference in family.references:
        results().print(f"- {reference}")


def _cells(spec: Parameter, value: Any) -> tuple[Any, ...]:
    from rich.text import Text

    meaning = Text(spec.description)
    shown, default = (
        ",".join(map(str, one)) if isinstance(one, (tuple, list)) else str(one)
        for one in (value, spec.default)
    )
    source = spec.source if shown == default else f"set; the default is {default}"
    meaning.append(f"\n{source}", style="dim")
    return spec.name, shown, spec.allowed(), meaning


@dataclass(frozen=True)
class RobotList:
    """List the robots of the catalogue."""

    json: bool = False
    """Print JSON instead of a table."""

    def run(self) -> None:
        from taccel_lab.cli.console import print_json, print_table
        from taccel_lab.robots.catalogue import ENTRIES, PACKAGE

        rows = {
            entry.name: {"summary": entry.summary, "from": "taccel-lab" if entry.ours else PACKAGE}
            for entry in ENTRIES
        }
        if self.json:
            print_json(rows)
            return
        print_table(
            ("robot", "what", "from"), [(name, *row.values()) for name, row in rows.items()]
        )


@dataclass(frozen=True)
class RobotShow:
    """Show a robot: joints with limits, links with masses and shapes, and what is rejected."""

    robot: Positional[str]
    """A URDF, MJCF or USD file (the last two by newton), or a robot of the catalogue, e.g.
    parallel_gripper."""
    package: tuple[tuple[str, Path], ...] = ()
    """Name and folder of a package in a URDF's package://NAME/... paths. Packages beside or
    above the file are found without."""
    as_drawn: bool = False
    """Ignore up_axis of Collada meshes, as RViz does."""
    json: bool = False
    """Print JSON instead of tables."""
    picture: Path | None = None
    """Draw the shapes of its links into this PNG file, coordinates as close to 0 as the limits
    allow."""

    def run(self) -> None:
        from taccel_lab.cli.console import print_json, print_table, results
        from taccel_lab.robots.describe import describe_robot, draw_robot

        robot = _robot_of(self.robot, packages=dict(self.package), as_drawn=self.as_drawn)
        shown = describe_robot(robot)
        if self.picture is not None:
            _require_png(self.picture)
            draw_robot(robot, robot.rest_q, self.picture)
        if self.json:
            print_json(shown)
            return
        console = results()
        coordinates = len(shown["coordinates"])
        head = f"{shown['name']}: {coordinates} coordinates, base {shown['base']}"
        console.print(head, soft_wrap=True)
        print_table(
            ("joint", "kind", "parent", "child", "limits", "effort", "mimics"),
            [_joint_row(name, joint) for name, joint in shown["joints"].items()],
        )
        print_table(
            ("link", "mass [kg]", "shapes"),
            [
                (name, _number(link["mass_kg"]), ", ".join(link["shapes"]))
                for name, link in shown["links"].items()
            ],
        )
        for sentence in shown["refused"]:
            console.print(f"rejected: {sentence}", style="yellow", soft_wrap=True)
        if self.picture is not None:
            console.print(f"wrote {self.picture}")


def _robot_of(text: str, **options: Any) -> Robot:
    from taccel_lab.files.xml_file import read_xml
    from taccel_lab.robots.describe import robot_of

    path = Path(text)
    kind = path.suffix.lower()
    is_mjcf = kind == ".mjcf" or (
        kind == ".xml" and path.is_file() and read_xml(path, "an XML file").tag == "mujoco"
    )
    if is_mjcf or kind in (".usd", ".usda", ".usdc", ".usdz"):
        from taccel_lab.newton_bridge import load_mjcf, load_usd

        return load_mjcf(path) if is_mjcf else load_usd(path)
    return robot_of(text, **options)


def _joint_row(name: str, joint: dict[str, Any]) -> tuple[str, ...]:
    low, high = joint["limits"]
    limits = "" if low is None or high is None else f"{low:.4g} to {high:.4g} {joint['unit']}"
    effort = _number(joint["max_effort"])
    return (
        name, joint["kind"], joint["parent"], joint["child"], limits, effort, joint["mimics"] or "",
    )  # fmt: skip


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.4g}"
