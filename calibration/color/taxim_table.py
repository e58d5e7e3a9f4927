# SPDX-License-Identifier: Apache-2.0
"""Taxim's colour table fitted to captures: the baseline, and what its simulator reads.

Z. Si and W. Yuan, "Taxim: An Example-Based Simulation Model for GelSight Tactile Sensors", RA-L
2022. Pixels in and around the contacts are sorted into bins of tilt and direction of their normal;
in each bin a quadratic over the image is fitted to each colour's change by least squares. Bins
without enough pixels take over the coefficients of the nearest bin that has them.

Three things differ from Taxim's own fit. It takes the discs alone, whose floors then lend their
colours to the gel around them; here the surroundings take part, as far as the network's do. Slopes
count over the gel at rest, as in tables that are made from a colour model, so that one table serves
leaning gels. And the first bin of tilt, in which untouched gel lies beside the floor of a dent,
holds no change: a table that shows the floor's colour there shows it all over the image.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from taccel_lab.calibration.circles.ball_surface import BallSurface
from taccel_lab.calibration.response.frame import CaptureScene, PressFrame
from taccel_lab.errors import InputError
from taccel_lab.exporters.taxim_table import TERMS, TaximTable, bin_indices, pixel_terms
from taccel_lab.reading.light import LightDrift
from taccel_lab.signals.normals import normals_from_slopes

BINS = 125
"""Bins of tilt and of direction, as in Taxim's own tables."""
REACH_RADII = 2.5
"""Contact radii up to which pixels are taken. Left-out thirds of three sensors' training presses:
37.7, 32.9 and 29.4 dB, and 34.2, 26.0 and 25.7 with the discs alone, which are better inside on two
(2.7, 4.3 and 9.6 levels against 3.2, 5.1 and 9.1)."""
RIDGE = 0.01
"""Pull of all terms but the constant towards zero, against the mean square of the terms over the
image: most bins hold few pixels at few places, and a free quadratic runs away elsewhere. A tenth of
it costs RVSATHU 1 dB; which pull is best differs between sensors by a factor of eight."""
_CONSTANT_RIDGE = 1e-9


def fit_taxim_table(
    frames: Sequence[PressFrame],
    scene: CaptureScene,
    drifts: Mapping[str, LightDrift],
) -> TaximTable:
    """Fit the table to the contacts of ``frames``.

    Args:
        frames: Presses that the table is fitted to.
        scene: What the changes count from, and the pixels that may be used.
        drifts: Drift of each frame's light against the background, by the frame's name.

    Raises:
        InputError: No usable pixel lies in a contact.
    """
    bins = BINS
    gram = np.zeros((bins * bins, TERMS, TERMS))
    moment = np.zeros((bins * bins, TERMS, 3))
    grid, background = scene.grid, scene.background
    # Terms over -1..1 keep the normal equations well conditioned; rescaled at the end.
    half = np.array([(grid.width_px - 1) / 2, (grid.height_px - 1) / 2])
    for frame in frames:
        radii = frame.circle.distance_px(grid) / frame.circle.radius_px
        near = scene.usable & (radii <= REACH_RADII)
        v, u = np.nonzero(near)
        light = drifts[frame.name].at(np.flatnonzero(near), grid.height_px, grid.width_px)
        image = light.remove(frame.image[near].astype(np.float64))
        tilt, direction = bin_indices(normals_over_rest(frame.surface)[near], bins)
        terms = pixel_terms(u / half[0] - 1, v / half[1] - 1)
        place = tilt * bins + direction
        np.add.at(gram, place, terms[:, :, None] * terms[:, None, :])
        np.add.at(moment, place, terms[:, :, None] * (image - background[near])[:, None, :])
    count = gram[:, -1, -1]
    filled = np.flatnonzero(count > 0)
    if len(filled) == 0:
        raise InputError("no usable pixel lies in a contact; the Taxim table cannot be fitted")
    pull = np.array([RIDGE] * (TERMS - 1) + [_CONSTANT_RIDGE])
    damped = gram[filled] + count[filled, None, None] * np.diag(pull)
    solved = np.linalg.solve(damped, moment[filled])
    coefficients = np.einsum("ij,bjc->bic", _to_pixels(half), solved)
    nearest = nearest_filled(count.reshape(bins, bins) > 0)
    slot = np.full(bins * bins, -1)
    slot[filled] = np.arange(len(filled))
    table = coefficients[slot[nearest]].reshape(bins, bins, TERMS, 3)
    table[0] = 0.0
    return TaximTable(bins, np.moveaxis(table, -1, 0))


def render_taxim_table(
    table: TaximTable, surface: BallSurface, background: np.ndarray
) -> np.ndarray:
    """Tactile image from a table, float32 levels in 0..255, shape [height_px, width_px, 3]."""
    change = table.change(normals_over_rest(surface))
    return np.clip(background + change, 0.0, 255.0).astype(np.float32)


def normals_over_rest(surface: BallSurface) -> np.ndarray:
    """Normals of a flat gel with the slopes that the surface has over its rest, shape [h, w, 3]."""
    pressed, rest = surface.normals, surface.rest_normals
    return normals_from_slopes(rest[..., :2] / rest[..., 2:] - pressed[..., :2] / pressed[..., 2:])


def _to_pixels(half: np.ndarray) -> np.ndarray:
    """Coefficients over pixels from those over -1..1, shape [6, 6].

    With x = u / a - 1 and y = v / b - 1, each term is a quadratic of u and v.
    """
    a, b = half
    matrix = np.zeros((TERMS, TERMS))
    # Columns: x^2, y^2, x y, x, y, 1; rows: u^2, v^2, u v, u, v, 1.
    matrix[[0, 3, 5], 0] = 1 / a**2, -2 / a, 1
    matrix[[1, 4, 5], 1] = 1 / b**2, -2 / b, 1
    matrix[[2, 3, 4, 5], 2] = 1 / (a * b), -1 / a, -1 / b, 1
    matrix[[3, 5], 3] = 1 / a, -1
    matrix[[4, 5], 4] = 1 / b, -1
    matrix[5, 5] = 1
    return matrix


def nearest_filled(filled: np.ndarray) -> np.ndarray:
    """Flat index of the nearest filled bin for every bin; directions close around."""
    from scipy.ndimage import distance_transform_edt

    bins = len(filled)
    # Three turns beside each other, so that the ends of the directions are neighbours.
    turned = np.concatenate([filled] * 3, axis=1)
    nearest = np.asarray(
        distance_transform_edt(~turned, return_distances=False, return_indices=True)
    )
    tilt, direction = nearest[:, :, bins : 2 * bins]
    return (tilt * bins + direction % bins).ravel()
