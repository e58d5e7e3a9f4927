# SPDX-License-Identifier: Apache-2.0
"""What element kernels read, and how nodes and matrix blocks gather what elements wrote.

One thread per (environment, element) evaluates an element; linear tets add up what they contribute
by chunks (``chunk_stage``), others write it as it is. Nodes and blocks then add up those parts in a
fixed order, so that no result depends on the order of execution.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.bodies.bodies import Element
from taccel_lab.ipc.device.native import native
from taccel_lab.ipc.device.sums import add_row_sums
from taccel_lab.ipc.elasticity.laws import Moduli
from taccel_lab.ipc.linear.problem.scatter import NewtonSystem
from taccel_lab.ipc.potentials.carried import gather_carried
from taccel_lab.ipc.potentials.elements.chunk_stage import NINE, STAGED_THREADS
from taccel_lab.ipc.potentials.energy import Potential
from taccel_lab.model import Model
from taccel_lab.model.elastic import ElementArrays
from taccel_lab.model.element_chunks import ChunkTables
from taccel_lab.model.env_lists import EnvMask, Envs, env_at
from taccel_lab.model.launches import WARP_THREADS, Scratch, launch

wp.set_module_options({"enable_backward": False, "block_dim": STAGED_THREADS})


@wp.struct
class ElementData:
    """Rest shape and parameters of the elements of a group."""

    nodes: wp.array2d(dtype=wp.int32)
    """Shape [element_count, nodes_per_element]."""
    gradients: wp.array3d(dtype=wp.vec3d)
    """Rest gradients of the barycentric coordinates [1/m], shape [rest_count, element_count, 4]."""
    volumes: wp.array2d(dtype=wp.float64)
    """Rest volumes [m^3], shape [rest_count, element_count]."""
    moduli: Moduli
    """See ``modulus_index``."""
    lanes: wp.array(dtype=wp.int32)
    """See ``ElementChunks``; of linear tets only, as the next two."""
    block_sums: ChunkTables
    force_sums: ChunkTables
    starts: wp.array3d(dtype=wp.mat33d)
    """Inverse viscous deformation that a Maxwell branch counts from in the step, shape [env_count,
    element_count, point_count]; of branches only."""
    shares: wp.array(dtype=wp.float64)
    """What a Maxwell branch counts by in the step, shape [env_count]; of quadratic ones only."""


@wp.func
def modulus_index(env: int, tet: int, d: ElementData) -> int:
    """Where the moduli of an element stand: all environments share them, or each has its own."""
    count = d.nodes.shape[0]
    if d.moduli.mu.shape[0] == count:
        return tet
    return env * count + tet


@dataclass(frozen=True)
class ElementKernels:
    """Kernels of a kind of element with its material, launched over (environment, element), but
    gradients and Hessians of linear tets over (environment, lane):

    ``energy(active, x, data, out energies)``, ``gradient(active, x, data, out force_parts)``,
    ``hessian(active, x, data, psd_modes, out block_parts)``. Parts are those of elements, shape
    [env_count, element_count, entries], or of linear tets those of chunks, [env_count, sum_count].
    """

    energy: wp.Kernel
    gradient: wp.Kernel
    hessian: wp.Kernel
    hessian_lanes: int = 1
    """Lanes of an element in ``hessian`` where it has no chunks; several elements fill a warp."""


@wp.kernel
def _gather_gradient_kernel(
    active: Envs,
    nodes: wp.array(dtype=wp.int32),
    starts: wp.array(dtype=wp.int32),
    sources: wp.array(dtype=wp.int32),
    parts: wp.array2d(dtype=wp.vec3d),
    gradient: wp.array2d(dtype=wp.vec3d),
):
    place, i = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    total = wp.vec3d()
    for k in range(starts[i], starts[i + 1]):
        total += parts[env, sources[k]]
    gradient[env, nodes[i]] += total


@wp.func
def _block_part(env: int, code: int, parts: wp.array2d(dtype=wp.mat33d)) -> wp.mat33d:
    """One part, the right way round."""
    block = parts[env, code // 2]
    if code % 2 == 1:
        block = wp.transpose(block)
    return block


@wp.func_native(native("element_parts", "add_parts", NINE=NINE))
def _add_parts(
    env: int,
    block: int,
    first: int,
    end: int,
    sources: wp.array(dtype=wp.int32),
    parts: wp.array2d(dtype=wp.mat33d),
    values: wp.array2d(dtype=wp.mat33d),
) -> None:
    """Add parts ``first`` to ``end`` of ``sources``, the right way round, to a block."""
    ...


@wp.kernel
def _gather_blocks_kernel(
    active: Envs,
    blocks: wp.array(dtype=wp.int32),
    starts: wp.array(dtype=wp.int32),
    sources: wp.array(dtype=wp.int32),
    parts: wp.array2d(dtype=wp.mat33d),
    values: wp.array2d(dtype=wp.mat33d),
):
    place, i = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    _add_parts(env, blocks[i], starts[i], starts[i + 1], sources, parts, values)


@wp.kernel
def _gather_rim_kernel(
    moving: Envs,
    rows: wp.array(dtype=wp.int32),
    starts: wp.array(dtype=wp.int32),
    sources: wp.array(dtype=wp.int32),
    nodes: wp.array(dtype=wp.int32),
    parts: wp.array2d(dtype=wp.mat33d),
    displacements: wp.array2d(dtype=wp.vec3d),
    rhs: wp.array2d(dtype=wp.vec3d),
):
    place, i = wp.tid()
    env = env_at(place, moving)
    if env < 0:
        return
    total = rhs[env, rows[i]]
    for k in range(starts[i], starts[i + 1]):
        total -= _block_part(env, sources[k], parts) * displacements[env, nodes[k]]
    rhs[env, rows[i]] = total


_EPSILON = wp.constant(wp.float64(np.finfo(np.float64).eps))
ENERGY_ROUNDING = wp.constant(wp.float64(2e-17))
"""Rounding of the energy of elements over their shear modulus times their volume: a block of 20 mm
and 1 MPa, turned, shows about a sixth of that."""


@wp.kernel
def _rounding_kernel(d: ElementData, energies: wp.array2d(dtype=wp.float64)):
    env, tet = wp.tid()
    volume = d.volumes[env % d.volumes.shape[0], tet]
    energies[env, tet] = ENERGY_ROUNDING * volume * d.moduli.mu[modulus_index(env, tet, d)]


FORCE_ROUNDING = {Element.LINEAR: 0.2, Element.QUADRATIC: 1.0}
"""Part of the bound in ``_force_rounding_kernel`` that is allowed: 2 to 3 times the residual that
flying blocks of 2 to 200 mm, 1e5 to 7e10 Pa and Poisson's ratios of 0.3 and 0.49 keep, at the
origin and a metre away; 2 to 6 times with quadratic tets."""
_NEAR_M = 1.0
"""Distance from the origin within which a group whose rounding is below the tolerance never shows
it."""


@wp.func
def _greatest(x: wp.vec3d) -> wp.float64:
    return wp.max(wp.abs(x[0]), wp.max(wp.abs(x[1]), wp.abs(x[2])))


@wp.kernel
def _force_rounding_kernel(
    active: wp.array(dtype=wp.int32),
    positions: wp.array2d(dtype=wp.vec3d),
    d: ElementData,
    share: wp.float64,
    forces: wp.array2d(dtype=wp.float64),
):
    """Force [N] that the last digit of the positions x makes in each element:

        eps |x| V (2 mu + lambda) sum_i |b_i| (sum_i |b_i|^2)^(1/2)

    its nodes' sum of magnitudes, b_i the gradients of the barycentric coordinates.
    """
    env, tet = wp.tid()
    if active[env] == 0:
        return
    rest = env % d.volumes.shape[0]
    reach = wp.float64(0.0)
    total = wp.float64(0.0)
    squares = wp.float64(0.0)
    for i in range(4):
        reach = wp.max(reach, _greatest(positions[env, d.nodes[tet, i]]))
        b = d.gradients[rest, tet, i]
        total += wp.length(b)
        squares += wp.dot(b, b)
    i = modulus_index(env, tet, d)
    modulus = wp.float64(2.0) * d.moduli.mu[i] + d.moduli.lam[i]
    force = d.volumes[rest, tet] * modulus * total * wp.sqrt(squares)
    forces[env, tet] = share * _EPSILON * reach * force


def element_data(group: ElementArrays) -> ElementData:
    """Nodes, shapes and moduli of a group as they are now; no chunks."""
    data, moduli = ElementData(), Moduli()
    data.nodes, data.gradients, data.volumes = group.elements, group.shape_gradients, group.volumes
    moduli.mu, moduli.lam, moduli.ratio = group.mu, group.lam, group.mooney_ratio
    data.moduli = moduli
    return data


class ElementSum(Potential):
    """Energy, gradient and matrix of one group of elements, from the kernels of its elements."""

    def __init__(self, model: Model, group: ElementArrays, kernels: ElementKernels) -> None:
        self.model = model
        self.group = group
        self.kernels = kernels
        device, count, width = model.device, group.element_count, group.nodes_per_element
        shape = (model.env_count, count)
        data = element_data(group)
        block_count, force_count = count * width * (width + 1) // 2, count * width
        self._chunk_lanes = 0
        if group.chunks is not None:
            chunks = group.chunks
            data.lanes, self._chunk_lanes = chunks.lanes, len(chunks.lanes)
            data.block_sums, data.force_sums = chunks.blocks, chunks.forces
            block_count, force_count = chunks.block_count, chunks.force_count
        self._data = data
        assert group.gather is not None
        self._gather = group.gather
        self._bound: wp.array | None = None
        self.energies = wp.zeros(shape, dtype=wp.float64, device=device)
        """Energy of each element [J], shape [env_count, element_count]."""
        envs = model.env_count
        self._blocks = wp.zeros((envs, block_count), dtype=wp.mat33d, device=device)
        self._forces = Scratch(self._blocks).take((envs, force_count), wp.vec3d, device)

    def _by_element(self, parts: wp.array) -> wp.array:
        """Parts as the kernels want them."""
        if self.group.chunks is not None:
            return parts
        return parts.reshape((*self.energies.shape, -1))

    @property
    def data(self) -> ElementData:
        """What the kernels read; the arrays of the group's moduli as they are now."""
        if self._bound is not self.group.mu:
            self._data.moduli = element_data(self.group).moduli
            self._bound = self.group.mu
        return self._data

    @property
    def idle_memory(self) -> wp.array:
        """What others may use after ``gather_rim`` and before the next evaluation."""
        return self._blocks

    def launch(self, kernel: wp.Kernel, *arguments: Any, lanes: int = 0) -> None:
        """Launch over (environment, element), or over ``lanes`` of each environment."""
        launch(kernel, (self.model.env_count, lanes or self.group.element_count), *arguments)

    def write_energies(self, active: EnvMask, positions: wp.array) -> None:
        """Fill ``energies`` [J] of active environments."""
        self.launch(self.kernels.energy, active, positions, self.data, self.energies)

    def add_energy_rounding(self, active: EnvMask, totals: wp.array) -> None:
        """Add what rounding makes of the energy however small it is [J] to ``totals``, float64,
        [env_count], where active; overwrites ``energies``."""
        self.launch(_rounding_kernel, self.data, self.energies)
        add_row_sums(active, self.energies, None, totals)

    def rounds_above(self, tolerance_n: float) -> bool:
        """Whether rounding may make forces above ``tolerance_n``, so that it has to be asked; of
        moduli that were set by environment nothing is known."""
        return self.group.young_moduli is not None or self._nearby_rounding_n > tolerance_n

    @cached_property
    def _nearby_rounding_n(self) -> float:
        """What rounding makes of the forces ``_NEAR_M`` away, with the scene's moduli [N]."""
        g = self.group
        lengths = np.linalg.norm(g.shape_gradients.numpy()[0], axis=-1)
        modulus = 2 * g.mu.numpy() + g.lam.numpy()
        size = lengths.sum(axis=1) * np.sqrt((lengths**2).sum(axis=1))
        force = (g.volumes.numpy()[0] * modulus * size).sum()
        return FORCE_ROUNDING[g.element] * float(np.finfo(float).eps * _NEAR_M * force)

    @cached_property
    def body_rounding_n(self) -> wp.array:
        """Room for what rounding makes of the residual of each body [N], float64, shape
        [env_count, body_count]."""
        m = self.model
        return wp.zeros((m.env_count, len(m.bodies)), dtype=wp.float64, device=m.device)

    def add_force_rounding(self, active: EnvMask, positions: wp.array, totals: wp.array) -> None:
        """Add the residual that rounding makes of each body [N] to ``totals``, float64, shape
        [env_count, body_count], where active; overwrites ``energies``."""
        rounding = FORCE_ROUNDING[self.group.element]
        self.launch(_force_rounding_kernel, active, positions, self.data, rounding, self.energies)
        for body, first, end in self.group.bodies:
            add_row_sums(active, self.energies[:, first:end], None, totals[:, body])

    def add_gradient(self, active: EnvMask, positions: wp.array, gradient: wp.array) -> None:
        """Add d energy / dx [N] to ``gradient``, shape [env_count, node_count]."""
        self.write_forces(active, positions)
        self.gather_forces(active, gradient)

    def write_forces(
        self, active: EnvMask, positions: wp.array, kernel: wp.Kernel | None = None
    ) -> None:
        """Evaluate the gradients of all elements, or what another ``kernel`` finds in their
        place."""
        inputs = [active, positions, self.data, self._by_element(self._forces)]
        self.launch(kernel or self.kernels.gradient, *inputs, lanes=self._chunk_lanes)

    def gather_forces(self, active: EnvMask, gradient: wp.array) -> None:
        """Add the parts of elements or chunks to the gradient of the nodes, without atomics."""
        g = self.group
        inputs = [active, g.gather_nodes, g.force_starts, g.force_parts, self._forces, gradient]
        launch(_gather_gradient_kernel, (self.model.env_count, len(g.gather_nodes)), *inputs)

    def add_hessian(
        self, active: EnvMask, positions: wp.array, system: NewtonSystem, psd_modes: wp.array
    ) -> None:
        """Add d^2 energy / dx^2 [N/m] to the blocks of ``system``; what prescribed nodes that move
        contribute goes to its right-hand side [N]."""
        self.write_hessians(active, positions, psd_modes)
        self.gather_hessians(active, system)
        self.gather_rim(active, system)

    def write_hessians(self, active: EnvMask, positions: wp.array, psd_modes: wp.array) -> None:
        """Evaluate the blocks of all elements."""
        inputs = [active, positions, self.data, psd_modes, self._by_element(self._blocks)]
        lanes = self._chunk_lanes
        if self.kernels.hessian_lanes > 1:
            lanes = WARP_THREADS * -(
                -self.kernels.hessian_lanes * self.group.element_count // WARP_THREADS
            )
        self.launch(self.kernels.hessian, *inputs, lanes=lanes)

    def gather_hessians(self, active: EnvMask, system: NewtonSystem) -> None:
        """Add the parts of elements or chunks to the matrix, without atomics."""
        m, g, carried = self.model, self._gather, self.group.carried
        inputs = [active, g.blocks, g.source_starts, g.sources, self._blocks, system.values]
        launch(_gather_blocks_kernel, (m.env_count, len(g.blocks)), *inputs)
        if carried is not None:
            gather_carried(m, active, carried, self._blocks, system.values)

    def gather_rim(self, moving: EnvMask, system: NewtonSystem) -> None:
        """Add what prescribed nodes contribute to the right-hand side where they move: in the
        environments of ``moving`` (int32, [env_count])."""
        m, g = self.model, self._gather
        if len(g.rim_rows):
            inputs = [moving, g.rim_rows, g.rim_starts, g.rim_sources, g.rim_nodes, self._blocks]
            inputs += [system.displacements, system.rhs]
            launch(_gather_rim_kernel, (m.env_count, len(g.rim_rows)), *inputs)
