# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab press``: press a rigid indenter into a sensor's gel and read what it senses."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tyro.conf import Positional

from taccel_lab.api.press_options import PressOptions

if TYPE_CHECKING:
    from taccel_lab.api.press_result import Press as PressResult
    from taccel_lab.presses import PressPath
    from taccel_lab.presses.measured_press import SignalError
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
        from taccel_lab.api.press_run import PressRun, step_progress
        from taccel_lab.cli.console import notes, print_json, say, say_first_look
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
            _print_outcome(pressed)
        console.print(f"wrote {self.out}")


def _path_rows(path: PressPath, figures: dict[str, Any]) -> Iterator[tuple[str, str, str]]:
    """Where the indenter ended and what it met; after a way back all else is of its end."""
    if path.back:
        yield "deepest, past first touch", f"{path.depth_mm:.4g}", "mm"
    if (hold := figures.get("hold")) is not None:
        fall = f"{hold['from_n']:.4g}  {hold['to_n']:.4g}"
        yield f"force before and after {hold['seconds']:g} s of hold", fall, "N"
    if (loop := figures.get("loop")) is not None:
        works = f"{loop['work_mj']:.4g}  {loop['lost_mj']:.4g}"
        yield "work of the press, lost on the way back", works, "mJ"
    yield "depth past first touch", f"{figures['steps'][-1]['depth_mm']:.4g}", "mm"


def _digits(values: Iterable[float], error: float) -> str:
    from taccel_lab.with_error import to_error

    return "  ".join(to_error(float(value), error) for value in values)


def _both(error: SignalError, unit: float = 1.0) -> str:
    return f"{unit * error.numerical:.2g}  {unit * error.total:.2g}"


def _print_outcome(pressed: PressResult) -> None:
    from taccel_lab.cli.console import notes, print_table
    from taccel_lab.with_error import with_error

    outcome, figures = pressed.outcome, pressed.figures()
    force, moment, image = pressed.wrench[:3], 1e3 * pressed.wrench[3:], pressed.image_error
    error_n, heights = outcome.force_error_n, pressed.height_error
    ends = pressed.force_interval_n
    rows = [
        *_path_rows(outcome.path, figures),
        ("normal force, numerical error", with_error(force[2], error_n), "N"),
        ("its 95 % interval, all causes", "  ".join(f"{end:.3g}" for end in ends), "N"),
        ("force of the gel on the indenter", _digits(force, error_n), "N"),
        ("moment about the gel's origin", _digits(moment, error_n), "N mm"),
        ("error of heights: numerical, total", _both(heights, 1e3), "um rms"),
        ("contact radius (equal area)", f"{figures['contact_radius_mm']:.3f}", "mm"),
        ("force residual", f"{figures['residual_n']:.1e}", "N"),
        ("Newton iterations", f"{figures['newton_iterations']}", ""),
        ("smallest gap", f"{figures['min_distance_m'] * 1e6:.2f}", "um"),
        ("smallest volume ratio of a tet", f"{figures['smallest_volume_ratio']:.3f}", ""),
        ("time", f"{pressed.seconds:.1f}", "s"),
        ("nodes, tets", f"{outcome.mesh.node_count}, {outcome.mesh.tet_count}", ""),
    ]
    if image is not None:
        rows.append(("error of the image: numerical, total", _both(image), "levels rms"))
    if pressed.like is not None:
        like = pressed.like
        place = zip("xy", like["at_mm"], like["at_sigma_mm"] or (None, None), strict=True)
        rows += [
            *((f"place in the photo, {axis}", with_error(at, s), "mm") for axis, at, s in place),
            ("depth in the photo", with_error(like["depth_mm"], like["depth_sigma_mm"]), "mm"),
            ("photo and simulation, crop", f"{like['psnr_db']:.1f}", "dB"),
            ("photo and untouched image", f"{like['untouched_psnr_db']:.1f}", "dB"),
        ]
    if outcome.fine_force_n is not None:
        fine = f"{outcome.fine_force_n:.4f}"
        rows.append(("force of the contact with the texture", fine, "N"))
    print_table(("figure", "value", "unit"), rows, "press", notes())
