# SPDX-License-Identifier: Apache-2.0
"""A gel mesh: its surface by region."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.geometry import Region
from taccel_lab.report.style import INK, in_report_style, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

REGION_COLORS = {
    Region.SIDE: "#e5e7eb",
    Region.CONTACT: "#8ecae6",
    Region.BOND: "#f4a261",
    Region.WINDOW: "#e9c46a",
}


@in_report_style
def draw_mesh(nodes_m: np.ndarray, faces: np.ndarray, regions: np.ndarray) -> Figure:
    """The contact face from above and the surface from the front.

    Args:
        nodes_m: Of the gel [m], shape [node, 3].
        faces: Outward triangles, shape [face, 3].
        regions: ``Region`` of each, shape [face].
    """
    from matplotlib.collections import PolyCollection
    from matplotlib.patches import Patch

    corners = nodes_m[faces] * 1e3
    span = np.ptp(nodes_m, axis=0) * 1e3
    height = min(0.9 + 6.0 * span[1] / span[0], 5.0)
    figure, axes = new_figure(8.6, height + 2.0, 2, 1, height_ratios=[height, 1.6])
    top, side = axes
    contact = regions == int(Region.CONTACT)
    top.add_collection(
        PolyCollection(
            corners[contact][:, :, :2].tolist(),
            facecolor=REGION_COLORS[Region.CONTACT],
            edgecolor=INK,
            linewidth=0.25,
        )
    )
    top.autoscale()
    top.invert_yaxis()
    top.set_aspect("equal")
    top.set_title(f"contact face from above: {int(contact.sum())} triangles")
    top.set_xlabel("x [mm]")
    top.set_ylabel("y [mm]")
    # Seen from the front: faces nearest to the viewer (largest y) hide the others.
    order = np.argsort(corners[:, :, 1].mean(axis=1))
    colors = [REGION_COLORS[Region(int(regions[face]))] for face in order]
    side.add_collection(
        PolyCollection(
            corners[order][:, :, [0, 2]].tolist(), facecolor=colors, edgecolor=INK, linewidth=0.25
        )
    )
    side.autoscale()
    side.set_aspect("equal" if span[2] > 0.1 * span[0] else "auto")
    side.set_title("from the front")
    side.set_xlabel("x [mm]")
    side.set_ylabel("z [mm]")
    used = [region for region in Region if (regions == int(region)).any()]
    figure.legend(
        handles=[Patch(color=REGION_COLORS[r], label=r.name.lower()) for r in used],
        loc="outside lower center",
        ncols=len(used),
    )
    return figure
