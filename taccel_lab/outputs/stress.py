# SPDX-License-Identifier: Apache-2.0
"""Cauchy stress of soft bodies: sigma = P F^T / J, by element and averaged at nodes.

Maxwell branches add g P(F_e) F_e^T / J with F_e = F F_v^-1 of the state (``maxwell``). A ten-node
tet has one pressure and four quadrature points; its stress is the mean of these, by the volume that
each now has. A node takes the mean of its elements by their volume [Zienkiewicz and Taylor 2000,
sec. 14.2, averaging]. Linear tets with nu near 0.5 give pressures that alternate between
elements: read those of nodes.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import warp as wp

from taccel_lab.bodies.bodies import Element
from taccel_lab.bodies.material import MaterialModel
from taccel_lab.ipc.elasticity.laws import LAWS
from taccel_lab.ipc.potentials.elements.data import ElementData, element_data, modulus_index
from taccel_lab.ipc.potentials.elements.linear_kernels import linear_deformation
from taccel_lab.ipc.potentials.elements.quadratic_shape import common_deformation, point_deformation
from taccel_lab.model import Model
from taccel_lab.model.elastic import ElementArrays
from taccel_lab.model.launches import launch

wp.set_module_options({"enable_backward": False})


@wp.func
def _inverse(env: int, first: int, point: int, inverses: wp.array2d(dtype=wp.mat33d)) -> wp.mat33d:
    """F_v^-1 of a branch whose points begin at ``first``; the identity of the solid itself, -1, and
    of branches that were never strained."""
    found = wp.identity(n=3, dtype=wp.float64)
    if first >= 0 and inverses.shape[0] > 0:
        found = inverses[env, first + point]
    return found


@cache
def _stress_kernel(model: MaterialModel, element: Element) -> wp.Kernel:
    """Kernel over (environment, element), in its own module for each law and element."""
    law = LAWS[model]
    piola = law.piola
    shape_piola = law.shape_piola
    dilatation = law.dilatation
    dilatation_slope = law.dilatation_slope
    volumetric = law.volumetric
    volumetric_modulus = law.volumetric_modulus
    module = wp.get_module(f"{__name__}.{model.value}.{element.value}")
    wp.set_module_options({"enable_backward": False}, module=module)

    if element is Element.LINEAR:

        @wp.kernel(module=module)
        def _linear_stress_kernel(
            positions: wp.array2d(dtype=wp.vec3d),
            inverses: wp.array2d(dtype=wp.mat33d),
            first: int,
            share: wp.float64,
            d: ElementData,
            stresses: wp.array2d(dtype=wp.mat33d),
            volumes: wp.array2d(dtype=wp.float64),
        ):
            env, tet = wp.tid()
            f = linear_deformation(env, tet, positions, d)
            j = wp.determinant(f)
            e = f * _inverse(env, first, tet, inverses)
            p = piola(e, d.moduli, modulus_index(env, tet, d))
            stress = share / j * (p * wp.transpose(e))
            if first >= 0:
                stress += stresses[env, tet]
            stresses[env, tet] = stress
            volumes[env, tet] = j * d.volumes[env % d.volumes.shape[0], tet]

        return _linear_stress_kernel

    @wp.kernel(module=module)
    def _quadratic_stress_kernel(
        positions: wp.array2d(dtype=wp.vec3d),
        inverses: wp.array2d(dtype=wp.mat33d),
        first: int,
        share: wp.float64,
        d: ElementData,
        stresses: wp.array2d(dtype=wp.mat33d),
        volumes: wp.array2d(dtype=wp.float64),
    ):
        env, tet = wp.tid()
        quarter = wp.float64(0.25)
        common = common_deformation(env, tet, positions, d)
        mean = wp.float64(0.0)
        q = int(0)
        while q < 4:
            f = point_deformation(env, tet, q, common, positions, d)
            mean += quarter * dilatation(f * _inverse(env, first, 4 * tet + q, inverses))
            q += 1
        i = modulus_index(env, tet, d)
        pressure = volumetric_modulus(d.moduli, i) * volumetric(mean)[1]
        kirchhoff = wp.mat33d()
        growth = wp.float64(0.0)
        q = int(0)
        while q < 4:
            f = point_deformation(env, tet, q, common, positions, d)
            e = f * _inverse(env, first, 4 * tet + q, inverses)
            p = shape_piola(e, d.moduli, i) + pressure * dilatation_slope(e)
            kirchhoff += quarter * (p * wp.transpose(e))
            growth += quarter * wp.determinant(f)
            q += 1
        stress = share / growth * kirchhoff
        if first >= 0:
            stress += stresses[env, tet]
        stresses[env, tet] = stress
        volumes[env, tet] = growth * d.volumes[env % d.volumes.shape[0], tet]

    return _quadratic_stress_kernel


@wp.kernel
def _nodal_stress_kernel(
    nodes: wp.array(dtype=wp.int32),
    starts: wp.array(dtype=wp.int32),
    entries: wp.array(dtype=wp.int32),
    width: int,
    stresses: wp.array2d(dtype=wp.mat33d),
    volumes: wp.array2d(dtype=wp.float64),
    nodal: wp.array2d(dtype=wp.mat33d),
):
    env, i = wp.tid()
    total = wp.mat33d()
    volume = wp.float64(0.0)
    for k in range(starts[i], starts[i + 1]):
        element = entries[k] / width
        total += volumes[env, element] * stresses[env, element]
        volume += volumes[env, element]
    nodal[env, nodes[i]] = total / volume


@wp.kernel
def _von_mises_kernel(
    stresses: wp.array2d(dtype=wp.mat33d), equivalent: wp.array2d(dtype=wp.float64)
):
    env, i = wp.tid()
    s = stresses[env, i]
    third = wp.float64(1.0) / wp.float64(3.0)
    s = s - third * wp.trace(s) * wp.identity(n=3, dtype=wp.float64)
    equivalent[env, i] = wp.sqrt(wp.float64(1.5) * wp.ddot(s, s))


@wp.kernel
def _peak_kernel(
    nodes: wp.array(dtype=wp.int32),
    values: wp.array2d(dtype=wp.float64),
    peaks: wp.array(dtype=wp.float64),
    places: wp.array(dtype=wp.int32),
):
    env = wp.tid()
    best = wp.float64(-1.0)
    place = int(-1)
    for i in range(nodes.shape[0]):
        if values[env, nodes[i]] > best:
            best = values[env, nodes[i]]
            place = nodes[i]
    peaks[env] = best
    places[env] = place


class StressReader:
    """Stresses of one group of elements of a model; see ``Model.elastic``."""

    def __init__(self, model: Model, group: ElementArrays) -> None:
        self.model = model
        self.group = group
        self._data = element_data(group)
        shape, device = (model.env_count, group.element_count), model.device
        self.stresses = wp.zeros(shape, dtype=wp.mat33d, device=device)
        """Cauchy stress of each element [Pa], mat33d, shape [env_count, element_count]."""
        self.volumes = wp.zeros(shape, dtype=wp.float64, device=device)
        """Volume that each element has now [m^3], float64, shape [env_count, element_count]."""

    def read(self, positions: wp.array, inverses: wp.array | None = None) -> wp.array:
        """``stresses`` at node positions [m], vec3d, [env_count, node_count].

        ``inverses``: ``State.viscous_inverses``; None of gels that were never strained.
        """
        self._add(positions, inverses, -1, 1.0)
        for branch, first in self.group.branch_points:
            self._add(positions, inverses, first, branch.relative_modulus)
        return self.stresses

    def _add(
        self, positions: wp.array, inverses: wp.array | None, first: int, share: float
    ) -> None:
        inputs = [positions, inverses, first, share, self._data, self.stresses, self.volumes]
        launch(_stress_kernel(self.group.law, self.group.element), self.stresses.shape, *inputs)

    def add_to_nodes(self, nodal: wp.array) -> None:
        """Write the mean of the last ``stresses`` around each node of the group into ``nodal``,
        mat33d, shape [env_count, node_count]."""
        g = self.group
        inputs = [g.gather_nodes, g.node_starts, g.node_entries, g.nodes_per_element]
        inputs += [self.stresses, self.volumes, nodal]
        launch(_nodal_stress_kernel, (self.model.env_count, len(g.gather_nodes)), *inputs)


def von_mises(stresses: wp.array) -> wp.array:
    """Equivalent stress sqrt(3/2 s : s) of the deviators [Pa], float64, same shape."""
    equivalent = wp.zeros(stresses.shape, dtype=wp.float64, device=stresses.device)
    launch(_von_mises_kernel, stresses.shape, stresses, equivalent)
    return equivalent


def peak_at(nodes: np.ndarray, values: wp.array) -> tuple[wp.array, wp.array]:
    """Largest of nodal values at some nodes, such as the bonded ones, and the node it is at.

    ``nodes``: [n]; ``values``: float64, [env_count, node_count], not negative. Returns the values
    (float64) and nodes (int32), shape [env_count] each; -1 for an empty list.
    """
    device = values.device
    peaks = wp.zeros(values.shape[0], dtype=wp.float64, device=device)
    places = wp.zeros(values.shape[0], dtype=wp.int32, device=device)
    chosen = wp.array(np.asarray(nodes, dtype=np.int32), dtype=wp.int32, device=device)
    launch(_peak_kernel, values.shape[0], chosen, values, peaks, places)
    return peaks, places
