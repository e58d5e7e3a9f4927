# SPDX-License-Identifier: Apache-2.0
"""The contact face at the end of a press, finer than the mesh: the object's surface where it
touches, the gel's elsewhere."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from taccel_lab.envs.indenter import Indenter
from taccel_lab.envs.press import PressEnv
from taccel_lab.geometry import PixelGrid
from taccel_lab.scene import Ball
from taccel_lab.signals.fine_surface import FineSurface
from taccel_lab.signals.normals import normals_from_slopes
from taccel_lab.signals.rest_surface import RestCorrection, RestSurface
from taccel_lab.signals.rigid_surface import HeightFieldSurface, SphereSurface
from taccel_lab.signals.surface_fusion import SignalFusedSurface
from taccel_lab.signals.tactile import SignalTactile

SAMPLE_MM = 0.02
"""Distance at most at which tools with edges are sampled, at least twice across a pixel. With 0.06
mm, that of the pixels, the ridge of a prism was cut off by 20 um and its walls were ragged."""

FAR_M = 1e-3
"""What of a tool lies further above the gel is not looked at: the edge of a contact is where gaps
begin, and those of a flange 10 mm behind a stamp seemed to begin all over it."""


@dataclass(frozen=True)
class PressSurface:
    """Pixels of the first environment of a press; NaN outside the pad."""

    height_m: np.ndarray
    """z of the contact face [m], shape [height_px, width_px]."""
    rest_height_m: np.ndarray
    normals: np.ndarray
    """Outward unit normals, shape [height_px, width_px, 3]."""
    rest_normals: np.ndarray
    contact_mask: np.ndarray
    """Pixels in contact, bool."""
    contact_radius_m: float
    """Radius of the disc of the contact's area [m]."""
    fine_force_n: float | None = None
    """Force against the press of the contact with a texture [N]; None without one."""


def press_surface(
    env: PressEnv,
    indenter: Indenter,
    grid: PixelGrid,
    pressures_pa: np.ndarray,
    designed_rest: RestSurface | None = None,
) -> PressSurface:
    """What ``grid`` shows of a press that has converged.

    ``pressures_pa``: at the nodes of the gel, [env_count, node_count]. ``designed_rest``: see
    ``simulate_press``.
    """
    if indenter.texture is not None:
        return _textured(env, indenter, grid, designed_rest)
    shape, device = indenter.shape, env.model.device
    points = 1 if isinstance(shape, Ball) else points_across_pixel(grid)
    seen = SignalFusedSurface(
        env.mesh, grid, designed_rest=designed_rest, points=points, device=str(device)
    )
    if isinstance(shape, Ball):
        surface = SphereSurface(env.poses[0, 0, :3], shape.radius_m, seen.sample_grid)
    else:
        vertices = env.state.positions.numpy()[:, env.model.soft_count :].copy()
        whole = HeightFieldSurface.from_mesh(vertices, shape.faces, seen.sample_grid)
        surface = whole.up_to(float(env.positions[..., 2].max()) + FAR_M)
    seen.update(env.positions, surface, pressures_pa)
    return PressSurface(
        height_m=seen.height_m[0],
        rest_height_m=seen.rest_height_m,
        normals=seen.normals[0],
        rest_normals=seen.rest_normals,
        contact_mask=seen.contact_mask[0],
        contact_radius_m=float(seen.contact_radius_m[0]),
    )


def points_across_pixel(grid: PixelGrid) -> int:
    """Samples along each side of a pixel of the image of a tool with edges."""
    return max(2, math.ceil(max(grid.mm_per_px_x, grid.mm_per_px_y) / SAMPLE_MM))


def _textured(
    env: PressEnv, indenter: Indenter, grid: PixelGrid, designed_rest: RestSurface | None
) -> PressSurface:
    count = env.model.env_count
    fine = FineSurface(
        env.solver, indenter.name, grid, texture=indenter.texture, env_count=min(count, 1)
    )
    signal = SignalTactile.from_solver(env.solver, grid, fine=fine)
    signal.update(env.state, who=np.arange(count) == 0)
    height, normals, contact, pressure = (
        array.numpy()[0].astype(np.float64)
        for array in signal.read("height_m", "normals", "contact", "pressure_pa")
    )
    rest = fine.rest_samples.numpy().astype(np.float64)
    mask, slope = contact > 0, -normals[..., :2] / normals[..., 2:]
    rest_height, rest_slope = rest[..., 2], rest[..., :2]
    if designed_rest is not None:
        correction = RestCorrection.of(designed_rest, rest_height, rest_slope)
        rest_height, rest_slope = correction.corrected(rest_height, rest_slope)
        height, slope = correction.corrected(height, slope, mask)
    pixel_m2 = 1e-6 * grid.mm_per_px_x * grid.mm_per_px_y
    return PressSurface(
        height_m=height,
        rest_height_m=rest_height,
        normals=normals_from_slopes(slope),
        rest_normals=normals_from_slopes(rest_slope),
        contact_mask=mask,
        contact_radius_m=math.sqrt(mask.sum() * pixel_m2 / math.pi),
        fine_force_n=float(pressure.sum() * pixel_m2),
    )
