# SPDX-License-Identifier: Apache-2.0
"""Presses as both fits see them: what those of a set share, pixels that are drawn, the light beside
a contact, which no score of the contact reaches, and held-out presses.

Held-out ones are placed without any part of the model that is scored on them. Figures need to know
where the ball was, which no training says. The label that came with the press does, as the labels
of the *training* presses lie against where these were placed (``LabelPlacement``): nothing of the
image is used. A press without a label is placed where its contact is found in its image, by the
search that knows no model.

How close a rendered image comes to its capture is taken in the contact disc, in the square crop of
half width 1.6 r around it, and over the whole image, with the background alone as the baseline:
whole-image scores flatter, as a bare background already agrees nearly everywhere.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.capture.captures import CapturedPress, CaptureSet, ContactCircle
from taccel_lab.calibration.capture.split import PressSplit
from taccel_lab.calibration.circles.ball_surface import BallSurface
from taccel_lab.calibration.circles.labels import LabelPlacement
from taccel_lab.calibration.circles.usable import place_heldout
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.optics.image_measures import crop_slices, psnr_db, ssim
from taccel_lab.reading.bonded_layer import BondedLayer
from taccel_lab.reading.light import (
    PRIOR_SIGMA,
    LightDrift,
    enough_pixels,
    fit_press_light,
)
from taccel_lab.signals.rest_surface import RestSurface

CircleSigma = tuple[float, float]
"""Standard deviations of a circle's centre along an axis and of its radius [px]."""
EXACT: CircleSigma = (0.0, 0.0)
Ring = tuple[float, float, int]
"""Inner and outer radius, in contact radii, and the most pixels that are drawn."""
WHOLE = (slice(None), slice(None))
SurfaceOf = Callable[[ContactCircle, float], BallSurface]
"""Surface under a ball of a radius [mm] in a circle; InputError where it cannot leave that."""
NEAREST_RADII = 2.0
"""No pixel nearer than this many contact radii tells the light."""


@dataclass(frozen=True)
class CaptureScene:
    """What all presses of one capture set have in common."""

    background: np.ndarray
    """RGB levels, shape [height_px, width_px, 3]."""
    grid: PixelGrid
    ball_radius_mm: float
    mask: np.ndarray | None = None
    """Pixels that may be used, bool, shape [height_px, width_px]; all when None."""
    rest_normals: np.ndarray | None = None
    """Outward unit normals at rest, shape [height_px, width_px, 3]; flat when None."""

    @classmethod
    def of(
        cls, captures: CaptureSet, background: np.ndarray | None, rest: RestSurface | None = None
    ) -> CaptureScene:
        """Scene of ``captures``, against their own background when ``background`` is None."""
        return cls(
            (captures.background if background is None else background).astype(np.float32),
            captures.grid,
            captures.ball_radius_mm,
            None if captures.mask.all() else captures.mask,
            None if rest is None or rest.is_flat else rest.normals,
        )

    @property
    def usable(self) -> np.ndarray:
        """Pixels that may be used, bool, shape [height_px, width_px]."""
        if self.mask is not None:
            return self.mask
        return np.ones((self.grid.height_px, self.grid.width_px), dtype=bool)

    def inside(self, circle: ContactCircle) -> np.ndarray:
        """Usable pixels in a contact, bool, shape [height_px, width_px]."""
        return self.usable & (circle.distance_px(self.grid) <= circle.radius_px)


@dataclass(frozen=True)
class PressFrame:
    """One press: what the camera saw, and the gel's surface under the ball."""

    name: str
    image: np.ndarray
    """RGB levels, shape [height_px, width_px, 3]."""
    circle: ContactCircle
    surface: BallSurface
    sha256: str = ""
    circle_sigma_px: CircleSigma = EXACT
    """How far the circle may be off."""


def press_frames(
    captures: CaptureSet,
    circles: Sequence[ContactCircle],
    surfaces: Sequence[BallSurface],
    sigmas_px: Sequence[CircleSigma] | None = None,
) -> list[PressFrame]:
    """Presses of a set in their circles, with their surfaces, in order; circles are exact when
    ``sigmas_px`` is None.

    Raises:
        InputError: Numbers that do not match.
    """
    if not len(circles) == len(surfaces) == len(captures.presses):
        raise InputError(
            f"{len(captures.presses)} presses need as many circles and surfaces, got "
            f"{len(circles)} and {len(surfaces)}"
        )
    sigmas = sigmas_px or [EXACT] * len(circles)
    return [
        PressFrame(press.name, press.image(), circle, surface, press.sha256, sigma)
        for press, circle, surface, sigma in zip(
            captures.presses, circles, surfaces, sigmas, strict=True
        )
    ]


