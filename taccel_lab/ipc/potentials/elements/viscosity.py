# SPDX-License-Identifier: Apache-2.0
"""Viscous damping of soft bodies as an incremental potential of the strain rate (Kelvin-Voigt).

dt psi_v((E - E_n) / dt),  psi_v(R) = tau (mu R : R + lambda/2 (tr R)^2),  E = (F^T F - I) / 2

with E_n the Green strain at the start of the step [Simo and Hughes 1998, Computational
Inelasticity, chapter 10; as a dissipation potential in Brown et al. 2018, Accurate Dissipative
Forces in Optimization Integrators]. It resists the rate of strain only: rigid motion is free, and
momentum and angular momentum are kept. For small strains it is Rayleigh damping tau K. Its Hessian
is made definite by lifting the viscous stress: an upper bound, exact where that stress is tension.
Quadratic elements take tr R of its mean, as their elastic energy does, and so damp without locking.
"""

from __future__ import annotations

from functools import cache

import warp as wp

from taccel_lab.bodies.element import Element
from taccel_lab.ipc.device.launches import launch
from taccel_lab.ipc.device.matrices import matrix_column
from taccel_lab.ipc.elasticity.laws import Moduli, half_square, strain_trace_slope
from taccel_lab.ipc.elasticity.principal import lifted_matrix
from taccel_lab.ipc.elasticity.st_venant_kirchhoff import green_strain
from taccel_lab.ipc.potentials.elements.chunk_stage import (
    STAGED_THREADS,
    put_block,
    put_force,
    stage_blocks,
    stage_forces,
    sum_blocks,
    sum_forces,
)
from taccel_lab.ipc.potentials.elements.data import (
    ElementData,
    ElementKernels,
    ElementSum,
    modulus_index,
)
from taccel_lab.ipc.potentials.elements.linear_kernels import linear_deformation
from taccel_lab.ipc.potentials.elements.point_stage import PointHessian
from taccel_lab.ipc.potentials.elements.quadratic_kernels import (
    PointLaw,
    create_quadratic_kernels,
)
from taccel_lab.ipc.potentials.elements.quadratic_shape import (
    needs_none,
    quadratic_deformation,
)
from taccel_lab.model import Model
from taccel_lab.model.elastic import ElementArrays

wp.set_module_options({"enable_backward": False, "block_dim": STAGED_THREADS})


@wp.func
def _share(env: int, tet: int, d: ElementData) -> wp.float64:
    """tau / dt: what a strain gained in this step resists by, over what it is worth in energy."""
    return d.rates[env] * d.damping_times[tet]


@wp.func
def _linear_stress(gained: wp.mat33d, d: ElementData, env: int, tet: int) -> wp.mat33d:
    """Second Piola-Kirchhoff stress [Pa] of a strain gained in this step."""
    i = modulus_index(env, tet, d)
    volumetric = d.moduli.lam[i] * wp.trace(gained)
    eye = wp.identity(n=3, dtype=wp.float64)
    return _share(env, tet, d) * (wp.float64(2.0) * d.moduli.mu[i] * gained + volumetric * eye)


@wp.kernel
def _linear_start_kernel(
    mask: wp.array(dtype=wp.int32), positions: wp.array2d(dtype=wp.vec3d), d: ElementData
):
    env, tet, q = wp.tid()
    if mask:
        if mask[env] == 0:
            return
    d.starts[env, tet, q] = green_strain(linear_deformation(env, tet, positions, d))


@wp.kernel
def _viscous_energy_kernel(
    active: wp.array(dtype=wp.int32),
    positions: wp.array2d(dtype=wp.vec3d),
    d: ElementData,
    energies: wp.array2d(dtype=wp.float64),
):
    env, tet = wp.tid()
    if active[env] == 0:
        return
    f = linear_deformation(env, tet, positions, d)
    gained = green_strain(f) - d.starts[env, tet, 0]
    volume = d.volumes[env % d.volumes.shape[0], tet]
    stress = _linear_stress(gained, d, env, tet)
    energies[env, tet] = wp.float64(0.5) * volume * wp.ddot(stress, gained)


@wp.kernel
def _viscous_gradient_kernel(
    active: wp.array(dtype=wp.int32),
    positions: wp.array2d(dtype=wp.vec3d),
    d: ElementData,
    parts: wp.array2d(dtype=wp.vec3d),
):
    env, lane = wp.tid()
    if active[env] == 0:
        return
    stage = stage_forces()
    tet = d.lanes[lane]
    if tet >= 0:
        rest = env % d.volumes.shape[0]
        f = linear_deformation(env, tet, positions, d)
        gained = green_strain(f) - d.starts[env, tet, 0]
        p = d.volumes[rest, tet] * (f * _linear_stress(gained, d, env, tet))
        for i in range(4):
            put_force(stage, lane, i, p * d.gradients[rest, tet, i])
    sum_forces(stage, env, lane, d.force_sums, parts)


@wp.kernel
def _viscous_hessian_kernel(
    active: wp.array(dtype=wp.int32),
    positions: wp.array2d(dtype=wp.vec3d),
    d: ElementData,
    psd_modes: wp.array(dtype=wp.int32),
    parts: wp.array2d(dtype=wp.mat33d),
):
    env, lane = wp.tid()
    if active[env] == 0:
        return
    stage = stage_blocks()
    tet = d.lanes[lane]
    if tet >= 0:
        rest = env % d.volumes.shape[0]
        f = linear_deformation(env, tet, positions, d)
        gained = green_strain(f) - d.starts[env, tet, 0]
        stress = lifted_matrix(_linear_stress(gained, d, env, tet), psd_modes[env])
        at = modulus_index(env, tet, d)
        mu = _share(env, tet, d) * d.moduli.mu[at]
        lam = _share(env, tet, d) * d.moduli.lam[at]
        left = f * wp.transpose(f)
        eye = wp.identity(n=3, dtype=wp.float64)
        k = int(0)
        for i in range(4):
            b_i = d.gradients[rest, tet, i]
            a_i = f * b_i
            for j in range(i, 4):
                b_j = d.gradients[rest, tet, j]
                a_j = f * b_j
                block = (
                    wp.dot(b_i, stress * b_j) * eye
                    + mu * (wp.dot(b_i, b_j) * left + wp.outer(a_j, a_i))
                    + lam * wp.outer(a_i, a_j)
                )
                put_block(stage, lane, k, d.volumes[rest, tet] * block)
                k += 1
    sum_blocks(stage, env, lane, d.block_sums, parts)


