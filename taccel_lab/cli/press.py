# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab press``: press a rigid indenter into a sensor's gel and read what it senses."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from taccel_lab.errors import keeping
from taccel_lab.presses.options import PressOptions

if TYPE_CHECKING:
    from taccel_lab.presses.press import Press as PressResult
    from taccel_lab.processes.process_pool import Beside


@dataclass(frozen=True)
class _Files:
    sensor: Positional[str]
    """Profile folder, or a sensor of the catalogue, which has no colour model yet: its image is
    the one that the optical model predicts (predicted.png). Dots of the gel are written to
    markers.csv and drawn in markers.png."""
    out: Path
    """Folder to write; an earlier one is replaced when everything is done. A press that fails
    leaves its finished steps, and the cause in press.json."""


@dataclass(frozen=True)
class PressCommand(PressOptions, _Files):
    """Press an indenter into a gel: height map, normals, image, force and wrench, mesh, figures.

    Lengths are in mm in the gel frame: x right and y down in the image, z out of the gel; the
    origin is the middle of the contact face. The scene is drawn first (scene.png), before the press
    is computed. Example: taccel-lab press gelsight --indenter sphere:2.0 --depth-mm 0.8 --shear-mm
    0.3 0 --out out/press
    """

    json: bool = False
    """Print the figures as JSON instead of a table."""

    def run(self) -> None:
        from taccel_lab.files.output_folder import require_replaceable
        from taccel_lab.processes.process_pool import Beside
        from taccel_lab.report.style import new_figure

        require_replaceable(self.out)
        kept: list[str] = []
        with Beside() as beside, keeping(lambda: "".join(kept[-1:])):
            # Loads what draws, which another process does while this one loads the solver.
            beside.call(new_figure, 1, 1)
            self._press(beside, kept)

    def _press(self, beside: Beside, kept: list[str]) -> None:
        """Press, and write; the last of ``kept`` says what stays if it ends now."""
        from taccel_lab.api.press import planned_press
        from taccel_lab.cli.console import notes, print_json, print_table, say, say_first_look
        from taccel_lab.files.output_folder import atomic_directory
        from taccel_lab.presses.page import press_rows, write_press_page
        from taccel_lab.presses.run import step_progress

        console = notes()
        run = planned_press(self.sensor, self)
        told = run.notes()
        for note in told:
            say(f"note: {note}")
        finished: list[PressResult] = []
        failure: BaseException | None = None
        had_earlier = self.out.exists()
        if had_earlier:
            kept.append(f"{self.out} stays as it was")
        # Who draws into the folder is ended before that is cleared.
        with atomic_directory(self.out) as folder, beside:
            # Drawn without a kernel, which may have to be compiled: a picture within seconds.
            scene = run.write_scene(folder, beside.call)
            beside.finish()
            say_first_look(console, scene)
            try:
                with step_progress(console, f"pressing {self.indenter} {run.options.aim()}") as bar:
                    pressed = run.run(bar, finished.append)
            except BaseException as error:
                # Finished steps are kept; but who interrupts has not asked for an earlier result
                # to go.
                if not finished or (had_earlier and not isinstance(error, Exception)):
                    raise
                failure, pressed = error, finished[-1]
            try:
                if run.photo is not None:
                    # Where its place and depth were corrected to.
                    pressed.plan.write_scene(folder, beside.call)
                pressed.write_into(folder, beside.call)
                beside.finish()
                write_press_page(pressed, folder)
            except BaseException as error:
                if isinstance(error, Exception) or had_earlier:
                    raise
                beside.__exit__()
                for left in set(folder.iterdir()) - {scene}:
                    shutil.rmtree(left) if left.is_dir() else left.unlink()
                why = pressed.failure or str(error) or "interrupted"
                missing = (*pressed.missing, "pictures", "the page")
                failure, pressed = error, replace(pressed, failure=why, missing=missing)
                pressed.write_into(folder, pictures=False)
        steps = pressed.steps
        kept.append(f"{self.out} has {len(steps)} finished steps, to {steps[-1].depth_mm:.4g} mm")
        if pressed.missing:
            kept[-1] += f"; missing: {', '.join(pressed.missing)}"
        for note in pressed.plan.notes():
            if note not in told:
                say(f"note: {note}")
        if pressed.error is not None:
            say(f"note: numerical error {pressed.error.words()}")
            say(f"note: force, {pressed.force_interval.words()}")
        if failure is not None:
            console.print(kept[-1], soft_wrap=True)
            raise failure
        if self.json:
            print_json({"folder": str(self.out), **pressed.figures()})
        else:
            rows = *press_rows(pressed), ("time", f"{pressed.seconds:.1f}", "s")
            print_table(("figure", "value", "unit"), rows, "press", console)
        console.print(f"wrote {self.out}")
