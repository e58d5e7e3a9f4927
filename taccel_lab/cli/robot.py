# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab robot list`` and ``taccel-lab robot show``: robots that can carry gels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tyro.conf import Positional

if TYPE_CHECKING:
    from taccel_lab.robots import Robot


@dataclass(frozen=True)
class RobotList:
    """List the robots of the catalogue."""

    json: bool = False
    """Print JSON instead of a table."""

    def run(self) -> None:
        from taccel_lab.cli.console import print_json
        from taccel_lab.robots.catalogue import ENTRIES, PACKAGE

        rows = {
            entry.name: {"summary": entry.summary, "from": "taccel-lab" if entry.ours else PACKAGE}
            for entry in ENTRIES
        }
        if self.json:
            print_json(rows)
            return
        _print_table(
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
        from rich.text import Text

        from taccel_lab.cli.console import print_json, results
        from taccel_lab.robots.describe import describe_robot

        robot = _robot_of(self.robot, packages=dict(self.package), as_drawn=self.as_drawn)
        shown = describe_robot(robot)
        if self.picture is not None:
            _draw(robot, self.picture)
        if self.json:
            print_json(shown)
            return
        console = results()
        coordinates = len(shown["coordinates"])
        head = f"{shown['name']}: {coordinates} coordinates, base {shown['base']}"
        console.print(Text(head), soft_wrap=True)
        _print_table(
            ("joint", "kind", "parent", "child", "limits", "effort", "mimics"),
            [_joint_row(name, joint) for name, joint in shown["joints"].items()],
        )
        _print_table(
            ("link", "mass [kg]", "shapes"),
            [
                (name, _number(link["mass_kg"]), ", ".join(link["shapes"]))
                for name, link in shown["links"].items()
            ],
        )
        for sentence in shown["refused"]:
            console.print(Text(f"rejected: {sentence}", style="yellow"), soft_wrap=True)
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


def _draw(robot: Robot, path: Path) -> None:
    from taccel_lab.errors import InputError
    from taccel_lab.robots.describe import draw_robot

    if path.suffix.lower() != ".png":
        raise InputError(f"--picture {path} must end in .png")
    draw_robot(robot, robot.rest_q, path)


def _joint_row(name: str, joint: dict[str, Any]) -> tuple[str, ...]:
    low, high = joint["limits"]
    limits = "" if low is None or high is None else f"{low:.4g} to {high:.4g} {joint['unit']}"
    effort = _number(joint["max_effort"])
    return (
        name, joint["kind"], joint["parent"], joint["child"], limits, effort, joint["mimics"] or "",
    )  # fmt: skip


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.4g}"


def _print_table(headings: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    from rich.box import SIMPLE
    from rich.table import Table
    from rich.text import Text

    from taccel_lab.cli.console import results

    table = Table(box=SIMPLE, pad_edge=False)
    for heading in headings:
        table.add_column(heading, overflow="fold")
    for first, *others in rows:
        table.add_row(Text(first, style="cyan"), *map(Text, others))
    results().print(table)
