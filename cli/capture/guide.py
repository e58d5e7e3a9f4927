# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab capture guide``: what to capture of a sensor, and why."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

from taccel_lab.errors import InputError


@dataclass(frozen=True)
class CaptureGuide:
    """Print what to capture of a sensor: steps, counts, minutes, equipment, and why.

    Ends with a captures.toml to fill in. Everything takes less than an hour.
    """

    sensor: Positional[str]
    """Sensor of the catalogue (taccel-lab sensors list), or the folder of a profile; flat_pad for
    any other."""
    out: Path | None = None
    """Write the captures.toml to this file as well; an existing file is never overwritten."""
    json: bool = False
    """Print the plan as JSON."""

    def run(self) -> None:
        from dataclasses import asdict

        from rich.table import Table

        from taccel_lab.calibration.capture.guide import capture_plan
        from taccel_lab.cli.console import print_json, results
        from taccel_lab.files.atomic_file import atomic_file

        plan = capture_plan(self.sensor)
        if self.out is not None:
            if self.out.exists():
                raise InputError(f"{self.out} exists; name a file that does not")
            with atomic_file(self.out) as staging:
                staging.write_text(plan.manifest, encoding="utf-8")
        if self.json:
            print_json({**asdict(plan), "minutes": plan.minutes})
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
        if self.out is not None:
            console.print(f"wrote {self.out}")
