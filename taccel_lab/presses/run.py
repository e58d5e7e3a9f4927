# SPDX-License-Identifier: Apache-2.0
"""A planned press, run: ``press``, the commands ``press`` and ``demo`` and the rough presses of
``--like``."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.errors import SimulationError
from taccel_lab.presses import PHYSICS, Accuracy
from taccel_lab.presses.photo import PressPhoto
from taccel_lab.presses.plan import PressPlan
from taccel_lab.presses.touch import check_depth, deepest_mm
from taccel_lab.processes.start_warp import first_step
from taccel_lab.progress import watching_console

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.presses import PressOutcome, PressPath, PressPhysics, PressStep
    from taccel_lab.presses.force_search import StepProgress
    from taccel_lab.presses.numerical_error import NumericalError, Resolution
    from taccel_lab.presses.press import Press


TRIALS = 3
"""Rough presses at most. One leaves a tenth to a third of what a reading is off by."""
SETTLED = 0.25
"""Share of the standard deviation; a correction below it leaves a tenth of one."""
UNREAD = (
    "the simulated press is too shallow to be read as the photo is: place and depth are those of "
    "the photo's reading, which nothing corrects"
)


class PressRun(PressPlan):
    """A press of one sensor: planned, which checks it, then run, which gives a ``Press``."""

    def run(
        self,
        progress: StepProgress | None = None,
        stopped: Callable[[Press], None] | None = None,
    ) -> Press:
        """Simulate the press. Where a step fails, or an interrupt comes, ``stopped`` is handed what
        was finished, if anything was; the error goes on."""
        # Loaded here: a plan is checked, and its scene drawn, without kernels.
        from taccel_lab.presses import press_to_force
        from taccel_lab.presses.force_search import ROUGH_TOLERANCE
        from taccel_lab.presses.numerical_error import (
            AS_IT_IS,
            BESIDE,
            Resolution,
            measured_press,
        )
        from taccel_lab.presses.page import write_press_page
        from taccel_lab.presses.press import Press

        started = time.perf_counter()
        run = self
        if self.photo is not None:
            run = like_photo(self, lambda rough: rough.run(progress))
        options = run.options
        finished: list[PressOutcome] = []

        def simulate(
            path: PressPath,
            progress: StepProgress | None,
            at: Resolution = AS_IT_IS,
            physics: PressPhysics = run.physics,
            friction: float = run.friction,
        ) -> PressOutcome:
            return run._simulate(path, progress, at, physics, friction, finished)

        def result(outcome: PressOutcome, failure: str | None = None) -> Press:
            if error is not None and failure is None:
                outcome = error.stated_for(outcome)
            missing = ()
            if failure is not None:
                to_mm = outcome.steps[-1].depth_mm
                steps = () if outcome.stopped is None else (f"steps past {to_mm:.4g} mm",)
                missing = (*steps, *(("the numerical error",) if error is None else ()))
            seconds = time.perf_counter() - started
            return Press.of(
                outcome,
                run,
                seconds,
                failure=failure,
                error=error,
                below=below,
                write_page=write_press_page,
                missing=missing,
                slippery=slippery,
            )

        slippery: float | None = None
        error: NumericalError | None = None
        below: PressOutcome | None = None
        at, depth_mm = AS_IT_IS, run.first_mm
        try:
            if options.force_n is not None and run.physics.accuracy != Accuracy.FAST:
                # About how deep the force is, by presses straight down of low accuracy.
                rough = replace(PHYSICS[Accuracy.FAST], element=run.physics.element)
                depth_mm = press_to_force(
                    options.force_n,
                    lambda depth_mm, on_step: simulate(
                        options.path(depth_mm, aside=False), on_step, physics=rough
                    ),
                    deepest_mm(run.gel, options.at_mm),
                    tolerance=ROUGH_TOLERANCE,
                    progress=progress,
                ).path.depth_mm
            path = options.path(depth_mm)
            if options.mesh == "profile" or run.is_rough:
                # Beside a stored mesh there is no coarser one: nobody has measured what it does.
                outcome = simulate(path, progress)
                outcome = replace(outcome, force_error_n=math.nan, height_error_m=math.nan)
            else:
                measured = measured_press(
                    lambda at: simulate(path, progress, at),
                    run.physics,
                    run.indenter.shape,
                    friction=run.friction,
                    remembers=run.remembers,
                    beside_edge=run.is_beside_edge(path),
                    asked=options.asked_share,
                    levels=options.levels,
                )
                outcome, error, below = measured.outcome, measured.error, measured.below
                at = Resolution.of(error.level, run.remembers)
                if run.is_friction_doubtful and below is not None:
                    with suppress(SimulationError):
                        smooth = simulate(path, None, BESIDE, friction=0.0)
                        slippery = smooth.force_n / below.force_n
            if options.force_n is not None:
                # What the resolution adds to a force it adds at a depth near by too.
                outcome = press_to_force(
                    options.force_n / (1.0 if error is None else error.factor),
                    lambda depth_mm, on_step: simulate(options.path(depth_mm), on_step, at),
                    deepest_mm(run.gel, options.at_mm),
                    first=outcome,
                    progress=progress,
                )
        except BaseException as why:
            if finished and stopped is not None:
                stopped(result(finished[-1], str(why) or "interrupted"))
            raise
        return result(outcome)

    def _simulate(
        self,
        path: PressPath,
        progress: StepProgress | None,
        at: Resolution,
        physics: PressPhysics,
        friction: float,
        finished: list[PressOutcome],
    ) -> PressOutcome:
        """Press along a path; what is this run's own is put into ``finished``, cut short or not."""
        from taccel_lab.presses import PressSetup, profile_material, simulate_press

        beside, shape = at.is_beside, self.indenter.shape
        physics = self.near(physics, path, friction)
        mesh = self.mesh_for(physics, path, at.mesh)
        material = profile_material(self.profile.material, mesh)
        main, *further = self._views.items()
        whole = path.bounded(material.branches, friction)
        path = at.path(whole, shape, friction, relaxes=bool(material.branches))
        physics = at.physics(physics, shape, path)
        remembers = friction > 0 or bool(material.branches)
        device = self.options.device
        outcome = simulate_press(
            PressSetup(mesh, material, self.indenter, friction, physics, device),
            self.options.at_mm,
            path,
            # Only its heights are used, and pixels tell those apart as well as parts of them.
            replace(main[1], points=1) if beside else main[1],
            views={} if beside else dict(further),
            progress=None if beside else progress,
            stopped=None if beside else finished.append,
            keep_states=self.options.states and not beside,
            beside=whole if beside and remembers else None,
        )
        if not beside:
            finished.append(outcome)
        return outcome


