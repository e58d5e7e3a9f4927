# SPDX-License-Identifier: Apache-2.0
"""Elements that are inside out where their energy does not tell.

Some materials bear inversion: they may start inverted and come right. Quadratic tets may be inside
out between their corners and quadrature points, where the energies of the others are infinite. A
step that turns an element inside out is no result.
"""

from __future__ import annotations

from collections.abc import Sequence

import warp as wp

from taccel_lab.bodies.element import Element
from taccel_lab.bodies.material import MaterialModel
from taccel_lab.ipc.elasticity.volume_bounds import is_inside_out
from taccel_lab.ipc.potentials.element_data import ElementData, ElementSum
from taccel_lab.ipc.potentials.linear_kernels import linear_deformation
from taccel_lab.ipc.potentials.quadratic_shape import corner_deformation

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


def may_hide_inversion(part: ElementSum) -> bool:
    """Whether elements may be inside out while their energy is finite."""
    return part.group.law in BEARS_INVERSION or part.group.element is Element.QUADRATIC


def find_inversions(
    parts: Sequence[ElementSum], mask: wp.array, positions: wp.array, inverted: wp.array
) -> None:
    """Set ``inverted`` (int32, [env_count]) where an element of ``parts`` is inside out, in the
    environments of ``mask``; the other entries stay."""
    for part in parts:
        quadratic = part.group.element is Element.QUADRATIC
        part.launch(
            _quadratic_kernel if quadratic else _linear_kernel,
            [mask, positions, part.data],
            [inverted],
        )
