# SPDX-License-Identifier: Apache-2.0
"""Matrices at quadrature points of ten-node tets, and their sums over an element.

Second derivatives of an energy density at a point, in the form that shape functions multiply.

Matrices of ten-node tets, added up over their quadrature points before anything is written.

A lane evaluates one of the four points of an element and lays its second derivatives down in shared
memory; then the lanes of the warp take the 55 blocks of its eight elements in turn, each the sum
over the points. Added up in memory, element by element by one thread each, the blocks of 64 presses
of 1,152 elements took 3.5 ms on an H200, of which writing them once is 0.1. The CPU, where one
thread is all lanes one after the other, lays the points down in memory that stays in its cache,
and adds them up after the last lane.

For kernels over (environment, lane) with four lanes an element in modules that state
``STAGED_THREADS``. All lanes of a warp come to the sum, also those that have no element.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.device.matrices import matrix_column
from taccel_lab.ipc.device.native import native
from taccel_lab.ipc.elasticity.principal import PrincipalHessian, exact_block
from taccel_lab.ipc.potentials.elements.quadratic_shape import mat103d

wp.set_module_options({"enable_backward": False})


@wp.struct
class PointHessian:
    """Second derivatives of an energy density [Pa]: of F = sum_a x_a g_a^T the block of nodes a, b
    is sum_kl (frame^T g_a)_k k_kl (frame^T g_b)_l, with k_lk = k_kl^T."""

    frame: wp.mat33d
    k_00: wp.mat33d
    k_01: wp.mat33d
    k_02: wp.mat33d
    k_11: wp.mat33d
    k_12: wp.mat33d
    k_22: wp.mat33d


@wp.func
def _diagonal_block(h: PrincipalHessian, k: int) -> wp.mat33d:
    direct = wp.vec3d(h.direct[0, k], h.direct[1, k], h.direct[2, k])
    return h.u * wp.diag(direct) * wp.transpose(h.u)


@wp.func
def _coupling_block(h: PrincipalHessian, k: int, m: int) -> wp.mat33d:
    u_k = matrix_column(h.u, k)
    u_m = matrix_column(h.u, m)
    return h.stretch[k, m] * wp.outer(u_k, u_m) + h.swap[k, m] * wp.outer(u_m, u_k)


@wp.func
def point_hessian(p: PrincipalHessian) -> PointHessian:
    """The blocks of a principal Hessian, in its frame V."""
    h = PointHessian()
    h.frame = p.v
    h.k_00 = _diagonal_block(p, 0)
    h.k_11 = _diagonal_block(p, 1)
    h.k_22 = _diagonal_block(p, 2)
    h.k_01 = _coupling_block(p, 0, 1)
    h.k_02 = _coupling_block(p, 0, 2)
    h.k_12 = _coupling_block(p, 1, 2)
    return h


@wp.func
def exact_point_hessian(f: wp.mat33d, curvatures: wp.vec3d) -> PointHessian:
    """The blocks of curvatures as in ``elasticity.principal``, in the frame of the gradients."""
    c = curvatures[1]
    e = curvatures[2]
    inverse = wp.transpose(wp.inverse(f))
    g_0 = matrix_column(inverse, 0)
    g_1 = matrix_column(inverse, 1)
    g_2 = matrix_column(inverse, 2)
    none = wp.float64(0.0)
    h = PointHessian()
    h.frame = wp.identity(n=3, dtype=wp.float64)
    h.k_00 = exact_block(c, e, curvatures[0], g_0, g_0)
    h.k_11 = exact_block(c, e, curvatures[0], g_1, g_1)
    h.k_22 = exact_block(c, e, curvatures[0], g_2, g_2)
    h.k_01 = exact_block(c, e, none, g_0, g_1)
    h.k_02 = exact_block(c, e, none, g_0, g_2)
    h.k_12 = exact_block(c, e, none, g_1, g_2)
    return h


POINT_LANES = 4
"""Lanes of an element, one a quadrature point."""

_SIZES = native("point_stage", "sizes")


@wp.func_native(native("point_stage", "stage_points"))
def stage_points() -> wp.uint64:
    """Where the lanes of a warp lay down their points."""
    ...


@wp.func_native(native("point_stage", "opens_element"))
def opens_element(lane: int) -> bool:
    """Whether a lane evaluates what the points of its element share: all do on a GPU, the first one
    on the CPU."""
    ...


@wp.func_native(native("point_stage", "keep"))
def keep(stage: wp.uint64, common: wp.mat33d, volume_part: wp.vec3d) -> None:
    """Keep for the other lanes of an element what the one that opens it has evaluated."""
    ...


@wp.func_native(native("point_stage", "kept_common"))
def kept_common(stage: wp.uint64) -> wp.mat33d:
    """What ``keep`` kept."""
    ...


@wp.func_native(native("point_stage", "kept_volume_part"))
def kept_volume_part(stage: wp.uint64) -> wp.vec3d:
    """What ``keep`` kept."""
    ...


@wp.func_native(native("point_stage", "put_point", SIZES=_SIZES))
def put_point(stage: wp.uint64, lane: int, h: PointHessian, shapes: mat103d) -> None:
    """Lay down the second derivatives at a point and the shape gradients in their frame."""
    ...


@wp.func_native(native("point_stage", "put_element", SIZES=_SIZES))
def put_element(
    stage: wp.uint64, lane: int, weight: wp.float64, bulk: wp.float64, slope: mat103d
) -> None:
    """Lay down the weight of the points of an element [m^3], and ``bulk`` [J] of the outer product
    of ``slope`` with itself that is added to them."""
    ...


@wp.func_native(native("point_stage", "write_blocks", SIZES=_SIZES))
def write_blocks(
    stage: wp.uint64, env: int, lane: int, blocks: wp.array3d(dtype=wp.mat33d)
) -> None:
    """Write the blocks of the elements of a warp, pairs (a, b) of nodes with a <= b in rows, shape
    [env_count, element_count, 55]."""
    ...


@wp.func_native(native("point_stage", "written_elements"))
def written_elements(lane: int, count: int) -> wp.vec2i:
    """Elements, of ``count``, to whose blocks a lane may add after ``write_blocks``."""
    ...
