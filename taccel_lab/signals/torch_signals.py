# SPDX-License-Identifier: Apache-2.0
"""Markers and heights as functions of torch, through which losses of images go back.

Both are linear in the nodes of the face that is met. Colours are kernels without a way back: a loss
of an image goes by its markers or its height map.
"""

from __future__ import annotations

import numpy as np
import torch
import warp as wp

from taccel_lab.geometry import PixelGrid
from taccel_lab.gradients.torch_motion import check_tensor
from taccel_lab.signals.markers import MarkerLayout
from taccel_lab.signals.raster import FaceRaster

Tensor = torch.Tensor


def marker_places(positions: Tensor, layout: MarkerLayout, first_node: int = 0) -> Tensor:
    """Place painted markers [m], [..., marker, 3], by the gel's nodes [m], [..., node_count, 3].

    Args:
        positions: Nodes of all bodies, or of the gel alone.
        layout: Markers on the gel.
        first_node: Index of the gel's first node.
    """
    check_tensor("positions", positions)
    nodes = torch.as_tensor(layout.nodes + first_node, dtype=torch.long, device=positions.device)
    weights = torch.as_tensor(layout.weights, device=positions.device).to(positions)
    return (positions[..., nodes, :] * weights[..., None]).sum(dim=-2)


def height_map(positions: Tensor, faces: np.ndarray, grid: PixelGrid) -> Tensor:
    """Map the heights of a gel's face at the pixels of a grid [m], [env, height_px, width_px], NaN
    where there is none.

    Linear between the nodes of the triangle that a pixel sees (``FaceRaster``), which is taken
    as given: the height has a kink where a pixel passes from one triangle to the next.

    Args:
        positions: Nodes in the gel frame [m], float64, [env, node_count, 3].
        faces: Triangles of the face, int, [face, 3].
        grid: Pixels.
    """
    check_tensor("positions", positions)
    raster = FaceRaster(faces, grid)
    host = positions.detach().cpu().contiguous().to(torch.float64)
    raster.update(wp.from_torch(host, dtype=wp.vec3d))
    seen = torch.as_tensor(raster.face_at_pixel.numpy(), dtype=torch.long, device=positions.device)
    env, row, column = torch.nonzero(seen >= 0, as_tuple=True)
    corners = torch.as_tensor(np.asarray(faces), dtype=torch.long, device=positions.device)
    a, b, c = (positions[env, corners[seen[env, row, column], i]] for i in range(3))
    x_m = torch.as_tensor(grid.x_mm() * 1e-3, device=positions.device)[column]
    y_m = torch.as_tensor(grid.y_mm() * 1e-3, device=positions.device)[row]

    def area(u: Tensor, v: Tensor) -> Tensor:
        return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]

    at = torch.stack([x_m, y_m], dim=1) - a[:, :2]
    whole = area(b - a, c - a)
    second, third = area(at, c - a) / whole, area(b - a, at) / whole
    height = a[:, 2] + second * (b[:, 2] - a[:, 2]) + third * (c[:, 2] - a[:, 2])
    shape = (len(positions), grid.height_px, grid.width_px)
    empty = torch.full(shape, torch.nan, dtype=positions.dtype, device=positions.device)
    return empty.index_put((env, row, column), height)
