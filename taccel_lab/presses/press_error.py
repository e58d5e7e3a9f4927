# SPDX-License-Identifier: Apache-2.0
"""The error that presses of a grade state.

Three things part a press from the exact solution of its equations: the mesh, the range ``dhat`` at
which contact begins, and, with friction, the length of the steps. ``expected_error`` says how large
they are as a rule, from a battery of presses (docs/verification.md, Presses by default);
``press_within`` measures them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.geometry.press_mesh_options import DEFAULT_PRESS_MESH
from taccel_lab.scene import Ball, Element, TriangleMesh

if TYPE_CHECKING:
    from taccel_lab.presses.physics import PressPhysics

# What 19 of 20 presses of the battery keep to ---------------------------------------------------

MESH_SHARE = {Ball: 0.01, TriangleMesh: 0.05}
"""Of the force, by the default mesh: smooth tools, and tools that may have rims."""
HEIGHT_SHARE = {Ball: 0.005, TriangleMesh: 0.014}
"""Of the heights, root mean square, over the depth."""
LINEAR_SHARE = 0.6
"""Of the force by linear elements on the default mesh."""
MESH_ORDER, COARSE_ORDER, COARSE_HEIGHT_ORDER = 2, 5, 7
"""How errors fall with the number of elements along a side: on finer meshes than the default, and
those of force and heights on coarser ones."""
DHAT_SHARE, DHAT_POWER = 0.035, 0.6
"""Of the force, by dhat: a power of dhat over the depth."""
PATH_SHARE, PATH_STEP = {Ball: 0.03, TriangleMesh: 0.0}, 0.3
"""Of the force, by steps under friction 1 that are longer than that part of the depth; shorter ones
add less. Under rims the battery shows none."""


@dataclass(frozen=True)
class PressError:
    """Estimated discretisation error of presses."""

    force_n: np.ndarray
    """Of the force along the press [N], shape [env_count]."""
    height_m: np.ndarray
    """Of the heights of the contact face, root mean square [m], shape [env_count]."""


def tool_kind(shape: Ball | TriangleMesh) -> type[Ball] | type[TriangleMesh]:
    """That of smooth tools, or of tools that may have rims."""
    return Ball if isinstance(shape, Ball) else TriangleMesh


def expected_error(
    physics: PressPhysics,
    shape: Ball | TriangleMesh,
    force_n: np.ndarray,
    depth_m: np.ndarray,
    step_m: np.ndarray,
    friction: float,
) -> PressError:
    """What presses of these settings keep to in 19 of 20 cases, on meshes made for the press.

    Args:
        physics: Mesh, element and contact range.
        shape: What presses.
        force_n: Along the press [N], [env_count].
        depth_m: Past first touch [m], [env_count].
        step_m: Length of the last step [m], [env_count].
        friction: Largest coefficient.
    """
    mesh, usual = physics.mesh, DEFAULT_PRESS_MESH
    kind = tool_kind(shape)
    if kind is Ball:
        cells = mesh.cell_count / usual.cell_count
    else:
        cells = mesh.outline.cell_count / usual.outline.cell_count
    finer = cells ** (1 / 3)
    order, height_order = MESH_ORDER, MESH_ORDER
    if finer < 1:
        order, height_order = COARSE_ORDER, COARSE_HEIGHT_ORDER
    if physics.element is Element.LINEAR:
        by_mesh = LINEAR_SHARE / finer
    else:
        by_mesh = MESH_SHARE[kind] / finer**order
    depth = np.maximum(depth_m, 0.0)
    touched = np.maximum(depth, physics.dhat_m)
    dhat = DHAT_SHARE * (physics.dhat_m / touched) ** DHAT_POWER
    path = np.minimum(step_m / (PATH_STEP * touched), 1.0) * PATH_SHARE[kind] * min(friction, 1.0)
    return PressError(
        (by_mesh + dhat + path) * np.abs(force_n), HEIGHT_SHARE[kind] / finer**height_order * depth
    )
