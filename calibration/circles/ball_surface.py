# SPDX-License-Identifier: Apache-2.0
"""How the gel sinks around the balls of the captures, without a finite-element simulation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import RectBivariateSpline

from taccel_lab.calibration.capture.captures import CaptureSet, ContactCircle, check_radius
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import SensorProfile
from taccel_lab.reading.bonded_layer import (
    FAR_MM,
    BondedLayer,
    LayerPress,
    press_layer,
)
from taccel_lab.reading.slope_integration import border_of, plane_of
from taccel_lab.signals.normals import normals_from_slopes, slopes_from_height
from taccel_lab.signals.rest_surface import RestSurface
from taccel_lab.with_error import NORMAL_95

LARGEST_RADII = 0.985
"""Contacts up to the ball's equator are taken this much smaller: its slope has no bound there."""
RADIUS_TOLERANCE = 0.003
"""Share of the radius."""
MAX_TRIES = 12
POINTS_PER_RADIUS = 16
"""Points of the grid that a contact is solved on."""
LAYER_SHARE = 0.03
"""Share of a depth to which a ball's contact tells it. Finite elements with friction 1 and without
any go 5 % deeper and 2 to 4 % less deep than a layer where they touch as widely, from depths of a
quarter of the thickness on."""
RIM_STEPS = 0.15
"""A contact on a grid is wider than without one by this part of a step, since points beside it are
pressed for the part of them that touches: what 8 to 60 points per radius say of Hertz's contact and
of balls 0.3 to 1.6 mm in 4 mm (0.06 to 0.3)."""


@dataclass(frozen=True)
class BallSurface:
    """Deformed and undeformed contact face of the gel on the image's pixel grid, gel frame."""

    height_m: np.ndarray
    """z of the deformed contact face [m], shape [height_px, width_px]."""
    rest_height_m: np.ndarray
    """z of the undeformed contact face [m], shape [height_px, width_px]."""
    normals: np.ndarray
    """Outward unit normals of the deformed face, shape [height_px, width_px, 3]."""
    rest_normals: np.ndarray
    """Outward unit normals of the undeformed face, shape [height_px, width_px, 3]."""
    depth_mm: float
    """Travel of the indenter past first touch [mm]."""
    provider: str
    """What made the surface."""

    def displacement_mm(self) -> np.ndarray:
        """Rise of the face over its rest position [mm], negative below, shape [height, width]."""
        return (self.height_m - self.rest_height_m) * 1e3


def slope_of(normals: np.ndarray) -> np.ndarray:
    """dh/dx and dh/dy of outward normals, shape [..., 2]."""
    return -normals[..., :2] / np.maximum(normals[..., 2:], 1e-3)


def layer_of(profile: SensorProfile) -> BondedLayer:
    """The pad of a profile as a bonded layer."""
    nearly = min(profile.material.poisson_ratio, 0.4999)
    return BondedLayer(profile.gel.thickness_mm, nearly)


def layer_surfaces(
    captures: CaptureSet, circles: Sequence[ContactCircle], layer: BondedLayer, rest: RestSurface
) -> list[BallSurface]:
    """Surfaces of all presses on a pad, in order: the ball's shape in the contact, and what a
    bonded layer does around it.

    Raises:
        InputError: A circle that is larger than the ball.
    """
    balls = [press.radius_mm or captures.ball_radius_mm for press in captures.presses]
    for press, circle, ball_mm in zip(captures.presses, circles, balls, strict=True):
        check_radius(circle, captures.grid, ball_mm, f"{captures.source}: {press.name}")
    return [
        ball_surface(circle, ball_mm, captures.grid, layer, rest)
        for circle, ball_mm in zip(circles, balls, strict=True)
    ]


def ball_surface(
    circle: ContactCircle, ball_mm: float, grid: PixelGrid, layer: BondedLayer, rest: RestSurface
) -> BallSurface:
    """A layer, at rest as ``rest``, under a ball that touches it in ``circle``."""
    depth_mm, rise_mm = ball_in_layer(circle, ball_mm, grid, layer)
    slope = slopes_from_height(1e-3 * rise_mm, grid)
    return BallSurface(
        height_m=rest.height_m + 1e-3 * rise_mm,
        rest_height_m=rest.height_m,
        normals=normals_from_slopes(slope + slope_of(rest.normals)),
        rest_normals=rest.normals,
        depth_mm=depth_mm,
        provider=f"bonded layer of {layer.thickness_mm:g} mm, nu {layer.poisson_ratio:g}",
    )


def ball_in_layer(
    circle: ContactCircle, ball_mm: float, grid: PixelGrid, layer: BondedLayer
) -> tuple[float, np.ndarray]:
    """Depth [mm] at which a ball touches a layer in ``circle``, and the rise of the face then [mm],
    shape [height_px, width_px]."""
    wanted_mm = min(circle.radius_px * grid.mm_per_px_x, LARGEST_RADII * ball_mm)
    # Beyond the image too, so that a contact at its edge is whole.
    step = wanted_mm / POINTS_PER_RADIUS
    columns, rows = (
        np.arange(-1.5 * wanted_mm, count * pitch + 1.5 * wanted_mm, step) / pitch
        for count, pitch in (
            (grid.width_px, grid.mm_per_px_x),
            (grid.height_px, grid.mm_per_px_y),
        )
    )
    x = (columns - circle.u_px) * grid.mm_per_px_x
    y = (rows - circle.v_px) * grid.mm_per_px_y
    away2 = x[None, :] ** 2 + y[:, None] ** 2
    cap = ball_mm - np.sqrt(np.maximum(ball_mm**2 - away2, 0.0))
    tool = np.where(away2 < ball_mm**2, cap, FAR_MM)
    depth_mm, found = _pressed_to(wanted_mm, tool, step, ball_mm, layer)
    spline = RectBivariateSpline(rows, columns, found.rise_mm)
    return depth_mm, np.asarray(spline(np.arange(grid.height_px), np.arange(grid.width_px)))


