# SPDX-License-Identifier: Apache-2.0
"""Elastic potential of the soft bodies that share a material law and a kind of element."""

from __future__ import annotations

from taccel_lab.bodies.bodies import Element
from taccel_lab.bodies.material import MaterialModel
from taccel_lab.ipc.elasticity.laws import LAWS
from taccel_lab.ipc.potentials.elements.data import ElementKernels, ElementSum
from taccel_lab.model import Model
from taccel_lab.model.elastic import ElementArrays


def elastic_kernels(law: MaterialModel, element: Element) -> ElementKernels:
    """Kernels of a law on a kind of element: compiled when first launched, and only then."""
    if element is Element.QUADRATIC:
        from taccel_lab.ipc.potentials.elements.quadratic_points import elastic_quadratic_kernels

        return elastic_quadratic_kernels(law)
    from taccel_lab.ipc.potentials.elements.linear_kernels import create_linear_kernels

    return create_linear_kernels(LAWS[law])


class ElasticPotential(ElementSum):
    """Elastic energy of one group of elements.

    The energy is +inf when an element is inverted, at any of its quadrature points, except in
    materials that bear it (see scene.MaterialModel).
    """

    def __init__(self, model: Model, group: ElementArrays) -> None:
        super().__init__(model, group, elastic_kernels(group.law, group.element))
