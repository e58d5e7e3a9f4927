# SPDX-License-Identifier: Apache-2.0
"""A rigid indenter pressed into the gel of a sensor: one call, everything that the sensor reads."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Unpack

from taccel_lab.api.press_like import like_photo
from taccel_lab.api.press_options import PressOptions, PressWords
from taccel_lab.api.press_progress import steps_if_watched
from taccel_lab.api.press_result import Press
from taccel_lab.api.press_run import PressPlan
from taccel_lab.api.sensor import AnySensor
from taccel_lab.camera.gel_camera import camera_of, face_of
from taccel_lab.errors import SimulationError
from taccel_lab.presses import PHYSICS, Accuracy, profile_material, simulate_press
from taccel_lab.presses.measured_press import AS_IT_IS, Resolution, measured_press
from taccel_lab.presses.press_force import ROUGH_TOLERANCE, press_to_force
from taccel_lab.presses.press_outcome import FurtherView
from taccel_lab.presses.touch import deepest_mm
from taccel_lab.signals.rest_surface import rest_surface

if TYPE_CHECKING:
    from taccel_lab.presses import PressOutcome, PressPath, PressPhysics
    from taccel_lab.presses.measured_press import NumericalError
    from taccel_lab.presses.press_force import StepProgress


def press(
    sensor: AnySensor,
    indenter: str = PressOptions.indenter,
    *,
    progress: StepProgress | None = None,
    **options: Unpack[PressWords],
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
        SimulationError: A step did not converge; ``run_press`` hands over those before it.
    """
    plan = PressPlan.of(sensor, PressOptions(indenter=indenter, **options))
    with steps_if_watched(progress, f"pressing {indenter} {plan.options.aim()}") as on_step:
        return run_press(plan, on_step)


def run_press(
    plan: PressPlan,
    progress: StepProgress | None = None,
    stopped: Callable[[Press], None] | None = None,
) -> Press:
    """Simulate a plan. Where a step fails, or an interrupt comes, ``stopped`` is handed what was
    finished, if anything was; the error goes on."""
    started = time.perf_counter()
    if plan.photo is not None:
        plan = like_photo(plan, lambda rough: run_press(rough, progress))
    options = plan.options
    camera = camera_of(plan.profile)
    rest = rest_surface(plan.profile.mesh, face_of(camera))
    views = {}
    for name in plan.profile.views:
        further = camera_of(plan.profile.seen_by(name))
        views[name] = FurtherView(further, rest_surface(plan.profile.mesh, face_of(further)))
    finished: list[PressOutcome] = []

    def simulate(
        physics: PressPhysics,
        path: PressPath,
        progress: StepProgress | None,
        at: Resolution = AS_IT_IS,
        friction: float = plan.friction,
    ) -> PressOutcome:
        # One below the options' resolution stands beside them and is nobody's result.
        beside = at.mesh < 1
        gel = plan.mesh_for(physics, path.depth_mm, at.mesh)
        material = profile_material(plan.profile.material, gel)
        outcome = simulate_press(
            gel,
            material,
            plan.indenter,
            options.at_mm,
            path.bounded(material.branches, friction).with_steps(at.steps),
            camera,
            friction_coefficient=friction,
            physics=replace(physics, dhat_m=at.dhat * physics.dhat_m),
            designed_rest=rest,
            device=options.device,
            progress=None if beside else progress,
            keep_states=options.states and not beside,
            stopped=None if beside else finished.append,
            views={} if beside else views,
        )
        if not beside:
            finished.append(outcome)
        return outcome

    def result(outcome: PressOutcome, failure: str | None = None) -> Press:
        if error is not None and failure is None:
            outcome = error.stated_for(outcome)
        return Press(plan, outcome, time.perf_counter() - started, failure, error, below, slippery)

    slippery: float | None = None
    error: NumericalError | None = None
    below: PressOutcome | None = None
    at, depth_mm = AS_IT_IS, plan.first_mm
    try:
        if options.force_n is not None and plan.physics.accuracy != Accuracy.FAST:
            depth_mm = _rough_depth_mm(plan, options.force_n, simulate, progress)
        if options.mesh == "profile" or plan.is_rough:
            # Beside a stored mesh there is no coarser one, and nobody has measured what it does.
            outcome = simulate(plan.physics, options.path(depth_mm), progress)
            outcome = replace(outcome, force_error_n=math.nan, height_error_m=math.nan)
        else:
            measured = measured_press(
                lambda at: simulate(plan.physics, options.path(depth_mm), progress, at),
                plan.physics,
                plan.indenter.shape,
                remembers=plan.remembers,
                asked=options.asked_share,
                levels=options.levels,
            )
            outcome, error, below = measured.outcome, measured.error, measured.below
            at = Resolution.of(error.level, plan.remembers)
            if plan.is_friction_doubtful and measured.below is not None:
                path = options.path(depth_mm)
                slippery = _slippery(
                    measured.below,
                    lambda: simulate(plan.physics, path, None, Resolution.of(-1), friction=0.0),
                )
        if options.force_n is not None:
            # What the resolution adds to a force it adds at a depth near by too.
            outcome = press_to_force(
                options.force_n / (1.0 if error is None else error.factor),
                lambda depth_mm, on_step: simulate(
                    plan.physics, options.path(depth_mm), on_step, at
                ),
                deepest_mm(plan.gel, options.at_mm),
                first=outcome,
                progress=progress,
            )
    except BaseException as why:
        if finished and stopped is not None:
            stopped(result(finished[-1], str(why) or "interrupted"))
        raise
    return result(outcome)


def _slippery(rough: PressOutcome, press: Callable[[], PressOutcome]) -> float | None:
    """Force without friction over that of a press with it; None where that did not converge."""
    try:
        return press().force_n / rough.force_n
    except SimulationError:
        return None


def _rough_depth_mm(
    plan: PressPlan,
    force_n: float,
    simulate: Callable[[PressPhysics, PressPath, StepProgress | None], PressOutcome],
    progress: StepProgress | None,
) -> float:
    """About how deep a force is [mm], by presses straight down of low accuracy."""
    rough = replace(PHYSICS[Accuracy.FAST], element=plan.physics.element)
    return press_to_force(
        force_n,
        lambda depth_mm, on_step: simulate(
            rough, plan.options.path(depth_mm, aside=False), on_step
        ),
        deepest_mm(plan.gel, plan.options.at_mm),
        tolerance=ROUGH_TOLERANCE,
        progress=progress,
    ).path.depth_mm
