# SPDX-License-Identifier: Apache-2.0
"""How finely a gel is meshed around a press; which press takes which is in ``envs.physics``."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

LARGEST_GROWTH = 2.2
"""Most that a ring outside the fine part, or a layer, is wider than the one before in the mesh of
one press of a ball."""


def _needed(first: float, length: float) -> int:
    """How many elements that grow by ``LARGEST_GROWTH`` from ``first`` on fill ``length``."""
    filled = 1 + max(length, 0.0) * (LARGEST_GROWTH - 1) / first
    return math.ceil(math.log(filled) / math.log(LARGEST_GROWTH) - 1e-9)


def _even(count: float) -> int:
    return max(4, 2 * round(count / 2))


@dataclass(frozen=True)
class OutlineMeshOptions:
    """Resolution around a contact with an outline: of a punch, an edge, any mesh. Rows of nodes lie
    on the outline and close to each other on both sides of it."""

    core: int = 4
    inner: int = 2
    """Rings between the core and the outline, those on it included."""
    outer: int = 6
    """Rings from there to the rings along the pad's own edge."""
    layers: int = 4
    top: float = 0.1
    """Thickness of the uppermost layer, as a part of the geometric mean of the contact's half
    widths and the gel's thickness."""

    def refined(self, factor: float) -> OutlineMeshOptions:
        """Multiplies the elements along every side by ``factor``; all rings together stay even, as
        domes need it."""
        inner = max(1, round(factor * self.inner))
        both = 2 * max(2, round(factor * (self.inner + self.outer) / 2))
        return replace(
            self,
            core=_even(factor * self.core),
            inner=inner,
            outer=both - inner,
            layers=max(2, round(factor * self.layers)),
            top=self.top / factor,
        )

    @property
    def cell_count(self) -> int:
        """A measure of the number of elements."""
        return self.core * (self.inner + self.outer) * self.layers


@dataclass(frozen=True)
class PressMeshOptions:
    """Resolution around a press, in units of the contact radius."""

    elements_per_radius: float = 10 / 3
    """Elements along the contact radius."""
    fine_radii: float = 1.9
    """Radius of the fine part in contact radii: the gel sinks visibly that far around a press."""
    core: int = 4
    rings: int = 10
    layers: int = 3
    """Core, rings and layers of ``focused_gel_mesh``; they set the number of nodes."""
    top_layer: float = 1.0
    """Thickness of the uppermost layer in contact radii, where the number of layers allows it."""
    outline: OutlineMeshOptions = OutlineMeshOptions()
    """What tools with an outline take instead."""
    scattered: OutlineMeshOptions = OutlineMeshOptions(core=8, outer=4)
    """What those take that do not fill their outline, such as gratings and pairs: even cells
    inside."""

    def for_ball(
        self, radius_mm: float, thickness_mm: float, to_edge_mm: float
    ) -> PressMeshOptions:
        """Adds as many rings and layers as keep them from growing by more than
        ``LARGEST_GROWTH`` where the contact's radius is small beside the gel: a ball of 1 mm on a
        gel of 10 mm took 10 % too much force.

        ``to_edge_mm``: from the contact to the edge of the pad, about.
        """
        size, fine = radius_mm / self.elements_per_radius, self.fine_radii * radius_mm
        even = round(self.fine_radii * self.elements_per_radius - self.core / 2)
        rings = even + _needed(size, to_edge_mm - fine)
        layers = _needed(self.top_layer * radius_mm, thickness_mm)
        return replace(self, rings=max(self.rings, rings), layers=max(self.layers, layers))

    def refined(self, factor: float) -> PressMeshOptions:
        """Multiplies the elements along every side by ``factor``; rings and the core stay even, as
        domes need it."""
        return replace(
            self,
            elements_per_radius=factor * self.elements_per_radius,
            core=_even(factor * self.core),
            rings=2 * math.ceil(factor * self.rings / 2 - 1e-9),
            layers=max(2, round(factor * self.layers)),
            top_layer=self.top_layer / max(1.0, factor) ** 0.5,
            outline=self.outline.refined(factor),
            scattered=self.scattered.refined(factor),
        )

    @property
    def cell_count(self) -> int:
        """A measure of the number of elements around a ball."""
        return self.core * self.rings * self.layers


DEFAULT_PRESS_MESH = PressMeshOptions()
