# SPDX-License-Identifier: Apache-2.0
"""How finely a gel is meshed around a press; each accuracy's is in ``presses.physics``."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

LARGEST_GROWTH = 2.2
"""Most that a ring outside the fine part, or a layer, is wider than the one before in the mesh of
one press of a ball."""

SWEPT_RADII = 1.5
"""How far from the middle of the mesh a ball's contact may lie, in its radii: of a ball of 4 mm,
0.3 mm deep without friction, the force stays within 0.5 % up to 2, and is 17 % off at 5."""

THIN_FROM, THIN_SLOPE, THIN_MOST = 0.5, 0.45, 0.35
"""Contact radius over thickness from which on elements get smaller, how fast and how much at most,
over the usual number along a radius."""
STIFF_RATIO = 0.475
"""Poisson's ratio from which on a gel under friction takes a layer more."""
EDGE_RADII = 3.0
"""Distance from the pad's edge, in radii of a ball's contact, within which a mesh needs more
spokes: at 3.2 the force is 0.3 % off."""


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
        gel of 10 mm took 10 % too much force. Where it is large, the elements are smaller: on a
        gel that is thinner than the radius the pressure falls steeply at the border, and a ball of
        8 mm, 0.2 mm deep in 1 mm, took 1.5 % too little.

        ``to_edge_mm``: from the contact to the edge of the pad, about.
        """
        thin = min(max(THIN_SLOPE * (radius_mm / thickness_mm - THIN_FROM), 0.0), THIN_MOST)
        finer = (1.0 + thin) * self.elements_per_radius
        size, fine = radius_mm / finer, self.fine_radii * radius_mm
        even = round(self.fine_radii * finer - self.core / 2)
        rings = even + _needed(size, to_edge_mm - fine)
        layers = _needed(self.top_layer * radius_mm, thickness_mm)
        return replace(
            self,
            elements_per_radius=finer,
            rings=max(self.rings, rings),
            layers=max(self.layers, layers),
        )

    def for_friction(self, poisson_ratio: float) -> PressMeshOptions:
        """Adds a layer to a gel that can hardly be squeezed and sticks to the tool: it gives way by
        shear below the face, and with three layers a ball of 3 or 4 mm took 1.4 to 2.8 % too much
        force at 0.499 (with four 0.5 to 1.1 %)."""
        if poisson_ratio < STIFF_RATIO:
            return self
        return replace(self, layers=max(self.layers, 4))

    def for_drag(self) -> PressMeshOptions:
        """Adds spokes to the outline of a tool that goes aside or turns under friction: its rim
        leaves the rows of nodes, and with four elements along a side the moment of a box of 3 mm
        that turned by 10 degrees is 14 % too large, the sideways force of one that slid 0.36 mm
        17 % (with six 5 and 7 %)."""
        return replace(self, outline=replace(self.outline, core=max(self.outline.core, 6)))

    def for_edge(self, radius_mm: float, distance_mm: float) -> PressMeshOptions:
        """Adds spokes and rings beside the pad's edge, which is ``distance_mm`` away from a ball's
        contact: with the usual 16 spokes the force of a ball of 4 mm, 0.5 mm deep in 4 mm of gel,
        is 1.5 % too large at 3.5 mm and 17 % at 1.5 mm; with these 0.0 and 0.6 %."""
        if distance_mm >= EDGE_RADII * radius_mm:
            return self
        return replace(self, core=max(self.core, 6), rings=max(self.rings, 12))

    def for_sweep(self, radius_mm: float, length_mm: float) -> PressMeshOptions:
        """Widens the fine part by what a ball's contact leaves it on its way, which is
        ``length_mm`` long and about whose middle the mesh is made; spokes and rings in proportion.

        A contact of ``radius_mm`` may move by ``SWEPT_RADII`` of them either way as it is.
        """
        wider = max(0.0, 0.5 * length_mm / radius_mm - SWEPT_RADII)
        if not wider:
            return self
        cells = wider * self.elements_per_radius
        core = _even(self.core * (1.0 + wider / SWEPT_RADII))
        rings = 2 * math.ceil((self.rings + cells - 0.5 * (core - self.core)) / 2)
        return replace(
            self, fine_radii=self.fine_radii + wider, core=core, rings=max(self.rings, rings)
        )

    def refined(self, factor: float) -> PressMeshOptions:
        """Multiplies the elements along every side by ``factor``; rings and the core stay even, as
        domes need it."""
        if factor == 1.0:
            return self
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
