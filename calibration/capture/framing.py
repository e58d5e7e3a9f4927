# SPDX-License-Identifier: Apache-2.0
"""Small images compared: whether they show the same gel through the same optics, and which of many
shows the untouched gel.

Comparisons of gels, by misfit and by the order of channels, are of images in one light, which takes
out exposure and white balance, and by medians, which a contact on a part of the gel does not move.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.files.images import Image, levels, read_image
from taccel_lab.reading.light import fit_light
from taccel_lab.reading.thumb import thumb

FITTED_PIXELS = 5000
"""Pixels that a fit of the light takes, evenly picked."""
OTHER_FRAMING_LEVELS = 5.0
"""Misfit from which two images are not of the same gel in the same framing."""
CLEAR_GAIN = 2.0
"""One picture is nearer than another when its misfit is this many times smaller."""
ORDERS: tuple[tuple[int, int, int], ...] = tuple(itertools.permutations(range(3)))  # type: ignore[assignment]


def in_light_of(
    image: np.ndarray, reference: np.ndarray, where: np.ndarray | None = None
) -> np.ndarray:
    """``reference`` in the light of ``image``, levels, shape [h, w, 3]: gain and offset only, by
    all pixels or those of ``where``, bool, shape [h, w]."""
    step = max(1, round((reference.shape[0] * reference.shape[1] / FITTED_PIXELS) ** 0.5))
    mask = None if where is None else where[::step, ::step]
    light = fit_light(image[::step, ::step], reference[::step, ::step], mask, gradient=False)
    return light.apply(reference)


def misfit_levels(
    image: np.ndarray, reference: np.ndarray, where: np.ndarray | None = None
) -> float:
    """Median distance of the colours after the fit [levels], by all pixels or those of ``where``:
    1 to 3 for the same gel."""
    apart = np.linalg.norm(image - in_light_of(image, reference, where), axis=-1)
    return float(np.median(apart if where is None else apart[where]))


def best_channel_order(
    image: np.ndarray, reference: np.ndarray
) -> tuple[tuple[int, int, int], float, float]:
    """Order of the channels of ``image`` that is nearest to ``reference``, by raw levels.

    Returns the order, its distance and that of the order as it is: medians over the pixels
    [levels], after a common shift of brightness.
    """
    distances = {}
    for order in ORDERS:
        change = image[..., list(order)] - reference
        change = change - np.median(change)
        distances[order] = float(np.median(np.linalg.norm(change, axis=-1)))
    best = min(distances, key=lambda order: distances[order])
    return best, distances[best], distances[0, 1, 2]


BACKGROUND_NAME = re.compile(
    r"(^|[_\-. ])(bg|background|ref|reference|blank|no_?contact|untouched|init|empty|rest)"
    r"($|[_\-. \d])",
    re.IGNORECASE,
)
FIRST_FRAME_NAME = re.compile(r"^(frame|img|image|calib|sample)?[_\-]?0+$", re.IGNORECASE)
"""Frame 0 is the background in several layouts; it counts less than a name that says so."""
MIN_CONTACT_LEVELS = 5.0
"""Strongest change below which a small picture shows no contact."""
MAX_STACK = 61
"""Frames that a median is taken over: more do not make it quieter than the camera's levels."""
STACK_BYTES = 96 << 20
"""Most bytes of the pictures that a median holds at a time."""


def median_image(images: Sequence[Image | str]) -> np.ndarray:
    """Median of images of one size, RGB uint8, over at most 61 of them, evenly picked.

    Large ones are read again for each band of rows, so that no more than ``STACK_BYTES`` of them
    are held.
    """
    pick = np.unique(np.linspace(0, len(images) - 1, min(len(images), MAX_STACK)).astype(int))
    picked = [images[i] for i in pick]
    shape = levels(picked[0]).shape
    median = np.empty(shape, dtype=np.uint8)
    count = max(1, STACK_BYTES // (len(picked) * shape[1] * shape[2]))
    for top in range(0, shape[0], count):
        band = np.empty((len(picked), min(count, shape[0] - top), *shape[1:]), dtype=np.uint8)
        shapes = {shape}
        for i, source in enumerate(picked):
            image = levels(source)
            shapes.add(image.shape)
            if image.shape == shape:
                band[i] = image[top : top + count]
        if len(shapes) > 1:
            sizes = sorted(f"{width}x{height}" for height, width, _ in shapes)
            raise InputError(f"images of different sizes ({', '.join(sizes)} px) have no median")
        # A row at a time: medians have 8 bytes a level.
        for row in range(band.shape[1]):
            median[top + row] = np.median(band[:, row], axis=0).round()
    return median


def guess_background(paths: Sequence[Path]) -> tuple[Path | None, str]:
    """The image that shows the untouched gel, and why; None when none of them does.

    By name first. Otherwise the image nearest to the median of all (each freed of its own drift),
    if it is as near as the noise allows: presses at changing places leave the median untouched.
    """
    named = [path for path in paths if BACKGROUND_NAME.search(path.stem)]
    if named:
        return named[0], f"{named[0].name} is called a background"
    first = [path for path in paths if FIRST_FRAME_NAME.match(path.stem)]
    if len(first) == 1 and len(paths) > 1:
        return first[0], f"{first[0].name} is frame 0"
    if len(paths) < 4:
        return None, f"none of {len(paths)} images is called a background"
    pick = np.unique(np.linspace(0, len(paths) - 1, min(len(paths), MAX_STACK)).astype(int))
    small = [thumb(read_image(paths[i]), 120) for i in pick]
    if len({image.shape for image in small}) > 1:
        return None, "the images are of different sizes"
    median = np.median(np.stack(small), axis=0)
    spread = np.array([contact_strength(image - median) for image in small])
    best = int(np.argmin(spread))
    typical = float(np.median(spread))
    if typical < MIN_CONTACT_LEVELS:
        return None, (
            f"the images differ by {typical:.1f} levels at their strongest: no contact shows in "
            "most of them"
        )
    if spread[best] < 0.25 * typical:
        path = paths[int(pick[best])]
        return path, (
            f"{path.name} differs least from the median of all ({spread[best]:.1f} levels, the "
            f"others {typical:.1f})"
        )
    return None, (
        f"no image is untouched: the one nearest to the median of all is still "
        f"{spread[best]:.1f} levels off at its strongest, the typical one {typical:.1f}"
    )


def contact_strength(change: np.ndarray) -> float:
    change = change - np.median(change, axis=(0, 1), keepdims=True)
    return float(np.percentile(np.linalg.norm(change, axis=-1), 99))