def like_photo(run: PressRun, simulate: Callable[[PressRun], Press]) -> PressRun:
    """Return the run with the place and depth at which its simulated image reads as its photo.

    Args:
        run: Place and depth as read in its photo.
        simulate: Presses such a run.

    Raises:
        InputError: A corrected place or depth that the gel does not allow.
        SimulationError: A rough press did not converge.
    """
    photo = run.photo
    assert photo is not None
    for _ in range(TRIALS):
        options = run.options
        assert options.depth_mm is not None
        image = simulate(_rough(run)).image
        assert image is not None
        found = photo.beside(image, options.at_mm, options.depth_mm)
        if found is None:
            unread = replace(photo, warnings=(*photo.warnings, UNREAD))
            return replace(run, photo=unread)
        check_depth(found.depth_mm, run.profile)
        settled = _settled(run, found)
        moved = replace(options, at_mm=found.at_mm, depth_mm=found.depth_mm)
        run = replace(run, options=moved, photo=found)
        if settled:
            break
    return run


def _rough(run: PressRun) -> PressRun:
    """A press for its image: the end of the same way in, of low accuracy."""
    physics = replace(PHYSICS[Accuracy.FAST], element=run.physics.element)
    options = replace(
        run.options, like=None, accuracy=Accuracy.FAST, unload=False, hold_s=0.0, states=False
    )
    return replace(run, options=options, physics=physics, photo=None, is_rough=True)


def _settled(run: PressRun, found: PressPhoto) -> bool:
    """Whether a correction is small; never where no deviation is known."""
    if found.at_error_mm is None or found.depth_error_mm is None:
        return False
    options = run.options
    assert options.depth_mm is not None
    moved = np.array([*found.at_mm, found.depth_mm]) - [*options.at_mm, options.depth_mm]
    return bool(
        (np.abs(moved) < SETTLED * np.array([*found.at_error_mm, found.depth_error_mm])).all()
    )


@contextmanager
def step_progress(console: Console, title: str) -> Iterator[StepProgress]:
    """Yield a callback that draws each step."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[note]}", markup=False),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console) as progress:
        task = progress.add_task(title, total=None, note=first_step())

        def update(done: int, total: int, step: PressStep) -> None:
            report = step.report
            note = (
                f"depth {step.depth_mm:.2f} mm, force {step.wrench[2] + 0.0:.3g} N, residual "
                f"{report.residual_n[0]:.1e} N, {report.newton_iterations[0]} Newton, "
                f"{report.seconds:.2f} s"
            )
            progress.update(task, completed=done, total=total, note=note)

        yield update


@contextmanager
def steps_if_watched(progress: StepProgress | None, title: str) -> Iterator[StepProgress | None]:
    """Yield ``progress``; where it is None, a bar on a terminal or in a notebook, else nothing."""
    console = None if progress is not None else watching_console()
    if console is None:
        yield progress
        return
    with step_progress(console, title) as bar:
        yield bar
