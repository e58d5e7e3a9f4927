# SPDX-License-Identifier: Apache-2.0
"""What the points around a point say of it: weighted affine maps, of all points at once."""

from __future__ import annotations

import numpy as np


def local_affine(
    offset: np.ndarray,
    values: np.ndarray,
    weight: np.ndarray,
    belief: float,
    slope: np.ndarray | float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Affine maps through what each point's neighbours have.

    Args:
        offset: Ways from the point to its neighbours, shape [point, neighbour, 2].
        values: What the neighbours have, shape [point, neighbour, 2].
        weight: Of each neighbour, shape [point, neighbour].
        belief: Weight of the believed slope, which closes what few neighbours leave open.
        slope: The believed slope, shape [2, 2]; 0 for constant values.

    Returns:
        Values at the points, shape [point, 2], NaN without a neighbour, and the slopes of the maps,
        shape [point, 2, 2].
    """
    total = weight.sum(axis=1)
    share = (weight / np.where(total > 0, total, np.nan)[:, None])[..., None]
    middle, mean = (share * offset).sum(axis=1), (share * values).sum(axis=1)
    away = offset - middle[:, None]
    weighted = (away * weight[..., None]).transpose(0, 2, 1)
    normal = weighted @ away + belief * np.eye(2)
    right = weighted @ (values - mean[:, None]) + belief * (slope * np.ones((2, 2)))
    found = np.linalg.solve(np.where(np.isfinite(normal), normal, np.eye(2)), right)
    return mean - np.einsum("ni,nij->nj", middle, found), found
