# SPDX-License-Identifier: Apache-2.0
"""Elements a soft body can be made of."""

from __future__ import annotations

from enum import StrEnum


class Element(StrEnum):
    """How displacements vary inside a tet of the mesh."""

    LINEAR = "linear"
    """Four nodes, one deformation gradient a tet. Cheapest by tet; far too stiff near nu = 0.5."""
    QUADRATIC = "quadratic"
    """Ten nodes, with one pressure a tet: free of volumetric locking up to nu = 0.499. Middle nodes
    are added to the edges of the mesh, whose tets stay straight at rest."""

    @property
    def point_count(self) -> int:
        """Points of a tet at which its material is evaluated."""
        return 4 if self is Element.QUADRATIC else 1
