# SPDX-License-Identifier: Apache-2.0
"""Elastic potential of linear tets: energy, nodal gradient and Hessian blocks per environment.

One thread per (environment, tet) evaluates an element; nodes and matrix blocks then gather from
their elements in a fixed order, so that no result depends on the order of execution.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.ipc.elasticity.laws import Moduli
from taccel_lab.ipc.elasticity.principal import PSD_ABS, PSD_CLAMP, PSD_NONE
from taccel_lab.ipc.potentials.elastic_kernels import create_elastic_kernels
from taccel_lab.ipc.reduce import sum_rows
from taccel_lab.model import Model

__all__ = ["PSD_ABS", "PSD_CLAMP", "PSD_NONE", "ElasticPotential"]


class ElasticPotential:
    """Workspace and launches of the elastic energy of a model."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self._kernels = create_elastic_kernels(model.scene.soft_body.material.model)
        self._moduli = Moduli()
        self._moduli.mu = model.elastic.mu
        self._moduli.lam = model.elastic.lam
        self._moduli.ratio = model.elastic.mooney_ratio
        env_count, tet_count = model.env_count, model.elastic.tets.shape[0]
        self.energies = wp.zeros((env_count, tet_count), dtype=wp.float64, device=model.device)
        """Energy of each tet [J], shape [env_count, tet_count]."""
        self._corner_gradients = wp.zeros(
            (env_count, tet_count, 4), dtype=wp.vec3d, device=model.device
        )
        self._blocks = wp.zeros((env_count, tet_count, 10), dtype=wp.mat33d, device=model.device)

    def _inputs(self, active: wp.array, positions: wp.array) -> list:
        e = self.model.elastic
        return [active, positions, e.tets, e.shape_gradients, e.volumes, self._moduli]

    def energy(self, active: wp.array, positions: wp.array) -> np.ndarray:
        """Energy [J], shape [env_count]; stale where not active.

        +inf when a tet is inverted, except in materials that bear it (see scene.MaterialModel).
        """
        wp.launch(
            self._kernels.energy,
            dim=self.energies.shape,
            inputs=self._inputs(active, positions),
            outputs=[self.energies],
            device=self.model.device,
        )
        return sum_rows(self.energies)

    def add_gradient(self, active: wp.array, positions: wp.array, gradient: wp.array) -> None:
        """Add d energy / dx [N] to ``gradient``, shape [env_count, node_count]."""
        e, device = self.model.elastic, self.model.device
        wp.launch(
            self._kernels.gradient,
            dim=self.energies.shape,
            inputs=self._inputs(active, positions),
            outputs=[self._corner_gradients],
            device=device,
        )
        wp.launch(
            self._kernels.gather_gradient,
            dim=(self.model.env_count, self.model.soft_count),
            inputs=[active, e.node_tet_starts, e.node_tets, self._corner_gradients],
            outputs=[gradient],
            device=device,
        )

    def set_hessian(
        self, active: wp.array, positions: wp.array, values: wp.array, psd_mode: int
    ) -> None:
        """Overwrite the matrix blocks ``values`` [N/m], shape [env_count, block_count]."""
        device = self.model.device
        wp.launch(
            self._kernels.hessian,
            dim=self.energies.shape,
            inputs=[*self._inputs(active, positions), psd_mode],
            outputs=[self._blocks],
            device=device,
        )
        wp.launch(
            self._kernels.gather_blocks,
            dim=values.shape,
            inputs=[active, self.model.source_starts, self.model.sources, self._blocks],
            outputs=[values],
            device=device,
        )
