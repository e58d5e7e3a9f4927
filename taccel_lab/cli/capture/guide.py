# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab capture guide``: what to capture of a sensor, and why."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from taccel_lab.errors import InputError

if TYPE_CHECKING:
    from taccel_lab.calibration.capture.printer import PrinterPlan


@dataclass(frozen=True)
class CaptureGuide:
    """Print what to capture of a sensor: steps, counts, minutes, equipment, and why.

    Ends with a captures.toml to fill in. Everything takes less than an hour.
    """

    sensor: Positional[str]
    """Sensor of the catalogue (taccel-lab sensors list), or the folder of a profile; flat_pad for
    any other."""
    printer: str | None = None
    """Write the ball presses as G-code as well, for a 3D printer that holds the ball: ender3,
    prusa_mk4, or the build volume, such as 220x220x250. Needs --touch and --out."""
    touch: tuple[float, float, float] | None = None
    """X, Y and Z of the printer when the ball just touches the middle of the gel (M114)."""
    out: Path | None = None
    """Write the captures.toml to this file as well; an existing file is never overwritten. With
    --printer: folder for presses.gcode and printer_presses.csv."""
    json: bool = False
    """Print the plan as JSON."""

    def run(self) -> None:
        from dataclasses import asdict

        from rich.table import Table

        from taccel_lab.calibration.capture.guide import capture_plan
        from taccel_lab.calibration.capture.printer import GCODE, PRESSES_TABLE
        from taccel_lab.cli.console import print_json, results
        from taccel_lab.files.atomic_file import atomic_file
        from taccel_lab.files.output_folder import atomic_directory

        plan = capture_plan(self.sensor)
        printer = self._printer()
        if printer is not None and self.out is not None:
            with atomic_directory(self.out) as folder:
                (folder / GCODE).write_text(printer.gcode(), encoding="utf-8")
                (folder / PRESSES_TABLE).write_text(printer.table(), encoding="utf-8")
        elif self.out is not None:
            if self.out.exists():
                raise InputError(f"{self.out} exists; name a file that does not")
            with atomic_file(self.out) as staging:
                staging.write_text(plan.manifest, encoding="utf-8")
        if self.json:
            values = {**asdict(plan), "minutes": plan.minutes}
            if printer is not None:
                values["printer"] = {**asdict(printer), "minutes": printer.minutes}
            print_json(values)
            return
        console = results()
        console.print(f"{plan.title}\n{plan.minutes} minutes in all\n")
        table = Table("step", "for", "count", "min", "equipment")
        for number, step in enumerate(plan.steps, 1):
            name = f"{number} {step.title}" + (" (optional)" if step.optional else "")
            table.add_row(name, step.block, step.count, str(step.minutes), step.equipment)
        console.print(table)
        for number, step in enumerate(plan.steps, 1):
            console.print(f"\n{number} {step.title}", style="bold")
            console.print(step.how)
            console.print(f"Why: {step.why}")
        console.print("\ncaptures.toml to fill in, beside the images:\n")
        console.print(plan.manifest, soft_wrap=True)
        console.print("Then: taccel-lab capture check FOLDER")
        if printer is not None and self.out is not None:
            at = self.out / PRESSES_TABLE
            console.print(
                f"The printer makes {len(printer.presses)} presses in {printer.minutes:.0f} "
                f"minutes; its program says what to do before. Meanwhile:\n"
                f"taccel-lab capture record {self.sensor} --radius-mm {plan.ball_radius_mm:g} "
                f"--scale later --table {at} ...",
                soft_wrap=True,
            )
        if self.out is not None:
            console.print(f"wrote {self.out}")

    def _printer(self) -> PrinterPlan | None:
        from taccel_lab.calibration.capture.printer import parse_printer, printer_plan

        if self.printer is None:
            if self.touch is not None:
                raise InputError("--touch was given without --printer; name the printer as well")
            return None
        bed = parse_printer(self.printer)
        if self.touch is None or self.out is None:
            raise InputError(
                "--printer needs --touch X Y Z and --out, a folder. --touch is what M114 says when "
                "the ball just touches the middle of the gel"
            )
        return printer_plan(self.sensor, bed, self.touch)
