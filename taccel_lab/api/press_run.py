# SPDX-License-Identifier: Apache-2.0
"""A rigid indenter pressed into the gel of a sensor: one call, everything that the sensor reads.

``press``, the commands ``press`` and ``demo`` and the rough presses of ``--like`` run a
``PressRun``.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taccel_lab.api.press_options import PressOptions
from taccel_lab.api.press_photo import PressPhoto, like_photo
from taccel_lab.api.sensor import AnySensor, profile_of, reading_profile_of
from taccel_lab.camera.gel_camera import camera_of, face_of
from taccel_lab.errors import InputError, SimulationError
from taccel_lab.geometry import TetMesh
from taccel_lab.geometry.length_units import size_words
from taccel_lab.model.devices import require_device
from taccel_lab.presses import PHYSICS, Accuracy, parse_indenter, physics_difference
from taccel_lab.presses.force_interval import measured_range
from taccel_lab.presses.touch import check_depth, deepest_mm
from taccel_lab.processes.beside import Call, at_once
from taccel_lab.processes.start_warp import first_step, start_warp
from taccel_lab.profile.assumed import is_modulus_known
from taccel_lab.progress import watching_console
from taccel_lab.report import save_drawing
from taccel_lab.scene import TriangleMesh
from taccel_lab.sensors.press_mesh import profile_press_mesh
from taccel_lab.sensors.registry import profile_sensor
from taccel_lab.signals.color_model import ColorModel

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.api.press_result import Press
    from taccel_lab.presses import Indenter, PressOutcome, PressPath, PressPhysics, PressStep
    from taccel_lab.presses.measured_press import NumericalError, Resolution
    from taccel_lab.presses.press_force import StepProgress
    from taccel_lab.presses.press_outcome import FurtherView
    from taccel_lab.profile import SensorProfile


def press(
    sensor: AnySensor,
    indenter: str = PressOptions.indenter,
    *,
    progress: StepProgress | None = None,
    **options: Any,
) -> Press:
    """Press an indenter into a sensor's gel.

    Args:
        sensor: A profile, the folder of one, a sensor of the catalogue, or a calibration.
        indenter: Its shape, such as ``"sphere:4"``, see ``PressOptions.indenter``.
        progress: Told step, step count and what each step gave. When None, a bar is drawn where
            somebody watches.
        options: Fields of ``PressOptions``: ``depth_mm`` or ``force_n`` is needed.

    Raises:
        InputError: A sensor, shape, place, depth or setting that cannot be used.
        SimulationError: A step did not converge; ``PressRun.run`` hands over those before it.
    """
    run = PressRun.plan(sensor, PressOptions(indenter=indenter, **options))
    with steps_if_watched(progress, f"pressing {indenter} {run.options.aim()}") as on_step:
        return run.run(on_step)


@dataclass(frozen=True)
class PressRun:
    """A press of one sensor: planned, which checks it, then run, which gives a ``Press``."""

    sensor: str
    """Name of what is pressed, as it was given."""
    profile: SensorProfile
    indenter: Indenter
    options: PressOptions
    physics: PressPhysics
    friction: float
    """Coefficient between indenter and gel."""
    photo: PressPhoto | None = None
    """What is to be pressed like."""
    is_rough: bool = False
    """Whether it only leads to another press: its error is not measured."""

    @classmethod
    def plan(cls, sensor: AnySensor, options: PressOptions) -> PressRun:
        """Refuse, before a mesh is made, all that can be rejected. Errors as of ``press``."""
        start_warp()
        require_device(options.device)
        options.require_aim()
        indenter = parse_indenter(options.indenter, options.read_texture())
        physics, profile = (
            options.physics(),
            reading_profile_of(sensor) if options.like else profile_of(sensor),
        )
        stated = profile.material.friction_coefficient
        friction = stated if options.friction is None else options.friction
        name = str(sensor) if isinstance(sensor, (str, Path)) else profile.sensor.name
        photo = None
        if options.like is not None:
            photo = PressPhoto.read(profile, options.like, options.untouched)
            options = replace(options, depth_mm=photo.depth_mm, at_mm=photo.at_mm)
        run = cls(name, profile, indenter, options, physics, friction, photo)
        options.path(run.first_mm)
        if (options.hold_s or options.speed_mm_s is not None) and not profile.material.branches:
            raise InputError(
                f"the gel of {name} does not relax, so that time changes nothing: leave out "
                "--hold-s and --speed-mm-s, or give its material branches"
            )
        check_depth(run.first_mm, profile)
        indenter.require_size(run.first_mm)
        ColorModel.from_profile(profile)
        return run

    @property
    def first_mm(self) -> float:
        """Depth of the first press [mm]: the one asked for, or where the search begins."""
        if self.options.depth_mm is not None:
            return self.options.depth_mm
        from taccel_lab.presses.press_force import FIRST_SHARE

        return FIRST_SHARE * self.profile.gel.thickness_mm

    @property
    def remembers(self) -> bool:
        """Whether the gel's state depends on the path that led there."""
        return self.friction > 0 or bool(self.profile.material.branches)

    @property
    def is_friction_doubtful(self) -> bool:
        """Whether friction that nobody measured matters beside what is known of the modulus."""
        material = self.profile.material
        measured = measured_range(self.profile, "friction_coefficient") is not None
        chosen = self.options.friction is not None or measured or self.friction == 0
        return is_modulus_known(material) and not chosen

    @property
    def differs(self) -> str | None:
        """How the press differs from those that the material was fitted with, in a sentence."""
        return physics_difference(self.profile.material, self.physics, self.friction)

    def notes(self) -> list[str]:
        """What a person should know before the press, a sentence each."""
        found = list(self.profile.sensor.provenance.remarks[:1])
        if self.differs is not None:
            found.append(self.differs)
        if self.photo is not None:
            found += self.photo.warnings
        found += self.indenter.remarks
        if self.indenter.name.startswith("mesh:") and isinstance(self.indenter.shape, TriangleMesh):
            words = size_words(self.indenter.shape.vertices_m)
            found.append(f"{self.options.indenter} is {words}")
        return found

    @cached_property
    def gel(self) -> TetMesh:
        """Mesh of the first press, in the gel frame [m]."""
        return self._meshed(self.physics, self.first_mm)

    def write_scene(self, folder: Path, call: Call = at_once) -> Path:
        """Draw what is about to be pressed, which compiles nothing; returns the picture, which is
        there when ``call`` is done."""
        from taccel_lab.studies.report.press_picture import SCENE, draw_scene

        path, gel, family = folder / SCENE, self.gel, profile_sensor(self.profile)
        at_mm, aim = self.options.at_mm, self.options.aim()
        seen = family, gel, self.indenter, at_mm, self.first_mm, aim
        call(save_drawing, path, draw_scene, *seen)
        return path

    def run(
        self,
        progress: StepProgress | None = None,
        stopped: Callable[[Press], None] | None = None,
    ) -> Press:
        """Simulate the press. Where a step fails, or an interrupt comes, ``stopped`` is handed what
        was finished, if anything was; the error goes on."""
        # Loaded here: a plan is checked, and its scene drawn, without kernels.
        from taccel_lab.api.press_result import Press
        from taccel_lab.presses import press_to_force
        from taccel_lab.presses.measured_press import AS_IT_IS, Resolution, measured_press
        from taccel_lab.presses.press_force import ROUGH_TOLERANCE

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
            seconds = time.perf_counter() - started
            return Press(run, outcome, seconds, failure, error, below, slippery)

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
                    remembers=run.remembers,
                    asked=options.asked_share,
                    levels=options.levels,
                )
                outcome, error, below = measured.outcome, measured.error, measured.below
                at = Resolution.of(error.level, run.remembers)
                if run.is_friction_doubtful and below is not None:
                    with suppress(SimulationError):
                        smooth = simulate(path, None, Resolution.of(-1), friction=0.0)
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
        from taccel_lab.presses import profile_material, simulate_press

        # One below the options' resolution stands beside them and is nobody's result.
        beside = at.mesh < 1
        gel = self.mesh_for(physics, path.depth_mm, at.mesh)
        material = profile_material(self.profile.material, gel)
        main, *further = self._views.items()
        outcome = simulate_press(
            gel,
            material,
            self.indenter,
            self.options.at_mm,
            path.bounded(material.branches, friction).with_steps(at.steps),
            main[1].camera,
            friction_coefficient=friction,
            physics=replace(physics, dhat_m=at.dhat * physics.dhat_m),
            designed_rest=main[1].designed_rest,
            device=self.options.device,
            progress=None if beside else progress,
            keep_states=self.options.states and not beside,
            stopped=None if beside else finished.append,
            views={} if beside else dict(further),
        )
        if not beside:
            finished.append(outcome)
        return outcome

    @cached_property
    def _views(self) -> dict[str, FurtherView]:
        """All cameras by name, the main one first, and the pad's face at rest on their pixels."""
        from taccel_lab.presses.press_outcome import FurtherView
        from taccel_lab.signals.rest_surface import rest_surface

        found = {}
        for name in self.profile.view_names():
            camera = camera_of(self.profile.seen_by(name))
            found[name] = FurtherView(camera, rest_surface(self.profile.mesh, face_of(camera)))
        return found

    def mesh_for(self, physics: PressPhysics, depth_mm: float, refinement: float = 1.0) -> TetMesh:
        """Mesh of a press to a depth [mm], in the gel frame [m], with ``refinement`` times as many
        elements along every side as ``physics`` says."""
        same = physics.mesh == self.physics.mesh and refinement == 1.0
        first = same and depth_mm == self.first_mm
        return self.gel if first else self._meshed(physics, depth_mm, refinement)

    def _meshed(self, physics: PressPhysics, depth_mm: float, refinement: float = 1.0) -> TetMesh:
        if self.options.mesh == "profile":
            return self.profile.mesh
        try:
            contact = self.indenter.contact(depth_mm)
            return profile_press_mesh(
                self.profile, self.options.at_mm, contact, physics.mesh, refinement
            )
        except InputError as error:
            x, y = self.options.at_mm
            raise InputError(
                f"{self.sensor} cannot be meshed for a press at ({x:g}, {y:g}) mm: {error}"
            ) from error


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
