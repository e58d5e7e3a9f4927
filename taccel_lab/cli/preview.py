# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab preview``: see and feel a sensor before it is built."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from tyro.conf import Positional

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.studies.report.preview import DesignPreview


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
            print_preview(console, preview)
        for kind, path in files.items():
            console.print(f"{kind:>9}  {self.out / path.name}", soft_wrap=True)


def print_preview(console: Console, preview: DesignPreview) -> None:
    """A table of the figures, and the causes of those that are missing."""
    from rich.table import Table
    from rich.text import Text

    table = Table("figure", "value", "unit", "meaning", title=preview.family.label)
    table.columns[1].justify = "right"
    for metric in preview.metrics:
        value = preview.result.figures.get(metric.name)
        why = preview.result.causes.get(metric.name, "")
        shown = "-" if value is None else f"{value:.4g}"
        words = Text(metric.description)
        if why:
            words.append(f"\nmissing: {why}", style="yellow")
        table.add_row(Text(metric.name, style="cyan"), shown, metric.unit, words)
    console.print(table)
    for name, cause in preview.result.causes.items():
        if name not in preview.result.figures:
            console.print(Text(f"{name}: {cause}", style="yellow"))
