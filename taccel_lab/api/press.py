# SPDX-License-Identifier: Apache-2.0
"""A rigid indenter pressed into the gel of a sensor: one call, everything that the sensor reads."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Unpack

from taccel_lab.api.press_options import PressOptions, PressWords
from taccel_lab.api.press_plan import PressPlan
from taccel_lab.api.press_progress import steps_if_watched
from taccel_lab.api.press_result import Press
from taccel_lab.api.sensor import AnySensor
from taccel_lab.camera.gel_camera import camera_of, face_of
from taccel_lab.presses import PHYSICS, Accuracy, profile_material, simulate_press
from taccel_lab.presses.press import deepest_mm
from taccel_lab.presses.press_force import ROUGH_TOLERANCE, press_to_force
from taccel_lab.signals.rest_surface import rest_surface

if TYPE_CHECKING:
    from taccel_lab.presses import PressOutcome, PressPath, PressPhysics
    from taccel_lab.presses.press_force import Told


def press(
    sensor: AnySensor,
    indenter: str = PressOptions.indenter,
    *,
    progress: Told | None = None,
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
    with steps_if_watched(progress, f"pressing {indenter} {plan.options.aim()}") as told:
        return run_press(plan, told)


def run_press(
    plan: PressPlan,
    progress: Told | None = None,
    stopped: Callable[[Press], None] | None = None,
) -> Press:
    """Simulate a plan. Where a step fails, or an interrupt comes, ``stopped`` is handed what was
    finished, if anything was; the error goes on."""
    options, started = plan.options, time.perf_counter()
    camera = camera_of(plan.profile)
    rest = rest_surface(plan.profile.mesh, face_of(camera))
    finished: list[PressOutcome] = []

    def simulate(physics: PressPhysics, path: PressPath, told: Told | None) -> PressOutcome:
        gel = plan.mesh_for(physics, path.depth_mm)
        outcome = simulate_press(
            gel,
            profile_material(plan.profile.material, gel),
            plan.indenter,
            options.at_mm,
            path,
            camera,
            friction_coefficient=plan.friction,
            physics=physics,
            designed_rest=rest,
            device=options.device,
            progress=told,
            keep_states=options.states,
            stopped=finished.append,
        )
        finished.append(outcome)
        return outcome

    def result(outcome: PressOutcome, failure: str | None = None) -> Press:
        return Press(plan, outcome, time.perf_counter() - started, failure)

    try:
        if options.force_n is None:
            outcome = simulate(plan.physics, options.path(plan.first_mm), progress)
        else:
            outcome = _to_force(plan, options.force_n, simulate, progress)
    except BaseException as error:
        if finished and stopped is not None:
            stopped(result(finished[-1], str(error) or "interrupted"))
        raise
    return result(outcome)


def _to_force(
    plan: PressPlan,
    force_n: float,
    simulate: Callable[[PressPhysics, PressPath, Told | None], PressOutcome],
    told: Told | None,
) -> PressOutcome:
    """About how deep, by presses straight down of low accuracy; then as asked for."""
    options, first_mm = plan.options, None
    limit_mm = deepest_mm(plan.gel, options.at_mm)
    if plan.physics.accuracy != Accuracy.FAST:
        rough = replace(PHYSICS[Accuracy.FAST], element=plan.physics.element)
        first_mm = press_to_force(
            force_n,
            lambda depth_mm, told: simulate(rough, options.path(depth_mm, aside=False), told),
            limit_mm,
            tolerance=ROUGH_TOLERANCE,
            told=told,
        ).path.depth_mm
    return press_to_force(
        force_n,
        lambda depth_mm, told: simulate(plan.physics, options.path(depth_mm), told),
        limit_mm,
        first_mm=first_mm,
        told=told,
    )
