# SPDX-License-Identifier: Apache-2.0
"""The pad under the images of captures: the catalogue's design that fits them, and what it covers.

Captures may show a sensor upright that the catalogue has lying down; its pad is then turned by a
quarter. A ``flat_pad``, which stands for any flat gel that is not in the catalogue, is made as
large as the image shows and a margin.

One test for the check and for calibrations says whether the pad lies under what an image shows.
Beside the pad there is no gel that a press could move, and near its edge a pressed pad may leave
pixels that it covered: meshes cut rounded corners short (by 0.11 mm on a GelSight Mini), and gel
gives way. Such pixels are used by nothing. An image that shows clearly more than the pad is
rejected: its scale is wrong, or what lies beside the gel has to be masked.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from taccel_lab.calibration.remarks import (
    FLAT_PAD_ASSUMED,
    IMAGES_ACROSS,
    PAD_EDGE,
    PAD_TURNED,
    SCALE_PAST_PAD,
)
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import SensorProfile
from taccel_lab.profile.quarter_turn import quarter_turned
from taccel_lab.report.remark import Remark, Severity
from taccel_lab.sensors.base import FamilyParameters
from taccel_lab.sensors.profile import catalogue_profile
from taccel_lab.sensors.registry import profile_parameters, sensor_family

FLAT_PAD = "flat_pad"
MARGIN_MM = 3.0
"""Gel beyond what the image shows, all around, of a pad made to measure: it holds the sunk rim of
presses at the image's edge."""
AROUND_THE_GEL = ("optics", "window", "coating", "lights", "housing")
"""Blocks whose design follows the gel's thickness."""
DESIGNED = ("assumed", "published", "designed")
"""Kinds of blocks that no capture of this unit has told."""
TURN_ASPECT = 1.1
"""Ratio of its sides from which on an image or a pad is upright or lies down."""
EDGE_MM = 0.5
"""Gel along the pad's edge that is not used: no camera of the catalogue shows any of it."""
LATTICE = 81
"""Pixels along a side whose distance is computed."""
OVERHANG_SHARE = 0.025
"""How far an image may reach past the pad's edge, as a part of the pad's longer side: stated scales
are rounded."""


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
    """Error of images that show more than any pad made to measure can have, by the bounds of its
    design: their scale is wrong."""
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
    pad = [sides.get(name, overrides.get(name)) for name in ("length_x_mm", "length_y_mm")]
    return [SCALE_PAST_PAD(**_view(grid), pad_x=pad[0], pad_y=pad[1])]


def _view(grid: PixelGrid) -> dict[str, Any]:
    """Scale and extent of an image, as remarks name them."""
    return {
        "mm_per_px_x": grid.mm_per_px_x,
        "mm_per_px_y": grid.mm_per_px_y,
        "width": grid.width_px * grid.mm_per_px_x,
        "height": grid.height_px * grid.mm_per_px_y,
    }


def _upright(sensor: str, overrides: Mapping[str, Any]) -> SensorProfile:
    """The design of ``overrides``, meshed as the catalogue has it lie, and turned as a whole."""
    family = sensor_family(sensor)
    lying = {_across(name, family.parameters().values()): v for name, v in overrides.items()}
    turned = quarter_turned(catalogue_profile(sensor, lying))
    values = family.parameters(overrides).values()
    return dataclasses.replace(turned, sensor=turned.sensor.replace(parameters=values))


def _made_to_measure(grid: PixelGrid) -> dict[str, Any]:
    size = {
        "length_x_mm": grid.width_px * grid.mm_per_px_x,
        "length_y_mm": grid.height_px * grid.mm_per_px_y,
    }
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


def _lies_across(sensor: str, grid: PixelGrid) -> bool:
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
    if grid is None or not _lies_across(sensor, grid):
        return []
    if _turned(sensor, grid):
        return [PAD_TURNED(sensor=sensor)]
    width, height = grid.width_px * grid.mm_per_px_x, grid.height_px * grid.mm_per_px_y
    lie = "lie down" if width > height else "stand upright"
    return [IMAGES_ACROSS(lie=lie, width_mm=width, height_mm=height, sensor=sensor)]