def draw_pixels(
    frame: PressFrame,
    scene: CaptureScene,
    rings: Sequence[Ring],
    rng: np.random.Generator,
    part: tuple[slice, slice] = WHOLE,
) -> np.ndarray:
    """Indices of usable pixels drawn without replacement, counted along the rows of ``part``.

    Args:
        frame: The press.
        scene: Its pixels and which of them may be used.
        rings: Where they are drawn and how many; the contact's own first.
        rng: Draws them.
        part: Rows and columns that they are drawn in.

    Raises:
        InputError: Every pixel of the first ring is masked.
    """
    radii = frame.circle.distance_px(scene.grid)[part] / frame.circle.radius_px
    usable = scene.usable[part]
    regions = [usable & (radii >= low) & (radii < high) for low, high, _ in rings]
    if not regions[0].any():
        raise InputError(f"{frame.name}: every pixel of the contact is masked")
    return np.concatenate(
        [
            rng.permutation(np.flatnonzero(region))[:count]
            for region, (_, _, count) in zip(regions, rings, strict=True)
        ]
    )


def place_region(frames: Sequence[PressFrame]) -> dict[str, tuple[float, float]]:
    """Range of the contacts' centres [px], for a block's ``valid_region``."""
    u = [frame.circle.u_px for frame in frames]
    v = [frame.circle.v_px for frame in frames]
    return {"contact_u_px": (min(u), max(u)), "contact_v_px": (min(v), max(v))}


@dataclass(frozen=True)
class HeldoutFailure:
    """A press that was held out and cannot be placed."""

    name: str
    reason: str
    rejected: bool = False
    """Whether a label was given that the image rejects."""


@dataclass(frozen=True)
class HeldoutSet:
    """Presses that only the scores see."""

    captures: CaptureSet
    """Their images are read when the model is frozen, not before."""
    split: PressSplit
    """How they were chosen."""
    surface_of: SurfaceOf

    @classmethod
    def of(cls, captures: CaptureSet, split: PressSplit, surface_of: SurfaceOf) -> HeldoutSet:
        """Presses of ``captures`` that ``split`` holds out, which may be none."""
        return cls(captures.only(split.heldout), split, surface_of)

    @property
    def count(self) -> int:
        """How many were held out, those included that are gone."""
        return len(self.captures.presses) + len(self.split.gone)

    def placed(
        self, labels: LabelPlacement
    ) -> Iterator[tuple[CapturedPress, PressFrame] | HeldoutFailure]:
        """Each press with its frame where its label puts it or where it was found, or why it has no
        place; those that are gone come first. ``labels`` comes from the training presses."""
        for name in self.split.gone:
            yield HeldoutFailure(name, "it was left out of the captures")
        for press in self.captures.presses:
            ball_mm = press.radius_mm or self.captures.ball_radius_mm
            try:
                image = press.image()
                circle = place_heldout(press, image, self.captures, labels)
                circle = circle.up_to_equator(ball_mm, self.captures.grid)
                surface = self.surface_of(circle, ball_mm)
                yield press, PressFrame(press.name, image, circle, surface, press.sha256)
            except InputError as error:
                yield HeldoutFailure(press.name, str(error), press.mislabelled)


@dataclass(frozen=True)
class FittedPresses:
    """Presses that a model is fitted to, where they are, on their gel, and those that judge it."""

    captures: CaptureSet
    """The training presses alone."""
    circles: Sequence[ContactCircle]
    """Where they are taken to be, in order."""
    surfaces: Sequence[BallSurface]
    """Surfaces of the gel in these circles, in order."""
    heldout: HeldoutSet | None = None
    """Presses that are read when the model is frozen; None leaves figures out."""
    circle_sigmas_px: Sequence[CircleSigma] | None = None
    """What each circle may be off by; nothing when None."""
    labels: LabelPlacement | None = None
    """How labels lie, which says where held-out presses are; by ``circles`` when None."""
    background: np.ndarray | None = None
    """Untouched sensor to fit against, RGB levels; that of the captures when None."""
    rest: RestSurface | None = None
    """The undeformed face; flat if None."""
    pad: BondedLayer | None = None
    """The gel, for synthetic presses; without it there are none."""
    scale_share: float = 0.0
    """Standard deviation of the scale of the pixel grid, as a share of it."""
    thickness_share: float = 0.0
    """Standard deviation of depths by the thickness of ``pad``, as a share of them."""

    @property
    def placement(self) -> LabelPlacement:
        """How labels lie against the circles."""
        return self.labels or LabelPlacement.of(self.captures.presses, self.circles)


