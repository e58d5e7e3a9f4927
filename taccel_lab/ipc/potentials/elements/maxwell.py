# SPDX-License-Identifier: Apache-2.0
"""Relaxation of soft bodies: one branch of a generalised Maxwell solid, at finite strain.

    E = c g V psi(F_e),  F_e = F F_v^-1

with psi the law of the solid, g the relative modulus of the branch and F_v its viscous deformation
[Reese and Govindjee 1998, A theory of finite viscoelasticity and numerical aspects]. F_v is a
constant of the step, so that E is an elastic energy: F_v^-1 alone distinguishes its kernels from
those of the solid. A turned body turns F_e from the left, of which psi depends on no turn.

At held F, logarithmic strains of F_e fade by exp(-t / tau) [the exponential map: Weber and Anand
1990]. A step of length dt does that in two parts, with h = dt / tau, a = exp(-h), c = (1 - a) / h:

    F_v^-1  <-  F_v^-1 U_e^(s - 1),  U_e^2 = F_e^T F_e

with s = a / c at the F where it begins, and s = c at the F where it ends. For small strains this is
exact where a strain grows evenly over the step [Simo and Hughes 1998, 10.3], however long that is;
otherwise of second order in dt. Both factors are below 1, and so is c: psi falls in both parts, a
step that ends where it began dissipates all that it should, and no step gains energy.

A step that is taken again to another end begins with the F_v^-1 that it had.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import warp as wp

from taccel_lab.bodies.bodies import Element
from taccel_lab.bodies.material import MaterialModel, MaxwellBranch
from taccel_lab.ipc.device.matrices import symmetric_eigen_3x3
from taccel_lab.ipc.potentials.elements.chunk_stage import STAGED_THREADS
from taccel_lab.ipc.potentials.elements.data import ElementData, ElementKernels, ElementSum
from taccel_lab.ipc.potentials.elements.elastic import elastic_kernels
from taccel_lab.ipc.potentials.elements.linear_kernels import linear_deformation
from taccel_lab.ipc.potentials.elements.point_stage import PointHessian
from taccel_lab.ipc.potentials.elements.quadratic_kernels import create_quadratic_kernels
from taccel_lab.ipc.potentials.elements.quadratic_points import elastic_point_law
from taccel_lab.ipc.potentials.elements.quadratic_shape import needs_none, quadratic_deformation
from taccel_lab.model import Model
from taccel_lab.model.elastic import ElementArrays
from taccel_lab.model.env_lists import EnvMask
from taccel_lab.model.launches import launch

wp.set_module_options({"enable_backward": False, "block_dim": STAGED_THREADS})

_LEAST_SQUARE = wp.constant(wp.float64(1e-12))
"""Smallest square of a stretch, whose power is finite."""


@wp.func
def _even_share(h: wp.float64) -> wp.float64:
    """c = (1 - exp(-h)) / h: what is left of a strain that grew evenly."""
    if h < wp.float64(1e-4):
        return wp.float64(1.0) - wp.float64(0.5) * h + h * h / wp.float64(6.0)
    return (wp.float64(1.0) - wp.exp(-h)) / h


@wp.func
def _relaxed(f: wp.mat33d, inverse: wp.mat33d, left: wp.float64) -> wp.mat33d:
    """F_v^-1 when the part ``left`` of the logarithmic strain is left; as it was where F is inside
    out, which has none."""
    elastic = f * inverse
    if not (wp.determinant(elastic) > wp.float64(0.0)):
        return inverse
    squares, v = symmetric_eigen_3x3(wp.transpose(elastic) * elastic)
    power = wp.float64(0.5) * (left - wp.float64(1.0))
    shrink = wp.vec3d()
    for k in range(3):
        shrink[k] = wp.pow(wp.max(squares[k], _LEAST_SQUARE), power)
    return inverse * (v * wp.diag(shrink) * wp.transpose(v))


@wp.kernel
def _begin_shares_kernel(
    mask: wp.array(dtype=wp.int32),
    again: wp.array(dtype=wp.int32),
    dts: wp.array(dtype=wp.float64),
    time: wp.float64,
    shares: wp.array(dtype=wp.float64),  # out
):
    env = wp.tid()
    if mask[env] != 0 and again[env] == 0:
        shares[env] = _even_share(dts[env] / time)


@wp.func
def _left_at_begin(dt: wp.float64, time: wp.float64, share: wp.float64) -> wp.float64:
    return wp.exp(-dt / time) / share


@wp.kernel
def _begin_linear_kernel(
    mask: wp.array(dtype=wp.int32),
    again: wp.array(dtype=wp.int32),
    positions: wp.array2d(dtype=wp.vec3d),
    kept_inverses: wp.array2d(dtype=wp.mat33d),
    first: int,
    dts: wp.array(dtype=wp.float64),
    time: wp.float64,
    modulus: wp.float64,
    solid: ElementData,
    inverses: wp.array3d(dtype=wp.mat33d),  # out
    gradients: wp.array3d(dtype=wp.vec3d),  # out
    volumes: wp.array2d(dtype=wp.float64),  # out
):
    """F_v^-1 of the step; F_v^-T b in place of the rest gradients b, as F_e = sum_i x_i b_i^T; and
    c g V in place of the volumes, which energies are linear in."""
    env, tet = wp.tid()
    if mask[env] == 0 or again[env] != 0:
        return
    share = _even_share(dts[env] / time)
    f = linear_deformation(env, tet, positions, solid)
    kept = kept_inverses[env, first + tet]
    inverse = _relaxed(f, kept, _left_at_begin(dts[env], time, share))
    inverses[env, tet, 0] = inverse
    turn = wp.transpose(inverse)
    rest = env % solid.volumes.shape[0]
    for i in range(4):
        gradients[env, tet, i] = turn * solid.gradients[rest, tet, i]
    volumes[env, tet] = share * modulus * solid.volumes[rest, tet]


@wp.kernel
def _begin_quadratic_kernel(
    mask: wp.array(dtype=wp.int32),
    again: wp.array(dtype=wp.int32),
    positions: wp.array2d(dtype=wp.vec3d),
    kept_inverses: wp.array2d(dtype=wp.mat33d),
    first: int,
    dts: wp.array(dtype=wp.float64),
    time: wp.float64,
    solid: ElementData,
    inverses: wp.array3d(dtype=wp.mat33d),  # out
):
    env, tet, q = wp.tid()
    if mask[env] == 0 or again[env] != 0:
        return
    left = _left_at_begin(dts[env], time, _even_share(dts[env] / time))
    f = quadratic_deformation(env, tet, q, positions, solid)
    kept = kept_inverses[env, first + tet * inverses.shape[2] + q]
    inverses[env, tet, q] = _relaxed(f, kept, left)


@wp.kernel
def _end_kernel(
    mask: wp.array(dtype=wp.int32),
    positions: wp.array2d(dtype=wp.vec3d),
    inverses: wp.array3d(dtype=wp.mat33d),
    first: int,
    shares: wp.array(dtype=wp.float64),
    solid: ElementData,
    kept_inverses: wp.array2d(dtype=wp.mat33d),  # out
):
    env, tet, q = wp.tid()
    if mask[env] == 0:
        return
    f = wp.mat33d()
    if inverses.shape[2] == 1:
        f = linear_deformation(env, tet, positions, solid)
    else:
        f = quadratic_deformation(env, tet, q, positions, solid)
    relaxed = _relaxed(f, inverses[env, tet, q], shares[env])
    kept_inverses[env, first + tet * inverses.shape[2] + q] = relaxed


@wp.func
def _share(env: int, tet: int, d: ElementData) -> wp.float64:
    return d.shares[env]


@wp.func
def _point_inverse(env: int, tet: int, q: int, d: ElementData) -> wp.mat33d:
    return d.starts[env, tet, q]


@cache
def _quadratic_kernels(model: MaterialModel) -> ElementKernels:
    """Kernels of the law at F F_v^-1."""
    law = elastic_point_law(model)
    law_energy, law_piola, law_hessian = law.energy, law.piola, law.hessian
    law_dilatation, law_slope = law.dilatation, law.dilatation_slope

    @wp.func
    def energy(f: wp.mat33d, start: wp.mat33d, d: ElementData, i: int) -> wp.float64:
        return law_energy(f * start, start, d, i)

    @wp.func
    def piola(f: wp.mat33d, start: wp.mat33d, d: ElementData, i: int) -> wp.mat33d:
        return law_piola(f * start, start, d, i) * wp.transpose(start)

    @wp.func
    def dilatation(f: wp.mat33d, start: wp.mat33d) -> wp.float64:
        return law_dilatation(f * start, start)

    @wp.func
    def dilatation_slope(f: wp.mat33d, start: wp.mat33d) -> wp.mat33d:
        return law_slope(f * start, start) * wp.transpose(start)

    @wp.func
    def hessian(
        f: wp.mat33d, start: wp.mat33d, d: ElementData, i: int, pressure: wp.float64, mode: int
    ) -> PointHessian:
        h = law_hessian(f * start, start, d, i, pressure, mode)
        h.frame = start * h.frame
        return h

    return create_quadratic_kernels(
        replace(
            law,
            name=f"maxwell.{law.name}",
            start=_point_inverse,
            scale=_share,
            energy=energy,
            piola=piola,
            dilatation=dilatation,
            dilatation_slope=dilatation_slope,
            hessian=hessian,
            # The solid's own energy has the guard.
            guarded=needs_none,
        )
    )


class MaxwellPotential(ElementSum):
    """One branch of one group of elements; not built unless its material has branches."""

    def __init__(
        self, model: Model, group: ElementArrays, branch: MaxwellBranch, first: int
    ) -> None:
        """``first``: of the branch's points in ``State.viscous_inverses``."""
        self._quadratic = group.element is Element.QUADRATIC
        kernels = (
            _quadratic_kernels(group.law)
            if self._quadratic
            else elastic_kernels(group.law, group.element)
        )
        super().__init__(model, group, kernels)
        self._branch, self._first = branch, first
        device, envs = model.device, model.env_count
        count, points = group.element_count, group.element.point_count
        eyes = np.broadcast_to(np.eye(3), (envs, count, points, 3, 3))
        self._inverses = wp.array(eyes, dtype=wp.mat33d, device=device)
        self._shares = wp.ones(envs, dtype=wp.float64, device=device)
        self._solid = ElementData()
        self._solid.nodes, self._solid.volumes = group.elements, group.volumes
        self._solid.gradients = group.shape_gradients
        # Energies are linear in volume times moduli; the moduli stay those of the group.
        if self._quadratic:
            self.data.starts, self.data.shares = self._inverses, self._shares
            volumes = branch.relative_modulus * group.volumes.numpy()
            self.data.volumes = wp.array(volumes, dtype=wp.float64, device=device)
        else:
            # Both differ by environment, and are looked up in one way.
            self.data.gradients = wp.zeros((envs, count, 4), dtype=wp.vec3d, device=device)
            self.data.volumes = wp.zeros((envs, count), dtype=wp.float64, device=device)

    def begin_step(
        self,
        positions: wp.array,
        kept_inverses: wp.array,
        dts: wp.array,
        mask: EnvMask,
        again: wp.array,
    ) -> None:
        """Relax at the deformation of the start, in the environments of ``mask``.

        Args:
            positions: Nodes at the start [m], vec3d, [env_count, node_count].
            kept_inverses: ``State.viscous_inverses``; only read.
            dts: Length of the step [s], float64, [env_count].
            mask: int32, [env_count].
            again: Where the step before is taken again, which goes on as it began, int32,
                [env_count].
        """
        branch = self._branch
        inputs = [mask, again, dts, branch.time_s, self._shares]
        launch(_begin_shares_kernel, self.model.env_count, *inputs)
        inputs = [mask, again, positions, kept_inverses, self._first, dts, branch.time_s]
        if self._quadratic:
            launch(
                _begin_quadratic_kernel, self._inverses.shape, *inputs, self._solid, self._inverses
            )
        else:
            arguments = [*inputs, branch.relative_modulus, self._solid, self._inverses]
            arguments += [self.data.gradients, self.data.volumes]
            launch(_begin_linear_kernel, self.energies.shape, *arguments)

    def end_step(self, positions: wp.array, kept_inverses: wp.array, mask: EnvMask) -> None:
        """Relax at the deformation of the end and write ``State.viscous_inverses``, in the
        environments of ``mask`` (int32, [env_count]).

        ``positions``: nodes at the end [m], vec3d, [env_count, node_count].
        """
        inputs = [mask, positions, self._inverses, self._first, self._shares, self._solid]
        launch(_end_kernel, self._inverses.shape, *inputs, kept_inverses)
