# SPDX-License-Identifier: Apache-2.0
"""The contact face at the end of a press, finer than the mesh: the object's surface where it
touches, the gel's elsewhere (``FineSurface``)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import warp as wp

from taccel_lab.camera.gel_camera import View
from taccel_lab.geometry import PixelGrid
from taccel_lab.presses.indenter import Indenter
from taccel_lab.presses.press_env import PressEnv
from taccel_lab.signals.fine_surface import FineSurface
from taccel_lab.signals.normals import normals_from_slopes
from taccel_lab.signals.rest_surface import RestSurface
from taccel_lab.signals.tactile import SignalTactile


@dataclass(frozen=True)
class PressSurface:
    """Pixels of one environment of a press; NaN outside the pad."""

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


@dataclass(frozen=True)
class FurtherView:
    """Another camera that looks at a press."""

    camera: View
    designed_rest: RestSurface | None = None
    """See ``simulate_press``, on this camera's pixels over the gel."""


def press_surface(
    env: PressEnv,
    indenter: Indenter,
    grid: View,
    designed_rest: RestSurface | None = None,
    number: int = 0,
) -> PressSurface:
    """What the pixels of ``grid``, or of a camera, show of environment ``number`` of a press that
    has converged; at rest, of the points that they show now.

    ``designed_rest``: see ``simulate_press``.
    """
    fine = FineSurface(
        env.solver,
        indenter.name,
        grid,
        texture=indenter.texture,
        designed_rest=designed_rest,
        env_count=1,
    )
    signal = SignalTactile.from_solver(env.solver, grid, fine=fine)
    signal.update(env.state, who=np.arange(env.model.env_count) == number)
    height, normals, contact = (
        array.numpy()[0] for array in signal.read("height_m", "normals", "contact")
    )
    rest = signal.rest_samples().numpy()[0].astype(np.float64)
    return PressSurface(
        height_m=height.astype(np.float64),
        rest_height_m=rest[..., 2],
        normals=normals.astype(np.float64),
        rest_normals=normals_from_slopes(rest[..., :2]),
        contact_mask=contact.astype(bool),
        contact_radius_m=math.sqrt(fine.contact_area_m2[number] / math.pi),
        fine_force_n=None if indenter.texture is None else fine.pressed_n,
    )


def contact_radii_m(
    env: PressEnv, indenter: Indenter, grid: PixelGrid, frames: np.ndarray, points: int = 1
) -> np.ndarray:
    """Radii of the discs of the contacts' areas of a press that has converged [m], [env_count].

    Args:
        env: The press.
        indenter: Its indenter.
        grid: Pixels, about the origin of the frames, that hold the contacts.
        frames: gel_from_frame in which each contact is looked at along z, [env_count, 7].
        points: Samples along each side of a pixel.
    """
    fine = FineSurface(env.solver, indenter.name, grid, texture=indenter.texture, points=points)
    signal = SignalTactile.from_solver(env.solver, grid, fine=fine)
    seen = wp.array(frames, dtype=wp.transformd, device=env.model.device)
    signal.update(env.state, seen)
    signal.read("contact")
    return np.sqrt(fine.contact_area_m2 / np.pi)