def _turned(sensor: str, grid: PixelGrid) -> dict[str, Any]:
    """Overrides that exchange x and y of the pad, where images and pad lie across each other."""
    if not _lies_across(sensor, grid):
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


def inside_mm(parameters: FamilyParameters, grid: PixelGrid) -> np.ndarray:
    """Distance of each pixel in plan to the edge of the pad's contact face [mm], positive over the
    pad, shape [height_px, width_px]; linear between pixels of a lattice."""
    u, v, known = _lattice(parameters, grid)
    rows = np.array([np.interp(np.arange(grid.width_px), u, row) for row in known])
    return np.array([np.interp(np.arange(grid.height_px), v, column) for column in rows.T]).T


def _lattice(
    parameters: FamilyParameters, grid: PixelGrid
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns, rows and distances [row, column] of pixels spread over the image."""
    u, v = (
        np.unique(np.linspace(0, count - 1, min(count, LATTICE)).round())
        for count in (grid.width_px, grid.height_px)
    )
    u, v = u.astype(int), v.astype(int)
    x, y = np.meshgrid(grid.x_mm()[u], grid.y_mm()[v])
    return u, v, parameters.pad().inside_distance_mm(np.stack([x, y], axis=-1))


def _is_far_inside(parameters: FamilyParameters, grid: PixelGrid) -> bool:
    """Whether nothing of the image is near the edge, as images usually are."""
    return bool(_lattice(parameters, grid)[2].min() >= EDGE_MM)


def looks_past_pad(parameters: FamilyParameters) -> bool:
    """Whether the sensor's own camera sees more than the pad in plan, as lenses in domes do."""
    return bool(_lattice(parameters, parameters.grid())[2].min() < 0)


def view_remarks(
    parameters: FamilyParameters, grid: PixelGrid, mask: np.ndarray | None = None
) -> list[Remark]:
    """What an image shows beside the pad, as far as it is used (``mask``): an error where that is
    too much, a warning where it is left out."""
    if _is_far_inside(parameters, grid):
        return []
    used = np.ones((grid.height_px, grid.width_px), dtype=bool) if mask is None else mask
    inside = inside_mm(parameters, grid)
    least = float(inside[used].min())
    if least >= EDGE_MM:
        return []
    size_x, size_y = np.ptp(parameters.pad().bounds_mm()[:, :2], axis=0)
    figures = {**_view(grid), "pad_x": size_x, "pad_y": size_y}
    if looks_past_pad(parameters):
        # Normals are read wherever its camera sees; a layer stands for the pad in plan alone.
        blocks = ("color",)
        return [SCALE_PAST_PAD(**figures, blocks=blocks)] if least < 0 else []
    if least < -OVERHANG_SHARE * max(size_x, size_y):
        return [SCALE_PAST_PAD(**figures)]
    share = float((inside[used] < EDGE_MM).mean())
    return [PAD_EDGE(**figures, share=share, edge=EDGE_MM, grave=least < 0)]


def pixels_on_pad(profile: SensorProfile, grid: PixelGrid, mask: np.ndarray) -> np.ndarray:
    """The usable pixels ``mask`` that the pad of ``profile`` covers, pressed too; bool, of its
    shape. A camera that sees past its pad by design keeps all."""
    parameters = profile_parameters(profile)
    if _is_far_inside(parameters, grid) or looks_past_pad(parameters):
        return mask
    return mask & (inside_mm(parameters, grid) >= EDGE_MM)


def require_view_on_pad(
    profile: SensorProfile, grid: PixelGrid, mask: np.ndarray | None, source: str, block: str
) -> None:
    """InputError where ``block`` cannot use an image of ``grid`` since it shows too much beside the
    pad."""
    for remark in view_remarks(profile_parameters(profile), grid, mask):
        if remark.severity == Severity.ERROR and block in remark.blocks:
            raise InputError(f"{source}: {remark.message}")
