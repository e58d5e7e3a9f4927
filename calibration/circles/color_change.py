# SPDX-License-Identifier: Apache-2.0
"""The colour change of a press, and where a contact is in it, roughly: the start of finer searches.

The change is what the light's drift does not explain, smoothed, pixels square. Rays from a centre,
and circles through what is seen along them, such as the rim, serve the first search and finer ones.

Contacts are looked for at one size (``WorkingSize``). The search knows a contact by parts of the
image's shorter side, from its smoothing (1/240) to the specks that it opens (1/45), and its limits
were chosen on pictures of 240 to 480 rows. More rows tell it nothing more, and cost it the fourth
power of their number. Blocks of ``factor`` x ``factor`` pixels become one, their mean; a contact's
circle comes back in the camera's own pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import cv2
import numpy as np
from scipy.optimize import least_squares

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.geometry import PixelGrid
from taccel_lab.reading.light import LightDrift, fit_light, smoothed, without_light

SMOOTHING_SHARE = 1 / 240
"""Standard deviation of the smoothing, as a part of the image's shorter side."""
SUNK_RADII = 2.0
"""The gel around a contact sinks notably up to this many contact radii."""
SHORTER_PX = 480
"""Least pixels that pictures keep along their shorter side."""
RAY_COUNT = 180
MIN_RADIUS_PX = 4.0
SPECK_SHARES = (1 / 75, 1 / 45)
"""Half width of specks, dust and edges of dots, as a part of the image's shorter side."""
GREY_SHARE = 0.1
"""Weight of a change that is the same all round, the only one on a grey sensor."""
SHADOW_LEVEL = 0.45
"""Colour change, as a part of the strongest, that shadows beside a contact stay below."""
SOUGHT_PX = 8
"""Discs are compared in pictures so coarse that their radius is that to twice that."""


@dataclass(frozen=True)
class ColorChange:
    """One press against the background."""

    change: np.ndarray
    """Smoothed colour change [levels], float32, shape [rows, width_px, 3]: rows are resampled so
    that pixels are square and a round contact is a circle."""
    mask: np.ndarray | None
    """Pixels whose smoothed change rests on usable ones, shape [rows, width_px]; None: all."""
    drift: LightDrift

    def strength(self) -> np.ndarray:
        """Size of the colour change [levels], 0 where masked, shape [rows, width_px]."""
        size = np.linalg.norm(self.change, axis=-1)
        return size if self.mask is None else np.where(self.mask, size, 0.0)

    @property
    def grid(self) -> PixelGrid:
        """The grid of its square pixels, each as wide as 1."""
        rows, columns = self.change.shape[:2]
        return PixelGrid(columns, rows, 1.0, 1.0)


def smoothing_px(image: np.ndarray) -> float:
    """Standard deviation of the smoothing of an image's change [px]."""
    return float(np.clip(min(image.shape[:2]) * SMOOTHING_SHARE, 0.7, 4.0))


def color_change(
    image: np.ndarray,
    background: np.ndarray,
    grid: PixelGrid,
    mask: np.ndarray | None = None,
    light_by: np.ndarray | None = None,
    drift: LightDrift | None = None,
) -> ColorChange:
    """Drift-free smoothed difference of ``image`` to ``background``.

    Both are RGB levels, shape [height_px, width_px, 3]; pixels where ``mask`` is false have no
    effect. A ``drift`` that is not given is that of the whole image, most of which shows untouched
    gel, or without a gradient that of the pixels ``light_by``, bool, shape [height_px, width_px].
    """
    if mask is not None and mask.all():
        mask = None
    sigma = smoothing_px(image)
    drift = drift or fit_light(
        image, background, mask if light_by is None else light_by, gradient=light_by is None
    )
    change = smoothed(without_light(image, background, drift), mask, sigma)
    near = None
    if mask is not None:
        # A sample next to masked pixels rests on fewer; one among them on none.
        near = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), sigma) > 0.5
        near = square_pixels(near.astype(np.uint8), grid, cv2.INTER_NEAREST) > 0
    return ColorChange(square_pixels(change, grid), near, drift)