def light_beside(
    image: np.ndarray,
    scene: CaptureScene,
    circle: ContactCircle,
    background: np.ndarray | None = None,
) -> LightDrift:
    """Gain, offset and gradient of ``image`` beside its contact, against the scene's background or
    a render in its light, ``background``.

    Images are RGB levels, shape [height_px, width_px, 3]; masked pixels are left out. A contact
    that fills its frame leaves nothing to tell the light by, which then counts as unchanged.
    """
    beside = beside_pixels(circle, scene)
    if enough_pixels(beside):
        known = scene.background if background is None else background
        return fit_press_light(image, known, beside)
    unknown = np.tile(np.diag(PRIOR_SIGMA**2), (3, 1, 1))
    return LightDrift(np.ones(3), np.zeros(3), covariance=unknown)


def in_background_light(image: np.ndarray, scene: CaptureScene) -> np.ndarray:
    """A frame in the light of the background, as the model will bring new ones to it."""
    light = fit_press_light(image, scene.background, scene.mask)
    return light.remove(image).astype(np.float32)


def noise_floor_l1(frame: PressFrame, scene: CaptureScene) -> float:
    """Mean absolute difference of a frame from the background in its light beside the contact
    [levels]; NaN where the contact leaves nothing."""
    beside = beside_pixels(frame.circle, scene)
    if not beside.any():
        return float("nan")
    shown = light_beside(frame.image, scene, frame.circle).apply(scene.background)
    return float(np.abs(frame.image.astype(np.float64) - shown)[beside].mean())


def beside_pixels(circle: ContactCircle, scene: CaptureScene) -> np.ndarray:
    """Usable pixels beyond 2 contact radii and outside the crop that scores are taken in; bool,
    shape [height_px, width_px]."""
    beside = circle.distance_px(scene.grid) > NEAREST_RADII * circle.radius_px
    beside[crop_slices(circle.center_px, circle.radius_px, scene.grid)] = False
    return beside & scene.usable


@dataclass(frozen=True)
class ImageScore:
    """Agreement of one rendered image with its capture; levels of 255, RGB."""

    disc_l1: float
    """Mean absolute error inside the contact circle [levels]."""
    crop_l1: float
    """Mean absolute error in the crop of half width 1.6 r [levels]."""
    full_l1: float
    """Mean absolute error over the whole image [levels]."""
    crop_psnr_db: float
    """Peak signal-to-noise ratio in the crop [dB]."""
    crop_ssim: float
    """Structural similarity in the crop."""

    @property
    def psnr_db(self) -> float:
        """The figure that is quoted: that of the crop [dB]."""
        return self.crop_psnr_db


def score_image(
    rendered: np.ndarray,
    captured: np.ndarray,
    circle: ContactCircle,
    grid: PixelGrid,
) -> ImageScore:
    """Compare a rendered with a captured image, RGB levels, shape [height_px, width_px, 3]."""
    rendered = np.asarray(rendered, dtype=np.float64)
    captured = np.asarray(captured, dtype=np.float64)
    if rendered.shape != captured.shape:
        raise InputError(f"images differ in shape: {rendered.shape} and {captured.shape}")
    error = np.abs(rendered - captured)
    crop = crop_slices(circle.center_px, circle.radius_px, grid)
    disc = circle.distance_px(grid) <= circle.radius_px
    if not disc.any():
        raise InputError("no pixel of the contact counts")
    return ImageScore(
        disc_l1=float(error[disc].mean()),
        crop_l1=float(error[crop].mean()),
        full_l1=float(error.mean()),
        crop_psnr_db=psnr_db(rendered[crop], captured[crop]),
        crop_ssim=ssim(rendered[crop], captured[crop]),
    )
