# SPDX-License-Identifier: Apache-2.0
"""Whether a picture shows dots at all, and which: detection and lattice help each other.

Sizes and signs that blobs have are tried in turn, most dot-like first. Dots are those that form a
lattice, which then says which blobs are none.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import KDTree

from taccel_lab.errors import InputError
from taccel_lab.profile.optical_design import lattice_steps
from taccel_lab.reading.dots.blobs import DotScale, scale_candidates
from taccel_lab.reading.dots.detection import (
    DotFlag,
    Dots,
    detect_dots,
    strong_blobs,
)
from taccel_lab.reading.dots.lattice import (
    PITCH_X,
    PITCH_Y,
    Lattice,
    LayoutFit,
    fit_layout,
    lattice_index,
    renumbered,
)
from taccel_lab.reading.dots.lattice_growth import local_affine

MIN_DOTS = 9
"""Dots of a lattice that a picture has to show."""
_MIN_CONTRAST = 0.05
_CLEAR_GAP = 1.6
"""Dots that stand so far above the rest need no look at a part of them first."""
_TRIED = 4
_MANY = 300
"""Blobs above which a part of them is looked at first."""
_STRAY = 0.34
"""An outermost line of odd blobs that is filled less than this is dirt."""


@dataclass(frozen=True)
class MarkerPicture:
    """The dots of one picture, numbered."""

    dots: Dots
    lattice: Lattice
    layout_px: LayoutFit
    """The grid in pixels."""
    image: np.ndarray
    """The picture."""


def find_markers(image: np.ndarray) -> MarkerPicture:
    """All dots of a picture, on a square, rectangular or hexagonal lattice.

    Args:
        image: RGB or grey levels, shape [height_px, width_px] or [.., 3].

    Raises:
        InputError: The picture shows no dots; says what was found instead.
    """
    likeliest: Dots | None = None
    for scale in scale_candidates(image)[:_TRIED]:
        if scale.count < MIN_DOTS or (scale.count > _MANY and not _regular(image, scale)):
            continue
        dots = detect_dots(image, scale)
        picture = _accept(dots, image)
        if picture is not None:
            return picture
        likeliest = dots if likeliest is None else likeliest
    raise InputError("no dots found: " + _why_not(likeliest))


def markers_or_none(image: np.ndarray) -> MarkerPicture | None:
    """The dots as ``find_markers`` gives them; None for a picture that shows none."""
    try:
        return find_markers(image)
    except InputError:
        return None


def marker_pitch_px(image: np.ndarray) -> tuple[float, float, float]:
    """Mean distance of neighbouring dots along the rows and across them, and its uncertainty.

    Args:
        image: RGB or grey levels at rest, shape [height_px, width_px] or [.., 3].

    Returns:
        Pitch along the row direction nearest to +u and across it [px], and the larger of their
        standard deviations [px]. In a hexagonal lattice the second is the distance of the rows.

    Raises:
        InputError: No dots.
    """
    layout = find_markers(image).layout_px
    return *layout.pitch, max(layout.sigma(PITCH_X), layout.sigma(PITCH_Y))


def _regular(image: np.ndarray, scale: DotScale) -> bool:
    """Whether very many blobs look like dots before any is fitted: part of them forms a lattice,
    or they stand far above the rest. Noise makes thousands of blobs of any small size."""
    if scale.gap >= _CLEAR_GAP:
        return True
    blobs = strong_blobs(image, scale)
    middle = np.median(blobs, axis=0)
    near = np.argsort(np.hypot(*(blobs - middle).T))[: _MANY // 2]
    return lattice_index(blobs[near]).kind != "none"


def _accept(dots: Dots, image: np.ndarray) -> MarkerPicture | None:
    likely = dots.select(np.flatnonzero(~dots.flagged(DotFlag.ODD)))
    if likely.count < MIN_DOTS or np.median(np.abs(likely.contrast)) < _MIN_CONTRAST:
        return None
    lattice = lattice_index(dots.uv_px)
    if lattice.kind == "none" and likely.count < dots.count:
        dots = likely
        lattice = lattice_index(dots.uv_px)
    if lattice.kind == "none" or lattice.count < MIN_DOTS:
        return None
    return _numbered(dots, lattice, image)


def _numbered(dots: Dots, lattice: Lattice, image: np.ndarray) -> MarkerPicture:
    """Blobs beside the lattice that look odd are none; a place in the lattice redeems a dot."""
    lattice = _without_stray_lines(lattice, dots.flagged(DotFlag.ODD))
    keep = np.flatnonzero(lattice.numbered | ~dots.flagged(DotFlag.ODD))
    dots = dots.select(keep)
    lattice = replace(lattice, row=lattice.row[keep], column=lattice.column[keep])
    layout = fit_layout(
        dots.uv_px, lattice, covariance=dots.covariance_px2, in_view=_in_view(dots, lattice)
    )
    return MarkerPicture(dots, lattice, layout, image)


def _without_stray_lines(lattice: Lattice, odd: np.ndarray) -> Lattice:
    """Less outermost rows and columns that hold nothing but a few odd blobs: dirt where the next
    line of dots would be."""
    keep = lattice.numbered.copy()
    for line, across in ((lattice.row, lattice.columns), (lattice.column, lattice.rows)):
        while len(np.unique(line[keep])) > 2:
            ends = (line[keep].min(), line[keep].max())
            members = [keep & (line == end) for end in ends]
            stray = [m for m in members if odd[m].all() and m.sum() < _STRAY * across]
            if not stray:
                break
            keep &= ~np.any(stray, axis=0)
    return renumbered(lattice, keep)[0]


def _in_view(dots: Dots, lattice: Lattice) -> np.ndarray:
    """Places whose dot would lie wholly in the picture, bool, shape [rows, columns]."""
    row, column = np.mgrid[: lattice.rows, : lattice.columns]
    known = np.flatnonzero(lattice.numbered)
    steps = lattice.steps()[known]
    asked = lattice_steps(row.ravel(), column.ravel(), lattice.stagger)
    near = np.asarray(KDTree(steps).query(asked, k=min(12, len(known)))[1])
    offset = steps[near] - asked[:, None]
    weight = 1.0 / (0.25 + (offset**2).sum(axis=2)) ** 2
    places, _ = local_affine(offset, dots.uv_px[known[near]], weight, 1e-9)
    margin = float(np.median(dots.axes_px[:, 0]))
    width, height = dots.size_px
    u, v = places[:, 0], places[:, 1]
    inside = (u > margin) & (v > margin) & (u < width - 1 - margin) & (v < height - 1 - margin)
    return inside.reshape(row.shape)


def _why_not(dots: Dots | None) -> str:
    if dots is None or dots.count == 0:
        return (
            f"fewer than {MIN_DOTS} blobs of one size stand out from the picture; a sensor without "
            "markers has no markers block, and one with markers needs a sharp picture at rest"
        )
    contrast = float(np.median(np.abs(dots.contrast)))
    return (
        f"the {dots.count} blobs of radius {np.median(dots.radius_px):.1f} px that look most like "
        f"dots (contrast {100 * contrast:.0f} %) form no square, rectangular or hexagonal lattice; "
        "a sensor without markers has no markers block, and one with markers needs a sharp picture "
        "at rest"
    )
