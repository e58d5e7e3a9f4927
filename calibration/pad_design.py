# SPDX-License-Identifier: Apache-2.0
"""The catalogue's design that fits captures: turned as the camera is, or a pad made to measure.

Captures may show a sensor upright that the catalogue has lying down; its pad is then turned by a
quarter. A ``flat_pad``, which stands for any flat gel that is not in the catalogue, is made as
large as the image shows and a margin.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from taccel_lab.calibration.shared_remarks import (
    FLAT_PAD_ASSUMED,
    IMAGES_ACROSS,
    PAD_TURNED,
    SCALE_PAST_PAD,
)
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import SensorProfile
from taccel_lab.profile.quarter_turn import quarter_turned
from taccel_lab.report.remark import Remark
from taccel_lab.sensors.base import FamilyParameters
from taccel_lab.sensors.profile import catalogue_profile
from taccel_lab.sensors.registry import sensor_family

FLAT_PAD = "flat_pad"
MARGIN_MM = 3.0
"""Gel beyond what the image shows, all around, of a pad made to measure: it holds the sunk rim of
presses at the image's edge."""
AROUND_THE_GEL = ("optics", "window", "coating", "lights", "housing")
"""Blocks whose design follows the gel's thickness."""
DESIGNED = ("assumed", "published", "designed")
"""Kinds of blocks that no capture of this unit has told."""
TURN_ASPECT = 1.1
"""From this ratio of its sides on, an image or a pad is upright or lies down."""


def fitted_design(
    sensor: str, grid: PixelGrid, overrides: Mapping[str, Any] | None = None
) -> SensorProfile:
    """The catalogue's design of ``sensor``, made to fit images of ``grid``.

    ``overrides`` are parameters that were measured, such as the gel's thickness; they win.

    Raises:
        InputError: Parameters that cannot be built, a sensor whose package cannot be loaded, or
            images that show more than any pad.
    """
    given = dict(overrides or {})
    for remark in past_largest_pad(sensor, grid, given):
        raise InputError(remark.message)
    if sensor == FLAT_PAD:
        return catalogue_profile(FLAT_PAD, {**_made_to_measure(grid), **given})
    turned = _turned(sensor, grid)
    if turned:
        return _upright(sensor, {**turned, **given})
    return catalogue_profile(sensor, given)


def with_thickness(profile: SensorProfile, thickness_mm: float) -> SensorProfile:
    """A profile whose gel is designed anew with another thickness, and what was designed around it;
    blocks that were measured or calibrated stay.

    Raises:
        InputError: A thickness that the sensor's family cannot have.
    """
    sensor = profile.sensor.family
    values = {**profile.sensor.parameters, "thickness_mm": thickness_mm}
    turned = _turned(sensor, profile.grid())
    design = _upright(sensor, values) if turned else catalogue_profile(sensor, values)
    changes: dict[str, Any] = {"gel": design.gel, "mesh": design.mesh}
    changes["sensor"] = profile.sensor.replace(parameters=design.sensor.parameters)
    for key in AROUND_THE_GEL:
        known = getattr(profile, key)
        if known is not None and known.provenance.kind in DESIGNED:
            changes[key] = getattr(design, key)
    return dataclasses.replace(profile, **changes)


def fitted_parameters(
    sensor: str, grid: PixelGrid, overrides: Mapping[str, Any]
) -> FamilyParameters:
    """Parameters of ``fitted_design``, without meshing it."""
    given = _made_to_measure(grid) if sensor == FLAT_PAD else _turned(sensor, grid)
    return sensor_family(sensor).parameters({**given, **overrides})


