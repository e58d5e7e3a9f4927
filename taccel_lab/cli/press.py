# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab press``: press a rigid indenter into a sensor's gel and read what it senses."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from taccel_lab.api.press_options import PressOptions

if TYPE_CHECKING:
    from taccel_lab.api.press_result import Press as PressResult
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
        with Beside() as beside:
            # Loads what draws, which another process does while this one loads the solver.
            beside.call(new_figure, 1, 1)
            self._press(beside)

    def _press(self, beside: Beside) -> None:
        from taccel_lab.api.press_page import press_rows, write_press_page
        from taccel_lab.api.press_run import PressRun, step_progress
        from taccel_lab.cli.console import notes, print_json, print_table, say, say_first_look
        from taccel_lab.files.output_folder import atomic_directory

        console = notes()
        run = PressRun.plan(self.sensor, self)
        told = run.notes()
        for note in told:
            say(f"note: {note}")
        finished: list[PressResult] = []
        failure: BaseException | None = None
        had_earlier = self.out.exists()
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
            if run.photo is not None:
                # Where its place and depth were corrected to.
                pressed.plan.write_scene(folder, beside.call)
            pressed.write_into(folder, beside.call)
            beside.finish()
            write_press_page(pressed, folder)
        for note in pressed.plan.notes():
            if note not in told:
                say(f"note: {note}")
        if pressed.error is not None:
            say(f"note: numerical error {pressed.error.words()}")
            say(f"note: force, {pressed.force_interval.words()}")
        if failure is not None:
            steps = pressed.outcome.steps
            console.print(
                f"wrote {self.out}: {len(steps)} finished steps, to {steps[-1].depth_mm:.4g} mm"
            )
            raise failure
        if self.json:
            print_json({"folder": str(self.out), **pressed.figures()})
        else:
            print_table(("figure", "value", "unit"), press_rows(pressed), "press", console)
        console.print(f"wrote {self.out}")