def square_pixels(
    picture: np.ndarray, grid: PixelGrid, interpolation: int = cv2.INTER_LINEAR
) -> np.ndarray:
    """A picture of ``grid`` with its rows resampled, so that a round contact is a circle."""
    ratio = grid.mm_per_px_y / grid.mm_per_px_x
    if abs(ratio - 1) <= 1e-6:
        return picture
    size = (picture.shape[1], max(2, round(picture.shape[0] * ratio)))
    return cv2.resize(picture, size, interpolation=interpolation)


@dataclass(frozen=True)
class WorkingSize:
    """How pictures of one grid are shrunk, and circles brought back."""

    whole: PixelGrid
    """The grid of the camera's pixels."""

    @cached_property
    def factor(self) -> int:
        """Pixels of the camera along each side of one that is worked with."""
        return max(1, min(self.whole.height_px, self.whole.width_px) // SHORTER_PX)

    @cached_property
    def grid(self) -> PixelGrid:
        """The pixels that are worked with: their number and proportions. Its scale stays that of
        the camera's pixels. What fills no block at the right and lower border is left out."""
        return PixelGrid(
            self.whole.width_px // self.factor,
            self.whole.height_px // self.factor,
            self.whole.mm_per_px_x,
            self.whole.mm_per_px_y,
        )

    def length_px(self, length_mm: float) -> float:
        """A length along x in pixels that are worked with."""
        return length_mm / self.whole.mm_per_px_x / self.factor

    def picture(self, image: np.ndarray) -> np.ndarray:
        """Means of the blocks of an image, shape [height_px, width_px(, channel)] in and out."""
        if self.factor == 1:
            return image
        height, width = self.grid.height_px * self.factor, self.grid.width_px * self.factor
        size = (self.grid.width_px, self.grid.height_px)
        return cv2.resize(image[:height, :width], size, interpolation=cv2.INTER_AREA)

    def mask(self, mask: np.ndarray | None) -> np.ndarray | None:
        """Blocks all of whose pixels may be used, bool, [height_px, width_px]."""
        if mask is None:
            return None
        return self.picture(mask.astype(np.float32)) > 1 - 0.5 / self.factor**2

    def enlarged(self, picture: np.ndarray) -> np.ndarray:
        """A picture of the working size, as large as the camera's."""
        size = (self.whole.width_px, self.whole.height_px)
        return cv2.resize(picture, size, interpolation=cv2.INTER_LINEAR)

    def circle(self, circle: ContactCircle) -> ContactCircle:
        """A circle of the camera's pixels, in those that are worked with."""
        return _scaled(circle, 1 / self.factor)

    def whole_circle(self, circle: ContactCircle) -> ContactCircle:
        """A circle of the pixels that are worked with, in the camera's."""
        return _scaled(circle, float(self.factor))


def _scaled(circle: ContactCircle, factor: float) -> ContactCircle:
    """Borders of pixels, not their centres, lie at whole multiples."""
    if factor == 1:
        return circle
    return ContactCircle(
        (circle.u_px + 0.5) * factor - 0.5,
        (circle.v_px + 0.5) * factor - 0.5,
        circle.radius_px * factor,
    )


@dataclass(frozen=True)
class CircleFit:
    """A circle and how well points agree with it."""

    center: np.ndarray
    """(x, y), shape [2]."""
    radius: float
    inliers: np.ndarray
    """Points within the tolerance, bool, shape [point_count]."""


def sample_rays(image: np.ndarray, center: np.ndarray, reach_px: float) -> np.ndarray:
    """Values of an image [rows, columns(, channels)] along rays from ``center``, a pixel apart.

    Shape [180, reach + 1(, channels)]; NaN outside the image.
    """
    angle = np.arange(RAY_COUNT)[:, None] * (2 * np.pi / RAY_COUNT)
    distance = np.arange(int(np.ceil(reach_px)) + 1)[None, :]
    x = (center[0] + distance * np.cos(angle)).astype(np.float32)
    y = (center[1] + distance * np.sin(angle)).astype(np.float32)
    rays = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    outside = (x < 0) | (y < 0) | (x > image.shape[1] - 1) | (y > image.shape[0] - 1)
    rays[outside] = np.nan
    return rays


def fit_circle(
    points: np.ndarray, center: np.ndarray, radius: float, tolerance: float
) -> CircleFit:
    """Circle through points [n, 2], from one nearby; points beyond ``tolerance`` have no say.

    Distances from the circle count after Cauchy first, which finds the points that agree, and those
    alone by least squares then.
    """

    def off(circle: np.ndarray) -> np.ndarray:
        return np.hypot(*(points - circle[:2]).T) - circle[2]

    start = np.array([*center, radius])
    found = least_squares(off, start, loss="cauchy", f_scale=tolerance).x
    inliers = np.abs(off(found)) < tolerance
    for _ in range(2):
        kept = inliers if inliers.sum() >= 3 else np.ones(len(points), dtype=bool)
        found = least_squares(lambda circle, kept=kept: off(circle)[kept], found).x
        inliers = np.abs(off(found)) < tolerance
    return CircleFit(found[:2], float(found[2]), inliers)


def circle_on_rays(
    reach_px: np.ndarray, seen: np.ndarray, center: np.ndarray, radius: float
) -> CircleFit:
    """Circle through a place on each ray from ``center``; inliers are rays.

    ``reach_px`` is how far out the place lies, shape [180]; rays that are not ``seen`` (bool,
    likewise) have none.
    """
    angle = np.arange(RAY_COUNT) * (2 * np.pi / RAY_COUNT)
    points = center + reach_px[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    if seen.sum() < 3:
        seen = np.ones(RAY_COUNT, dtype=bool)
    fit = fit_circle(points[seen], center, radius, tolerance=max(2.0, 0.06 * radius))
    inliers = np.zeros(RAY_COUNT, dtype=bool)
    inliers[np.flatnonzero(seen)[fit.inliers]] = True
    return CircleFit(fit.center, fit.radius, inliers)


def fit_rim(change: np.ndarray, center: np.ndarray, radius: float) -> CircleFit:
    """Circle through the point of each ray where the colour changes fastest, near the given one.

    The lens blurs the rim, so that this circle is a little wider than the contact.
    """
    rays = sample_rays(change, center, 1.4 * radius + 4)
    speed = np.nan_to_num(np.linalg.norm(np.gradient(rays, axis=1), axis=-1), nan=0.0)
    speed[:, : int(0.75 * radius)] = 0.0
    peak = np.argmax(speed, axis=1)
    reach = peak + _parabola_offset(speed, peak)
    return circle_on_rays(reach, speed[np.arange(RAY_COUNT), peak] > 0, center, radius)


def _parabola_offset(values: np.ndarray, peak: np.ndarray) -> np.ndarray:
    """Sub-sample position of each row's peak relative to its index, within half a sample."""
    rows = np.arange(len(values))
    middle = np.clip(peak, 1, values.shape[1] - 2)
    left, top, right = (values[rows, middle + k] for k in (-1, 0, 1))
    curvature = left - 2 * top + right
    offset = np.divide(0.5 * (left - right), curvature, out=np.zeros_like(top), where=curvature < 0)
    return np.where(middle == peak, np.clip(offset, -0.5, 0.5), 0.0)


def first_circle(change: ColorChange) -> ContactCircle:
    """Where a press is, roughly, in pixels of its colour change.

    Discs that stand out are looked for with and without specks; the one round which the colours
    turn most is taken, since a speck changes the same way on all its sides.
    """
    strength = change.strength()
    best, most = ContactCircle(0.0, 0.0, 0.0), -np.inf
    for share in (0.0, *SPECK_SHARES):
        circle = _standing_out(without_specks(strength, share) if share else strength)
        harmonics = np.abs(_harmonics(change, circle)[:2] / RAY_COUNT) ** 2
        power = (harmonics[1] + GREY_SHARE * harmonics[0]).sum(axis=-1)
        score = float(power @ np.arange(len(power)))
        if score > most:
            best, most = circle, score
    return best


def _harmonics(change: ColorChange, circle: ContactCircle) -> np.ndarray:
    """Fourier transform over the angle of the change along rays, shape [180, reach, 3]."""
    center = np.array([circle.u_px, circle.v_px])
    rays = sample_rays(change.change, center, 1.3 * circle.radius_px + 4)
    return np.fft.fft(np.nan_to_num(rays), axis=0)


def _standing_out(strength: np.ndarray) -> ContactCircle:
    """Disc that stands out most from the ring of 1.4 times its radius."""
    factor = max(1, min(strength.shape) // 120)
    size = (strength.shape[1] // factor, strength.shape[0] // factor)
    # Shadows beside the contact are weaker than its rim; cutting low values off removes them.
    highest = max(np.percentile(strength, 99.5), 0.6 * float(strength.max()))
    strong = np.maximum(strength - SHADOW_LEVEL * highest, 0.0)
    small = cv2.resize(strong.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    # Coarser pictures say which disc stands out most, this one where it is.
    radii = np.geomspace(max(2.0, MIN_RADIUS_PX / factor), min(size) / 2.2, 24)
    best = radii[np.argmax([_scores(small, radius, SOUGHT_PX).max() for radius in radii])]
    scores = _scores(small, best)
    row, column = np.unravel_index(int(np.argmax(scores)), scores.shape)
    u_px, v_px = (np.array([column, row]) + 0.5) * factor - 0.5
    return ContactCircle(float(u_px), float(v_px), float(best * factor))


def _scores(picture: np.ndarray, radius: float, fewest_px: float = np.inf) -> np.ndarray:
    """How far a disc of this radius stands out at each pixel, or where its radius is at least twice
    ``fewest_px``, at those of a picture that much coarser.

    The weight keeps a bright speck from winning over a whole contact.
    """
    coarser = max(1, int(radius / fewest_px))
    if coarser > 1:
        size = (picture.shape[1] // coarser, picture.shape[0] // coarser)
        picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    # Outside the image the gel is taken as untouched, so a cut disc scores less.
    kernel = _ringed_disc(radius / coarser)
    return np.sqrt(radius) * cv2.filter2D(
        picture, cv2.CV_32F, kernel, borderType=cv2.BORDER_CONSTANT
    )


@lru_cache(maxsize=256)
def _ringed_disc(radius: float) -> np.ndarray:
    """Kernel of the mean over a disc less that over the ring of 1.4 times its radius."""
    reach = int(np.ceil(1.4 * radius))
    distance = np.hypot(*np.mgrid[-reach : reach + 1, -reach : reach + 1])
    disc = distance <= radius
    ring = (distance > radius) & (distance <= 1.4 * radius)
    return disc / disc.sum() - ring / ring.sum()


def without_specks(strength: np.ndarray, share: float) -> np.ndarray:
    """Grey opening that wipes out what is smaller, in half its width, than a part of the image."""
    size = 2 * max(1, round(min(strength.shape) * share)) + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    return cv2.morphologyEx(np.asarray(strength, np.float32), cv2.MORPH_OPEN, kernel)


def gathered_share(change: ColorChange, circle: ContactCircle) -> float:
    """Share of what changes strongly in and through a circle that lies within two radii of it.

    Strong is half of what the circle's strongest tenth has; the areas that touch the circle count
    as a whole, so that an edge that goes on through the image gives a small share.
    """
    distance = circle.distance_px(change.grid)
    disc = distance <= circle.radius_px
    if not disc.any():
        return 0.0
    # The opening also cuts threads of noise between the contact and other strong changes.
    opened = without_specks(change.strength(), SPECK_SHARES[0])
    strong = opened > 0.5 * np.percentile(opened[disc], 90)
    _, parts = cv2.connectedComponents(strong.astype(np.uint8))
    touching = np.unique(parts[disc & strong])
    touched = strong & np.isin(parts, touching)
    return float((touched & (distance <= 2 * circle.radius_px)).sum() / max(touched.sum(), 1))


def turning_radius(change: ColorChange, circle: ContactCircle) -> float:
    """Radius at which the part of the colour change that turns round with the angle is largest.

    That part, the first harmonic over the angle, follows the slope: it rises from the centre to the
    rim of a contact and falls behind it, whatever the light's drift and the gel's sinking do.
    """
    size = np.linalg.norm(np.abs(_harmonics(change, circle)[1]), axis=-1)
    return float(max(np.argmax(size), MIN_RADIUS_PX / 2))
