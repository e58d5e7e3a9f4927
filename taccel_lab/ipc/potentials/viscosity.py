# SPDX-License-Identifier: Apache-2.0
"""Viscous damping of a soft body as an incremental potential of the strain rate (Kelvin-Voigt).

dt psi_v((E - E_n) / dt),  psi_v(R) = tau (mu R : R + lambda/2 (tr R)^2),  E = (F^T F - I) / 2

with E_n the Green strain at the start of the step [Simo and Hughes 1998, Computational
Inelasticity, chapter 10; as a dissipation potential in Brown et al. 2018, Accurate Dissipative
Forces in Optimization Integrators]. It resists the rate of strain only: rigid motion is free, and
momentum and angular momentum are kept. For small strains it is Rayleigh damping tau K. Its Hessian
is made definite by lifting the viscous stress: an upper bound, exact where that stress is tension.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.ipc.elasticity.principal import lifted_matrix
from taccel_lab.ipc.elasticity.st_venant_kirchhoff import green_strain
from taccel_lab.ipc.potentials.elastic_kernels import (
    create_elastic_kernels,
    deformation_gradient,
    gathered_block,
)
from taccel_lab.ipc.reduce import sum_rows
from taccel_lab.model import Model

wp.set_module_options({"enable_backward": False})


@wp.struct
class Damper:
    """What all kernels read."""

    tets: wp.array(dtype=wp.vec4i)
    shape_gradients: wp.array3d(dtype=wp.vec3d)
    volumes: wp.array2d(dtype=wp.float64)
    mu: wp.array(dtype=wp.float64)
    lam: wp.array(dtype=wp.float64)
    start_strains: wp.array2d(dtype=wp.mat33d)
    """Green strain at the start of the step, shape [env_count, tet_count]."""
    rate: wp.float64
    """tau / dt: viscous over elastic stress for the same strain."""


@wp.func
def viscous_stress(strain: wp.mat33d, d: Damper, tet: int) -> wp.mat33d:
    """Second Piola-Kirchhoff stress [Pa] of a strain gained in this step."""
    volumetric = d.rate * d.lam[tet] * wp.trace(strain)
    return wp.float64(2.0) * d.rate * d.mu[tet] * strain + volumetric * wp.identity(
        n=3, dtype=wp.float64
    )


@wp.kernel
def _start_strain_kernel(positions: wp.array2d(dtype=wp.vec3d), d: Damper):
    env, tet = wp.tid()
    rest = env % d.volumes.shape[0]
    f = deformation_gradient(env, rest, tet, d.tets[tet], positions, d.shape_gradients)
    d.start_strains[env, tet] = green_strain(f)


@wp.kernel
def _tet_energy_kernel(
    active: wp.array(dtype=wp.int32),
    positions: wp.array2d(dtype=wp.vec3d),
    d: Damper,
    energies: wp.array2d(dtype=wp.float64),
):
    env, tet = wp.tid()
    if active[env] == 0:
        return
    rest = env % d.volumes.shape[0]
    f = deformation_gradient(env, rest, tet, d.tets[tet], positions, d.shape_gradients)
    gained = green_strain(f) - d.start_strains[env, tet]
    stress = viscous_stress(gained, d, tet)
    energies[env, tet] = wp.float64(0.5) * d.volumes[rest, tet] * wp.ddot(stress, gained)


@wp.kernel
def _tet_gradient_kernel(
    active: wp.array(dtype=wp.int32),
    positions: wp.array2d(dtype=wp.vec3d),
    d: Damper,
    corner_gradients: wp.array3d(dtype=wp.vec3d),
):
    env, tet = wp.tid()
    if active[env] == 0:
        return
    rest = env % d.volumes.shape[0]
    f = deformation_gradient(env, rest, tet, d.tets[tet], positions, d.shape_gradients)
    gained = green_strain(f) - d.start_strains[env, tet]
    p = d.volumes[rest, tet] * (f * viscous_stress(gained, d, tet))
    for i in range(4):
        corner_gradients[env, tet, i] = p * d.shape_gradients[rest, tet, i]


@wp.kernel
def _tet_hessian_kernel(
    active: wp.array(dtype=wp.int32),
    positions: wp.array2d(dtype=wp.vec3d),
    d: Damper,
    psd_mode: int,
    blocks: wp.array3d(dtype=wp.mat33d),
):
    env, tet = wp.tid()
    if active[env] == 0:
        return
    rest = env % d.volumes.shape[0]
    f = deformation_gradient(env, rest, tet, d.tets[tet], positions, d.shape_gradients)
    gained = green_strain(f) - d.start_strains[env, tet]
    stress = lifted_matrix(viscous_stress(gained, d, tet), psd_mode)
    mu = d.rate * d.mu[tet]
    lam = d.rate * d.lam[tet]
    left = f * wp.transpose(f)
    eye = wp.identity(n=3, dtype=wp.float64)
    k = int(0)
    for i in range(4):
        b_i = d.shape_gradients[rest, tet, i]
        a_i = f * b_i
        for j in range(i, 4):
            b_j = d.shape_gradients[rest, tet, j]
            a_j = f * b_j
            block = (
                wp.dot(b_i, stress * b_j) * eye
                + mu * (wp.dot(b_i, b_j) * left + wp.outer(a_j, a_i))
                + lam * wp.outer(a_i, a_j)
            )
            blocks[env, tet, k] = d.volumes[rest, tet] * block
            k += 1


@wp.kernel
def _add_blocks_kernel(
    active: wp.array(dtype=wp.int32),
    source_starts: wp.array(dtype=wp.int32),
    sources: wp.array(dtype=wp.int32),
    element_blocks: wp.array3d(dtype=wp.mat33d),
    values: wp.array2d(dtype=wp.mat33d),
):
    env, block = wp.tid()
    if active[env] == 0:
        return
    values[env, block] = gathered_block(
        env, block, source_starts, sources, element_blocks, values[env, block]
    )


class ViscousPotential:
    """Damping of the soft body; not built unless its material has a damping time."""

    def __init__(self, model: Model) -> None:
        self.model = model
        e, device = model.elastic, model.device
        material = model.scene.soft_body.material
        self._gather_gradient = create_elastic_kernels(material.model).gather_gradient
        shape = (model.env_count, e.tets.shape[0])
        d = Damper()
        d.tets, d.shape_gradients, d.volumes = e.tets, e.shape_gradients, e.volumes
        d.mu, d.lam = e.mu, e.lam
        d.start_strains = wp.zeros(shape, dtype=wp.mat33d, device=device)
        d.rate = material.damping_time_s / model.scene.time.dt_s
        self._damper = d
        self.energies = wp.zeros(shape, dtype=wp.float64, device=device)
        """Potential of each tet [J], half of what it dissipates in the step,
        shape [env_count, tet_count]."""
        self._corner_gradients = wp.zeros((*shape, 4), dtype=wp.vec3d, device=device)
        self._blocks = wp.zeros((*shape, 10), dtype=wp.mat33d, device=device)

    def _launch(self, kernel: wp.Kernel, inputs: list, outputs: list) -> None:
        wp.launch(
            kernel,
            dim=self.energies.shape,
            inputs=inputs,
            outputs=outputs,
            device=self.model.device,
        )

    def begin_step(self, positions: wp.array) -> None:
        """Strains gained from here on are resisted."""
        self._launch(_start_strain_kernel, [positions, self._damper], [])

    def energy(self, active: wp.array, positions: wp.array) -> np.ndarray:
        """Potential [J], shape [env_count]; stale where not active."""
        self._launch(_tet_energy_kernel, [active, positions, self._damper], [self.energies])
        return sum_rows(self.energies)

    def add_gradient(self, active: wp.array, positions: wp.array, gradient: wp.array) -> None:
        """Add the negative viscous force [N] to ``gradient``, shape [env_count, node_count]."""
        e, m = self.model.elastic, self.model
        self._launch(
            _tet_gradient_kernel, [active, positions, self._damper], [self._corner_gradients]
        )
        wp.launch(
            self._gather_gradient,
            dim=(m.env_count, m.soft_count),
            inputs=[active, e.node_tet_starts, e.node_tets, self._corner_gradients],
            outputs=[gradient],
            device=m.device,
        )

    def add_hessian(
        self, active: wp.array, positions: wp.array, values: wp.array, psd_mode: int
    ) -> None:
        """Add to the matrix blocks ``values`` [N/m], shape [env_count, block_count]."""
        m = self.model
        self._launch(
            _tet_hessian_kernel, [active, positions, self._damper, psd_mode], [self._blocks]
        )
        wp.launch(
            _add_blocks_kernel,
            dim=values.shape,
            inputs=[active, m.source_starts, m.sources, self._blocks],
            outputs=[values],
            device=m.device,
        )
