# SPDX-License-Identifier: Apache-2.0
"""The focal length of each view alone: a camera that refocuses or zooms between views has several.

Each view is fitted again with its own pose and a factor on the focal lengths, the rest of the lens
as all views gave it. Its corners then scatter as they are detected, which is what the common fit's
residuals are judged by.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from taccel_lab.calibration.camera.board import BoardView
from taccel_lab.calibration.camera.lens import BundleFit, Lens, initial_pose
from taccel_lab.errors import InputError
from taccel_lab.robust_fit import fit_robustly, robust_scale

_SIGMAS, _SHARE = 4.0, 0.003
"""A view differs whose focal length is off by this many standard deviations, and by this share."""
_EXPLAINED = 0.8
"""And whose residuals a focal length of its own shrinks to less than this."""
_LEAST_PX = 1e-6
_NAMED = 6


@dataclass(frozen=True)
class ViewFocals:
    """Focal lengths of views that differ by more than their corners can tell apart."""

    focal_px: np.ndarray
    """Focal length along x of each view, shape [view]."""
    common_px: float
    """Residual of the median view with one focal length for all."""
    corners_px: float
    """And with one each: that of the corners."""
    names: tuple[str, ...]
    """Views whose focal length differs from the usual one, the farthest first."""

    def figures(self) -> dict[str, Any]:
        """Figures of the remark on them."""
        more = f" and {len(self.names) - _NAMED} more" if self.names[_NAMED:] else ""
        return {
            "least": float(self.focal_px.min()),
            "largest": float(self.focal_px.max()),
            "names": ", ".join(self.names[:_NAMED]) + more,
            "common": self.common_px,
            "corners": self.corners_px,
        }

    @property
    def spread(self) -> float:
        """Standard deviation of the focal lengths, relative to their mean."""
        return float(self.focal_px.std(ddof=1) / self.focal_px.mean())


def differing_focals(views: Sequence[BoardView], fit: BundleFit) -> ViewFocals | None:
    """Focal lengths of the views where these differ; None where one does for all.

    ``views``: all that show the board, also those that ``fit`` leaves out.
    """
    lens, common = fit.lens, fit.parameters
    factors, sigmas, before, after, sources = [], [], [], [], []
    for view in views:
        try:
            found = _alone(view, lens, common)
        except InputError:
            continue
        (start, end), factor, sigma = found
        if np.isfinite(sigma) and sigma > 0:
            factors.append(factor)
            sigmas.append(sigma)
            before.append(start)
            after.append(end)
            sources.append(view.source.replace("\\", "/").split("/")[-1])
    factor, sigma = np.array(factors), np.array(sigmas)
    if len(factor) < 3:
        return None
    usual = _weighted_median(factor, 1.0 / sigma)
    off = np.abs(factor - usual)
    differ = (off > _SIGMAS * sigma) & (off > _SHARE * usual)
    differ &= np.array(after) < _EXPLAINED * np.maximum(before, _LEAST_PX)
    if not differ.any():
        return None
    told = differ | (sigma < np.median(off[differ]) / _SIGMAS)
    order = [k for k in np.argsort(-off) if differ[k]]
    return ViewFocals(
        common[0] * factor[told],
        float(np.median(before)),
        float(np.median(after)),
        tuple(sources[k] for k in order),
    )


def _alone(
    view: BoardView, lens: Lens, common: np.ndarray
) -> tuple[tuple[float, float], float, float]:
    """Residuals of a view [px] with the common focal lengths and with its own, robustly; the factor
    on these, and its standard deviation."""
    board, start = view.board_mm(), initial_pose(view, lens, common)

    def of(x: np.ndarray) -> np.ndarray:
        parameters = common.copy()
        parameters[:2] *= x[0]
        return parameters

    def residuals(x: np.ndarray) -> np.ndarray:
        if not 0.2 < x[0] < 5.0:
            return np.full(view.uv_px.shape, np.nan)
        return view.uv_px - lens.project(board, of(x), x[1:])

    def jacobian(x: np.ndarray) -> np.ndarray:
        _, by_lens, by_pose = lens.project_with_jacobian(board, of(x), x[1:])
        by_factor = by_lens[..., :2] @ common[:2]
        return -np.concatenate([by_factor[..., None], by_pose], axis=2).reshape(-1, 7)

    first = np.concatenate([[1.0], start])
    found = fit_robustly(residuals, first, jacobian=jacobian)
    scales = robust_scale(residuals(first)), robust_scale(found.residuals)
    return scales, float(found.x[0]), float(np.sqrt(found.covariance()[0, 0]))


def _weighted_median(values: np.ndarray, weights: np.ndarray) -> float:
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, 0.5 * total[-1])])
