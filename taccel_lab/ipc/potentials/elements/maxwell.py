# SPDX-License-Identifier: Apache-2.0
"""Relaxation of soft bodies: one branch of a generalised Maxwell solid, at finite strain.

    E = g V psi(F_e),  F_e = F F_v^-1

with psi the law of the solid, g the relative modulus of the branch and F_v its viscous deformation
[Reese and Govindjee 1998, A theory of finite viscoelasticity and numerical aspects]. F_v is a
constant of the step, so that E is an elastic energy: F_v^-1 alone distinguishes its kernels from
those of the solid. A turned body turns F_e from the left, of which psi depends on no turn.

When a step of length dt begins, F is held and F_e relaxes in its logarithm, which is exact there:

    F_v^-1  <-  F_v^-1 U_e^(a - 1),  U_e^2 = F_e^T F_e,  a = exp(-dt / tau)

[the exponential map: Weber and Anand 1990]. Logarithmic strains of F_e shrink by ``a``, of volume
and of shape alike, so that psi falls, whatever dt: a step dissipates, as the elastic step after it
does. Held strain relaxes exactly; a strain that grows is taken to grow at the end of the step,
which is of first order in dt. Steps that are taken again begin with F_v^-1 as it was left.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import warp as wp

from taccel_lab.bodies.element import Element
from taccel_lab.bodies.material import MaterialModel
from taccel_lab.bodies.maxwell import MaxwellBranch
from taccel_lab.ipc.device.launches import launch
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

wp.set_module_options({"enable_backward": False, "block_dim": STAGED_THREADS})

_LEAST_SQUARE = wp.constant(wp.float64(1e-12))
"""Smallest square of a stretch that is told from zero."""


@wp.func
def _relaxed(f: wp.mat33d, inverse: wp.mat33d, kept: wp.float64) -> wp.mat33d:
    """F_v^-1 after F was held until the part ``kept`` of the logarithmic strain is left; as it was
    where F is inside out, which has none."""
    elastic = f * inverse
    if kept == wp.float64(1.0) or not (wp.determinant(elastic) > wp.float64(0.0)):
        return inverse
    squares, v = symmetric_eigen_3x3(wp.transpose(elastic) * elastic)
    power = wp.float64(0.5) * (kept - wp.float64(1.0))
    shrink = wp.vec3d()
    for k in range(3):
        shrink[k] = wp.pow(wp.max(squares[k], _LEAST_SQUARE), power)
    return inverse * (v * wp.diag(shrink) * wp.transpose(v))


@wp.func
def _kept(dt: wp.float64, time: wp.float64, again: int) -> wp.float64:
    kept = wp.float64(1.0)
    if again == 0:
        kept = wp.exp(-dt / time)
    return kept


@wp.kernel
def _begin_linear_kernel(
    mask: wp.array(dtype=wp.int32),
    again: wp.array(dtype=wp.int32),
    positions: wp.array2d(dtype=wp.vec3d),
    kept_inverses: wp.array2d(dtype=wp.mat33d),
    first: int,
    dts: wp.array(dtype=wp.float64),
    time: wp.float64,
    d: ElementData,
    inverses: wp.array3d(dtype=wp.mat33d),  # out
    gradients: wp.array3d(dtype=wp.vec3d),  # out
):
    """F_v^-1 of the step, and F_v^-T b in place of the rest gradients b: F_e = sum_i x_i b_i^T."""
    env, tet = wp.tid()
    if mask[env] == 0:
        return
    f = linear_deformation(env, tet, positions, d)
    inverse = _relaxed(f, kept_inverses[env, first + tet], _kept(dts[env], time, again[env]))
    inverses[env, tet, 0] = inverse
    turn = wp.transpose(inverse)
    for i in range(4):
        gradients[env, tet, i] = turn * d.gradients[env % d.volumes.shape[0], tet, i]


@wp.kernel
def _begin_quadratic_kernel(
    mask: wp.array(dtype=wp.int32),
    again: wp.array(dtype=wp.int32),
    positions: wp.array2d(dtype=wp.vec3d),
    kept_inverses: wp.array2d(dtype=wp.mat33d),
    first: int,
    dts: wp.array(dtype=wp.float64),
    time: wp.float64,
    d: ElementData,
    inverses: wp.array3d(dtype=wp.mat33d),  # out
):
    env, tet, q = wp.tid()
    if mask[env] == 0:
        return
    f = quadratic_deformation(env, tet, q, positions, d)
    inverse = kept_inverses[env, first + tet * inverses.shape[2] + q]
    inverses[env, tet, q] = _relaxed(f, inverse, _kept(dts[env], time, again[env]))


@wp.kernel
def _keep_kernel(
    mask: wp.array(dtype=wp.int32),
    inverses: wp.array3d(dtype=wp.mat33d),
    first: int,
    kept_inverses: wp.array2d(dtype=wp.mat33d),  # out
):
    env, tet, q = wp.tid()
    if mask[env] != 0:
        kept_inverses[env, first + tet * inverses.shape[2] + q] = inverses[env, tet, q]


@wp.func
def _point_inverse(env: int, tet: int, q: int, d: ElementData) -> wp.mat33d:
    return d.starts[env, tet, q]


@cache
def _quadratic_kernels(model: MaterialModel) -> ElementKernels:
    """Those of the law at F F_v^-1."""
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
        eye = np.broadcast_to(
            np.eye(3), (envs, group.element_count, group.element.point_count, 3, 3)
        )
        self._inverses = wp.array(eye, dtype=wp.mat33d, device=device)
        self._solid = ElementData()
        self._solid.nodes, self._solid.volumes = group.elements, group.volumes
        self._solid.gradients = group.shape_gradients
        # Energies are linear in volume times moduli; the moduli stay those of the group.
        volumes = branch.relative_modulus * group.volumes.numpy()
        if self._quadratic:
            self.data.starts = self._inverses
        else:
            # Gradients differ by environment, and are looked up as volumes are.
            volumes = np.tile(volumes, (envs // len(volumes), 1))
            rest = np.tile(group.shape_gradients.numpy(), (envs // group.volumes.shape[0], 1, 1, 1))
            self.data.gradients = wp.array(rest, dtype=wp.vec3d, device=device)
        self.data.volumes = wp.array(volumes, dtype=wp.float64, device=device)

    def begin_step(
        self,
        positions: wp.array,
        kept_inverses: wp.array,
        dts: wp.array,
        mask: wp.array,
        again: wp.array,
    ) -> None:
        """Relax at the deformation of the start, in the environments of ``mask``.

        Args:
            positions: Nodes at the start [m], vec3d, [env_count, node_count].
            kept_inverses: ``State.viscous_inverses``; only read.
            dts: Length of the step [s], float64, [env_count].
            mask: int32, [env_count].
            again: Where the step before is taken again, and has relaxed, int32, [env_count].
        """
        quadratic = self._quadratic
        launch(
            _begin_quadratic_kernel if quadratic else _begin_linear_kernel,
            dim=self._inverses.shape if quadratic else self.energies.shape,
            inputs=[mask, again, positions, kept_inverses, self._first, dts]
            + [self._branch.time_s, self._solid],
            outputs=[self._inverses] if quadratic else [self._inverses, self.data.gradients],
            device=self.model.device,
        )

    def end_step(self, mask: wp.array, kept_inverses: wp.array) -> None:
        """Write F_v^-1 of the step to ``State.viscous_inverses``, in the environments of ``mask``
        (int32, [env_count])."""
        launch(
            _keep_kernel,
            dim=self._inverses.shape,
            inputs=[mask, self._inverses, self._first],
            outputs=[kept_inverses],
            device=self.model.device,
        )
