# SPDX-License-Identifier: Apache-2.0
"""The task ``touch-insertion`` with gels of a design."""

from __future__ import annotations

from dataclasses import replace

from taccel_lab.errors import InputError
from taccel_lab.sensors.base import FamilyParameters
from taccel_lab.tasks.catalogue import Task, named
from taccel_lab.tasks.touch_insertion import TouchInsertionParameters


def design_task(design: FamilyParameters) -> Task:
    """The task with the design's size, thickness, modulus, friction and grid of markers.

    The gel is a flat block of the size of the pad: a crown, a skin and Poisson's ratio are not
    taken over. InputError for a design without markers.
    """
    markers = design.markers()
    if markers is None:
        raise InputError("the policy of touch-insertion sees markers, and this design has none")
    task = named("touch-insertion")
    assert isinstance(task.parameters, TouchInsertionParameters)
    pad, gel = design.pad(), design.material()
    low, high = pad.bounds_mm()
    width, height = (float(side) for side in (high - low)[:2])
    parameters = task.parameters.replace(
        gel=task.parameters.gel.replace(
            size_mm=(width, height, float(pad.thickness_mm)),
            young_modulus_pa=gel.young_modulus_pa,
            friction=gel.friction_coefficient,
        ),
        markers=task.parameters.markers.replace(
            columns=markers.columns,
            rows=markers.rows,
            pitch_mm=(markers.pitch_x_mm, markers.pitch_y_mm),
        ),
    )
    return replace(task, parameters=parameters)