def depth_share(
    presses: Sequence[tuple[BallSurface, ContactCircle]],
    radius_sigma_px: float,
    ball_mm: float,
    grid: PixelGrid,
    scale_share: float = 0.0,
    thickness_share: float = 0.0,
) -> float:
    """Standard deviation, as a share of the depth, of what a calibration on these presses takes as
    known, so that all its readings are off by it alike.

    A radius that is off by ``radius_sigma_px`` in all circles makes dents deeper as a whole: the
    ball's cap over the rim grows by ``a / sqrt(R^2 - a^2)`` for each millimetre of a, and what the
    rim has sunk by grows with the square of a, as in Hertz's contact. A scale that is off by
    ``scale_share`` turns slopes by that, and each is summed over pixels as much larger. Beside
    that contacts tell a depth to ``LAYER_SHARE``, and the gel's thickness, where it is known to an
    interval only, by ``thickness_share`` (``sunk_share``). Heights are counted from the border of
    the image, which a thick gel sinks at, too.
    """
    import torch

    deeper, border = [], []
    for surface, circle in presses:
        rise = torch.from_numpy(np.asarray(surface.displacement_mm(), dtype=np.float64))
        zero = plane_of(rise, border_of((grid.height_px, grid.width_px), rise))
        border.append(float(zero.ravel()[int(rise.argmin())]) / surface.depth_mm)
        rim_mm = min(circle.radius_px * grid.mm_per_px_x, LARGEST_RADII * ball_mm)
        per_mm = deeper_per_mm(rim_mm, ball_mm, surface.depth_mm)
        deeper.append(per_mm * radius_sigma_px * grid.mm_per_px_x / surface.depth_mm)
    by_circles, by_border = (
        float(np.sqrt(np.mean(np.square(shares)))) if shares else 0.0 for shares in (deeper, border)
    )
    return math.hypot(LAYER_SHARE, by_circles, by_border, 2 * scale_share, thickness_share)


def sunk_share(
    interval_mm: tuple[float, float], radius_mm: float, ball_mm: float, layer: BondedLayer
) -> float:
    """Standard deviation, as a share of the depth, by a thickness that is known to an interval of
    95 %, at a ball's contact of ``radius_mm``."""
    low, high = (
        depth_of_contact(radius_mm, ball_mm, replace(layer, thickness_mm=thickness))
        for thickness in interval_mm
    )
    return math.log(high / low) / 4


def depth_of_contact(radius_mm: float, ball_mm: float, layer: BondedLayer) -> float:
    """Depth [mm] at which a ball touches a layer in a circle of ``radius_mm``."""
    pitch = radius_mm / POINTS_PER_RADIUS
    side = 4 * POINTS_PER_RADIUS + 1
    grid, middle = PixelGrid(side, side, pitch, pitch), 2.0 * POINTS_PER_RADIUS
    circle = ContactCircle(middle, middle, float(POINTS_PER_RADIUS))
    return ball_in_layer(circle, ball_mm, grid, layer)[0]


def diameter_share(radius_mm: float, ball_mm: float, layer: BondedLayer) -> float:
    """Standard deviation, as a share of the depth, with which a 95 % interval reaches the depth
    that a ball half as large has at a contact of ``radius_mm``: for a radius that may be a
    diameter."""
    depths = [depth_of_contact(radius_mm, ball, layer) for ball in (ball_mm, ball_mm / 2)]
    return (depths[1] / depths[0] - 1.0) / NORMAL_95


def deeper_per_mm(rim_mm: float, ball_mm: float, depth_mm: float) -> float:
    """How much deeper a ball at ``depth_mm`` is for each millimetre that its contact is wider."""
    plane_mm = math.sqrt(ball_mm**2 - rim_mm**2)
    return rim_mm / plane_mm + 2 * (depth_mm - (ball_mm - plane_mm)) / rim_mm


def _pressed_to(
    wanted_mm: float, tool_mm: np.ndarray, step_mm: float, ball_mm: float, layer: BondedLayer
) -> tuple[float, LayerPress]:
    """Depth at which the contact has the wanted radius, and the layer then.

    The contact's area grows nearly in proportion to the depth, so that is the step.
    """
    depth = min(wanted_mm**2 / ball_mm, 0.5 * layer.thickness_mm)
    found = None
    for _ in range(MAX_TRIES):
        found = press_layer(tool_mm, depth, (step_mm, step_mm), layer, start=found)
        area = float(found.contact.sum()) * step_mm * step_mm
        radius = np.sqrt(max(area, step_mm * step_mm) / np.pi) - RIM_STEPS * step_mm
        if abs(radius - wanted_mm) < RADIUS_TOLERANCE * wanted_mm:
            break
        depth = min(depth * (wanted_mm / radius) ** 2, 0.95 * layer.thickness_mm)
    assert found is not None
    return depth, found