def past_largest_pad(sensor: str, grid: PixelGrid, overrides: Mapping[str, Any]) -> list[Remark]:
    """That images show more than any pad made to measure can have, by the bounds of its design:
    their scale is wrong."""
    if sensor != FLAT_PAD:
        return []
    most = sensor_family(FLAT_PAD).parameters_type.parameters()
    sides = {
        name: float(most[name].maximum or np.inf)
        for name in ("length_x_mm", "length_y_mm")
        if name not in overrides
    }
    made = _made_to_measure(grid)
    if all(made[name] <= side for name, side in sides.items()):
        return []
    return [
        SCALE_PAST_PAD(
            mm_per_px_x=grid.mm_per_px_x,
            mm_per_px_y=grid.mm_per_px_y,
            width=grid.width_px * grid.mm_per_px_x,
            height=grid.height_px * grid.mm_per_px_y,
            pad_x=sides.get("length_x_mm", overrides.get("length_x_mm")),
            pad_y=sides.get("length_y_mm", overrides.get("length_y_mm")),
        )
    ]


def _upright(sensor: str, overrides: Mapping[str, Any]) -> SensorProfile:
    """The design of ``overrides``, meshed as the catalogue has it lie, and turned as a whole."""
    family = sensor_family(sensor)
    lying = {_across(name, family.parameters().values()): v for name, v in overrides.items()}
    turned = quarter_turned(catalogue_profile(sensor, lying))
    values = family.parameters(overrides).values()
    return dataclasses.replace(turned, sensor=turned.sensor.replace(parameters=values))


def _made_to_measure(grid: PixelGrid) -> dict[str, Any]:
    width_mm = grid.width_px * grid.mm_per_px_x
    height_mm = grid.height_px * grid.mm_per_px_y
    size = {"length_x_mm": width_mm, "length_y_mm": height_mm}
    limits = sensor_family(FLAT_PAD).parameters_type.parameters()
    return {
        **{
            name: round(max(value + 2 * MARGIN_MM, float(limits[name].minimum or 0.0)), 3)
            for name, value in size.items()
        },
        "width_px": grid.width_px,
        "height_px": grid.height_px,
        "mm_per_px": grid.mm_per_px_x,
        "mm_per_px_y": 0.0 if grid.mm_per_px_y == grid.mm_per_px_x else grid.mm_per_px_y,
    }


def lies_across(sensor: str, grid: PixelGrid) -> bool:
    """Whether images and the catalogue's pad lie across each other: one upright, one not."""
    family = sensor_family(sensor)
    size = np.ptp(family.parameters().pad().bounds_mm(), axis=0)
    pad = float(size[0] / size[1])
    view = grid.width_px * grid.mm_per_px_x / (grid.height_px * grid.mm_per_px_y)
    return (view < 1 / TURN_ASPECT and pad > TURN_ASPECT) or (
        view > TURN_ASPECT and pad < 1 / TURN_ASPECT
    )


def design_remarks(
    sensor: str, grid: PixelGrid | None, overrides: Mapping[str, Any]
) -> list[Remark]:
    """What has to be assumed of the pad: a thickness that nobody measured, how it lies under
    images of ``grid``."""
    if sensor == FLAT_PAD:
        if "thickness_mm" in overrides:
            return []
        thickness = sensor_family(FLAT_PAD).parameters().values()["thickness_mm"]
        return [FLAT_PAD_ASSUMED(thickness_mm=thickness)]
    if grid is None or not lies_across(sensor, grid):
        return []
    if _turned(sensor, grid):
        return [PAD_TURNED(sensor=sensor)]
    width, height = grid.width_px * grid.mm_per_px_x, grid.height_px * grid.mm_per_px_y
    lie = "lie down" if width > height else "stand upright"
    return [IMAGES_ACROSS(lie=lie, width_mm=width, height_mm=height, sensor=sensor)]


def _turned(sensor: str, grid: PixelGrid) -> dict[str, Any]:
    """Overrides that exchange x and y of the pad, where images and pad lie across each other."""
    if not lies_across(sensor, grid):
        return {}
    parameters = sensor_family(sensor).parameters()
    described, values = parameters.describe(), parameters.values()
    return {
        name: values[_across(name, values)]
        for name, item in described.items()
        if (item["group"] or "gel") == "gel" and _across(name, values) != name
    }


def _across(name: str, values: Mapping[str, Any]) -> str:
    """The parameter that is along y what ``name`` is along x, or the other way; itself if none."""
    for one, other in (("_x_", "_y_"), ("_y_", "_x_")):
        if one in name and name.replace(one, other) in values:
            return name.replace(one, other)
    return name
