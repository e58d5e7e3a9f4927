# SPDX-License-Identifier: Apache-2.0
"""Elements that are inside out where their energy does not tell.

Some materials bear inversion: they may start inverted and come right, but a step that turns an
element inside out is no result. The energies of the others are infinite there, of quadratic tets
by their guard. How close a state came to that is said by its smallest volume ratio.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from taccel_lab.bodies.bodies import Element
from taccel_lab.bodies.material import MaterialModel
from taccel_lab.ipc.elasticity.volume_bounds import is_inside_out, least_corner, smallest_ratio
from taccel_lab.ipc.potentials.elements.data import ElementData, ElementSum
from taccel_lab.ipc.potentials.elements.linear_kernels import linear_deformation
from taccel_lab.ipc.potentials.elements.quadratic_shape import corner_deformation

wp.set_module_options({"enable_backward": False})

BEARS_INVERSION = (MaterialModel.STABLE_NEO_HOOKEAN, MaterialModel.ST_VENANT_KIRCHHOFF)
"""Materials whose energy is finite at inversion."""


@wp.kernel
def _linear_kernel(
    mask: wp.array(dtype=wp.int32),
    positions: wp.array2d(dtype=wp.vec3d),
    d: ElementData,
    inverted: wp.array(dtype=wp.int32),
):
    env, tet = wp.tid()
    if mask[env] == 0:
        return
    if not (wp.determinant(linear_deformation(env, tet, positions, d)) > wp.float64(0.0)):
        inverted[env] = 1


@wp.kernel
def _quadratic_kernel(
    mask: wp.array(dtype=wp.int32),
    positions: wp.array2d(dtype=wp.vec3d),
    d: ElementData,
    inverted: wp.array(dtype=wp.int32),
):
    env, tet = wp.tid()
    if mask[env] == 0:
        return
    f_0 = corner_deformation(env, tet, 0, positions, d)
    f_1 = corner_deformation(env, tet, 1, positions, d)
    f_2 = corner_deformation(env, tet, 2, positions, d)
    f_3 = corner_deformation(env, tet, 3, positions, d)
    if is_inside_out(f_0, f_1, f_2, f_3):
        inverted[env] = 1


def find_inversions(
    parts: Sequence[ElementSum], mask: wp.array, positions: wp.array, inverted: wp.array
) -> None:
    """Set ``inverted`` (int32, [env_count]) where an element of ``parts`` is inside out, in the
    environments of ``mask``; the other entries stay."""
    for part in parts:
        quadratic = part.group.element is Element.QUADRATIC
        kernel = _quadratic_kernel if quadratic else _linear_kernel
        part.launch(kernel, mask, positions, part.data, inverted)


@wp.kernel
def _corner_ratio_kernel(
    positions: wp.array2d(dtype=wp.vec3d), d: ElementData, ratios: wp.array2d(dtype=wp.float64)
):
    env, tet = wp.tid()
    ratios[env, tet] = least_corner(
        corner_deformation(env, tet, 0, positions, d),
        corner_deformation(env, tet, 1, positions, d),
        corner_deformation(env, tet, 2, positions, d),
        corner_deformation(env, tet, 3, positions, d),
    )


@wp.kernel
def _linear_ratio_kernel(
    positions: wp.array2d(dtype=wp.vec3d), d: ElementData, ratios: wp.array2d(dtype=wp.float64)
):
    env, tet = wp.tid()
    ratios[env, tet] = wp.determinant(linear_deformation(env, tet, positions, d))


@wp.kernel
def _quadratic_ratio_kernel(
    positions: wp.array2d(dtype=wp.vec3d),
    d: ElementData,
    known: wp.array(dtype=wp.float64),
    ratios: wp.array2d(dtype=wp.float64),
):
    env, tet = wp.tid()
    ratios[env, tet] = smallest_ratio(
        corner_deformation(env, tet, 0, positions, d),
        corner_deformation(env, tet, 1, positions, d),
        corner_deformation(env, tet, 2, positions, d),
        corner_deformation(env, tet, 3, positions, d),
        known[env],
    )


def smallest_ratios(parts: Sequence[ElementSum], positions: wp.array) -> np.ndarray:
    """Smallest det F anywhere in the elements of ``parts``, float64, [env_count]: above 0 where no
    element is inside out. That of curved tets is found within ``RATIO_SLACK``; few are searched, as
    most are bound to lie above the smallest corner."""
    smallest = np.full(positions.shape[0], np.inf)
    for part in parts:
        found = wp.empty_like(part.energies)
        if part.group.element is Element.QUADRATIC:
            part.launch(_corner_ratio_kernel, positions, part.data, found)
            known = np.minimum(smallest, found.numpy().min(axis=1))
            known = wp.array(known, dtype=wp.float64, device=found.device)
            part.launch(_quadratic_ratio_kernel, positions, part.data, known, found)
        else:
            part.launch(_linear_ratio_kernel, positions, part.data, found)
        smallest = np.minimum(smallest, found.numpy().min(axis=1))
    return smallest