@wp.kernel
def _quadratic_start_kernel(
    mask: wp.array(dtype=wp.int32), positions: wp.array2d(dtype=wp.vec3d), d: ElementData
):
    env, tet, q = wp.tid()
    if mask:
        if mask[env] == 0:
            return
    d.starts[env, tet, q] = green_strain(quadratic_deformation(env, tet, q, positions, d))


@wp.func
def _point_start(env: int, tet: int, q: int, d: ElementData) -> wp.mat33d:
    return d.starts[env, tet, q]


@wp.func
def _point_modulus(m: Moduli, i: int) -> wp.float64:
    return m.lam[i]


@wp.func
def _point_energy(f: wp.mat33d, start: wp.mat33d, d: ElementData, i: int) -> wp.float64:
    gained = green_strain(f) - start
    return d.moduli.mu[i] * wp.ddot(gained, gained)


@wp.func
def _point_piola(f: wp.mat33d, start: wp.mat33d, d: ElementData, i: int) -> wp.mat33d:
    return f * (wp.float64(2.0) * d.moduli.mu[i] * (green_strain(f) - start))


@wp.func
def _point_dilatation(f: wp.mat33d, start: wp.mat33d) -> wp.float64:
    return wp.trace(green_strain(f) - start)


@wp.func
def _point_slope(f: wp.mat33d, start: wp.mat33d) -> wp.mat33d:
    return strain_trace_slope(f)


@wp.func
def _point_hessian(
    f: wp.mat33d, start: wp.mat33d, d: ElementData, i: int, pressure: wp.float64, mode: int
) -> PointHessian:
    eye = wp.identity(n=3, dtype=wp.float64)
    mu = d.moduli.mu[i]
    gained = green_strain(f) - start
    stress = lifted_matrix(wp.float64(2.0) * mu * gained + pressure * eye, mode)
    left = mu * (f * wp.transpose(f))
    f_0 = matrix_column(f, 0)
    f_1 = matrix_column(f, 1)
    f_2 = matrix_column(f, 2)
    h = PointHessian()
    h.frame = eye
    h.k_00 = stress[0, 0] * eye + left + mu * wp.outer(f_0, f_0)
    h.k_11 = stress[1, 1] * eye + left + mu * wp.outer(f_1, f_1)
    h.k_22 = stress[2, 2] * eye + left + mu * wp.outer(f_2, f_2)
    h.k_01 = stress[0, 1] * eye + mu * wp.outer(f_1, f_0)
    h.k_02 = stress[0, 2] * eye + mu * wp.outer(f_2, f_0)
    h.k_12 = stress[1, 2] * eye + mu * wp.outer(f_2, f_1)
    return h


@wp.kernel
def _reciprocal_kernel(dts: wp.array(dtype=wp.float64), rates: wp.array(dtype=wp.float64)):
    env = wp.tid()
    rates[env] = wp.float64(1.0) / dts[env]


@cache
def _quadratic_kernels() -> ElementKernels:
    return create_quadratic_kernels(
        PointLaw(
            name="viscous",
            start=_point_start,
            energy=_point_energy,
            piola=_point_piola,
            dilatation=_point_dilatation,
            dilatation_slope=_point_slope,
            volumetric=half_square,
            volumetric_modulus=_point_modulus,
            scale=_share,
            hessian=_point_hessian,
            guarded=needs_none,
        )
    )


_LINEAR = ElementKernels(_viscous_energy_kernel, _viscous_gradient_kernel, _viscous_hessian_kernel)


class ViscousPotential(ElementSum):
    """Damping of one group of elements; not built unless its material has a damping time.

    ``energies`` is half of what each element dissipates in the step [J].
    """

    def __init__(self, model: Model, group: ElementArrays) -> None:
        quadratic = group.element is Element.QUADRATIC
        super().__init__(model, group, _quadratic_kernels() if quadratic else _LINEAR)
        self._start = _quadratic_start_kernel if quadratic else _linear_start_kernel
        device, point_count = model.device, group.element.point_count
        self.data.damping_times = group.damping_times
        self.data.starts = wp.zeros(
            (*self.energies.shape, point_count), dtype=wp.mat33d, device=device
        )
        self.data.rates = wp.zeros(model.env_count, dtype=wp.float64, device=device)

    def begin_step(
        self, positions: wp.array, dts: wp.array | None = None, mask: wp.array | None = None
    ) -> None:
        """Strains gained from here on are resisted, in the environments of ``mask`` (int32,
        [env_count]); in all when None.

        ``dts``: length of the step [s], float64, shape [env_count]; the scene's when None.
        """
        m = self.model
        if dts is None:
            self.data.rates.fill_(1.0 / m.scene.time.dt_s)
        else:
            launch(_reciprocal_kernel, m.env_count, inputs=[dts, self.data.rates], device=m.device)
        launch(
            self._start,
            dim=self.data.starts.shape,
            inputs=[mask, positions, self.data],
            device=m.device,
        )
