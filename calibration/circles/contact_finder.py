# SPDX-License-Identifier: Apache-2.0
"""Find the contact circles of ball presses in their images, without anybody clicking.

1. The drift of the light is taken off (``fit_light``); what is left, smoothed, is the colour
   change of the press (``color_change``).
2. A disc that stands out gives a first circle (``first_circle``), the steepest drop of colour along
   rays from its centre says whether it is round.
3. All presses together are explained by one map from the slope that a ball leaves to the colour
   change; that moves centres and radii to a fraction of a pixel (``joint_fit``).

A single press goes the same way with a smaller map. All of it works on pictures of one size
(``WorkingSize``). On a grey sensor darkness stands for depth, not for slope: each press is found by
itself there (``grey``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from taccel_lab.calibration.capture.captures import CapturedPress, CaptureSet, ContactCircle, Once
from taccel_lab.calibration.circles.color_change import (
    MIN_RADIUS_PX,
    SUNK_RADII,
    ColorChange,
    WorkingSize,
    color_change,
    first_circle,
    fit_rim,
    gathered_share,
    smoothing_px,
    turning_radius,
)
from taccel_lab.calibration.circles.grey import find_grey_contact
from taccel_lab.calibration.circles.joint_fit import (
    FittedContact,
    PhotometricFit,
    RingSamples,
    fit_contacts,
    sample_rings,
)
from taccel_lab.calibration.circles.labels import (
    CutContactError,
    DetectedContact,
    UntouchedError,
)
from taccel_lab.calibration.circles.uncertainty import circle_covariances
from taccel_lab.errors import InputError
from taccel_lab.files.file_cache import content_key
from taccel_lab.geometry import PixelGrid
from taccel_lab.progress import Progress, silent
from taccel_lab.reading.light import LightDrift, enough_pixels
from taccel_lab.reading.whole_frame import require_whole
from taccel_lab.robust_fit import spread_about_median
from taccel_lab.signals.depth_response import Channel, channel_of

TASK = "finding the contacts"
MIN_CONTRAST_LEVELS = 12.0
"""Weakest colour change that counts as a contact, in levels of 255."""
MIN_CONTRAST_DARK_LEVELS = 5.0
"""The same on a dark sensor: a tenth of its background's 90th percentile, but at least this."""
MIN_CONTRAST_OVER_NOISE = 6.0
MIN_ROUND = 0.9
"""Least score of a contact: about 1 and more where all speaks for a ball's round one."""
RIM_WORTH = 0.75
"""What the share of rays that see a rim adds to that of the colour change that a ball explains: a
smooth skin leaves no sharp rim, but then its whole colour wheel is a ball's."""
MOST_RIM = 0.4
"""Share of the rays from which on a rim is round all about: it adds no more."""
GATHERED = 0.6
"""Part of a strong colour change through a contact that ends within two radii: an edge goes on."""
MIN_VISIBLE, MIN_LABELLED_VISIBLE = 0.55, 0.2
"""Share of the rings around a contact that has to lie in the image and outside the mask; the same
where a label says that a contact is there, which a corner of the image may cut to a quarter."""
MOSTLY = 0.5
"""Share of a picture that has to be far from its contact for the light to be that of all of it."""
SAMPLING_BLUR_SHARE = 0.04
"""Guess of the blur of gel and lens together, in ball radii, besides our own smoothing."""
ROUNDS = (6, 10)
"""Rounds of the fit on the first samples, and on those around the circles that it found."""
USUAL_RATIO = 0.7
"""Contact radius over ball radius that is assumed when nobody says what the ball is."""
KEPT_BYTES = 128 << 20
"""Colour changes that are kept from one round to the next; those of further presses are made again
from their images, which takes a few milliseconds each."""


def detect_contact(
    image: np.ndarray,
    background: np.ndarray,
    grid: PixelGrid,
    *,
    mask: np.ndarray | None = None,
    name: str = "image",
    ball_radius_mm: float | None = None,
    label: ContactCircle | None = None,
    grey: Channel | None = None,
    once: Once | None = None,
) -> DetectedContact:
    """Contact circle of one ball press.

    ``image`` and ``background`` are RGB levels, shape [height_px, width_px, 3]; ``grey`` is the
    channel that darkens with depth, None on a sensor of coloured lamps; ``once`` keeps where the
    search starts for other searches in the same image. Raises InputError naming ``name`` when the
    image shows no contact or no round one, or when the contact reaches out of the image; where a
    ``label`` lies in it, the part in the image is enough.
    """
    if grey is not None:
        require_whole(image, background, mask, name)
        drop = channel_of(background, grey) - channel_of(image, grey)
        return find_grey_contact(drop, grid, mask=mask, name=name, label=label)
    scene = _Scene.of(background, grid, mask)
    start = _Start.of(lambda: image, scene, name, once or Once())
    if ball_radius_mm is None:
        ball_px = start.first.circle.radius_px / USUAL_RATIO
    else:
        ball_px = scene.size.length_px(ball_radius_mm)
    start = replace(start, kept=start.change)
    together = FittedTogether({0: start}, {}, [ball_px], *_refine([start], [ball_px]))
    return _accept(start, together.judged()[0], together.samples[0], label)


def seen_contact(
    press: CapturedPress,
    background: np.ndarray,
    grid: PixelGrid,
    mask: np.ndarray | None = None,
    grey: Channel | None = None,
) -> DetectedContact | InputError:
    """Contact of ``press`` as its image alone shows it, without ball or scale, found once, or the
    error of ``detect_contact``: the check of the captures, which may be made before and after the
    scale is known, and the scale itself look for the same circles.

    Of ``grid`` only the proportions of a pixel count.
    """
    ratio = round(grid.mm_per_px_y / grid.mm_per_px_x, 9)
    own = PixelGrid(grid.width_px, grid.height_px, min(1.0, 1 / ratio), min(1.0, ratio))

    def look() -> DetectedContact | InputError:
        found: dict[int, DetectedContact | InputError] = {}
        with _refused(0, found):
            found[0] = detect_contact(
                press.image(), background, own, mask=mask, name=press.source, label=press.circle,
                grey=grey, once=press.once,
            )  # fmt: skip
        return found[0]

    seen = content_key({"background": background, "mask": mask, "ratio": ratio, "grey": grey})
    return press.once.of(("contact", seen), look)


def find_contacts(
    captures: CaptureSet, progress: Progress = silent, grey: Channel | None = None
) -> list[DetectedContact | InputError]:
    """Contact of every press, or the error that says why it has none; the presses are fitted
    together, but those of a ``grey`` sensor (the channel that darkens with depth).

    A circle that a person has corrected (``contacts.toml``) is taken as it is. A contact that the
    border of the image cuts is found by its part inside where its label says that it is one.
    """
    found: dict[int, DetectedContact | InputError] = {}
    if grey is None:
        together = fit_together(captures, progress)
        found |= together.refusals
        judged = zip(together.starts.items(), together.judged(), together.samples, strict=True)
        for (i, start), contact, samples in judged:
            press = captures.presses[i]
            with _refused(i, found):
                found[i] = _accept(start, contact, samples, press.circle)
    for i, press in enumerate(captures.presses):
        if press.checked and press.circle is not None:
            found[i] = DetectedContact(press.circle, 0.0, 0.0)
        elif grey is not None:
            with _refused(i, found):
                found[i] = detect_contact(
                    press.image(), captures.background, captures.grid, mask=captures.mask,
                    name=press.source, label=press.circle, grey=grey,
                )  # fmt: skip
            progress(TASK, i + 1, len(captures.presses))
    return [found[i] for i in range(len(captures.presses))]


def fit_together(captures: CaptureSet, progress: Progress = silent) -> FittedTogether:
    """All presses that show something explained by one map; those whose circles a person has
    corrected have no part in it."""
    scene = _Scene.of(captures.background, captures.grid, captures.mask)
    starts: dict[int, _Start] = {}
    refusals: dict[int, InputError] = {}
    kept_bytes = 0
    for i, press in enumerate(captures.presses):
        if press.checked and press.circle is not None:
            continue
        with _refused(i, refusals):
            start = _Start.of(press.image, scene, press.source, press.once)
            change = start.change
            kept_bytes += change.change.nbytes
            starts[i] = replace(start, kept=change) if kept_bytes <= KEPT_BYTES else start
        progress(TASK, i + 1, len(captures.presses))
    while starts:
        balls = [captures.presses[i].radius_mm or captures.ball_radius_mm for i in starts]
        ball_px = [scene.size.length_px(radius_mm) for radius_mm in balls]
        try:
            return FittedTogether(starts, refusals, ball_px, *_refine([*starts.values()], ball_px))
        except _LostContactError as error:
            gone = next(i for i, start in starts.items() if start is error.start)
            refusals[gone] = InputError(str(error))
            del starts[gone]
    return FittedTogether(starts, refusals, [], None, [])


@contextmanager
def _refused(i: int, found: dict[int, Any]) -> Iterator[None]:
    """Keeps why a press cannot be used."""
    try:
        yield
    except InputError as error:
        found[i] = error.with_traceback(None)  # Which would hold the press's pictures.


@dataclass(frozen=True)
class _Scene:
    """What all presses of a set share, at the working size."""

    size: WorkingSize
    background: np.ndarray
    mask: np.ndarray | None

    @classmethod
    def of(cls, background: np.ndarray, grid: PixelGrid, mask: np.ndarray | None) -> _Scene:
        size = WorkingSize(grid)
        return cls(size, size.picture(background), size.mask(mask))

    @cached_property
    def key(self) -> str:
        """Digest of all that the start of a search depends on besides the image."""
        mask = None if self.mask is None or self.mask.all() else self.mask
        recipe = {"background": self.background, "mask": mask, "ratio": round(self.ratio, 9)}
        return content_key(recipe)

    @property
    def ratio(self) -> float:
        """Height of a pixel over its width."""
        return self.size.whole.mm_per_px_y / self.size.whole.mm_per_px_x

    def far(self, circle: ContactCircle) -> np.ndarray:
        """Pixels of the working size that the gel's sinking beside a contact does not reach."""
        return circle.far(self.size.grid, SUNK_RADII, self.mask)

    def change(
        self,
        image: np.ndarray,
        light_by: np.ndarray | None = None,
        drift: LightDrift | None = None,
    ) -> ColorChange:
        """``color_change`` of an image in the camera's pixels."""
        picture = self.size.picture(image)
        return color_change(picture, self.background, self.size.grid, self.mask, light_by, drift)

    def whole_circle(self, circle: ContactCircle) -> ContactCircle:
        """A circle of the picture of square pixels, in the camera's."""
        return self.size.whole_circle(replace(circle, v_px=circle.v_px / self.ratio))


@dataclass(frozen=True)
class _First:
    """Where the search in a press starts, in the picture of square pixels."""

    circle: ContactCircle
    contrast_levels: float
    drift: LightDrift


@dataclass(frozen=True)
class _Start:
    """A press in whose image the search has begun."""

    name: str
    scene: _Scene
    read: Callable[[], np.ndarray]
    first: _First
    kept: ColorChange | None = None
    """The press's change of colour, where it is kept."""

    @classmethod
    def of(cls, read: Callable[[], np.ndarray], scene: _Scene, name: str, once: Once) -> _Start:
        """Start of a press, found once; InputError when there is nothing to start from."""
        key = ("start", scene.key)
        return cls(name, scene, read, once.of(key, lambda: _first(read, scene, name)))

    @property
    def change(self) -> ColorChange:
        return self.kept or self.scene.change(self.read(), drift=self.first.drift)


@dataclass(frozen=True)
class FittedTogether:
    """Presses that one map explains, in order, in pixels of the working size."""

    starts: dict[int, _Start]
    """Presses in which the search has begun, by their index."""
    refusals: dict[int, InputError]
    """Errors of the others."""
    ball_px: list[float]
    """Radius of the ball of each press [px]."""
    fit: PhotometricFit | None
    """None when no press was usable."""
    samples: list[RingSamples]
    """What was fitted, one entry for each press."""

    def judged(self) -> list[FittedContact]:
        """The contacts with what their circles may be off by (``circle_covariances``)."""
        if self.fit is None:
            return []
        covariances = circle_covariances(self.samples, self.ball_px, self.fit)
        return [
            replace(contact, covariance=covariance)
            for contact, covariance in zip(self.fit.contacts, covariances, strict=True)
        ]


class _LostContactError(InputError):
    """A contact that the fit moves out of its image; the others are fitted without it."""

    def __init__(self, start: _Start) -> None:
        super().__init__(f"{start.name}: no contact found inside the image")
        self.start = start


def _first(read: Callable[[], np.ndarray], scene: _Scene, name: str) -> _First:
    require_whole(scene.size.picture(read()), scene.background, scene.mask, name)
    change = scene.change(read())
    circle = first_circle(change)
    far = scene.far(replace(circle, v_px=circle.v_px / scene.ratio))
    usable = far.size if scene.mask is None else scene.mask.sum()
    # The contact has a say in the light of a picture that it mostly fills.
    if far.sum() < MOSTLY * usable and enough_pixels(far):
        change = scene.change(read(), light_by=far)
        circle = first_circle(change)
    strength = change.strength()
    disc = circle.distance_px(change.grid) <= circle.radius_px
    contrast = float(np.percentile(strength[disc], 90)) if disc.any() else 0.0
    bright = float(np.percentile(scene.background, 90))
    needed = float(np.clip(0.1 * bright, MIN_CONTRAST_DARK_LEVELS, MIN_CONTRAST_LEVELS))
    # The size of the change far from the contact.
    noise = spread_about_median(strength[circle.far(change.grid, SUNK_RADII, change.mask)])
    noisy = contrast <= MIN_CONTRAST_OVER_NOISE * noise
    if contrast < needed or noisy:
        raise (UntouchedError if noisy else InputError)(
            f"{name}: no contact found; its strongest colour change is {contrast:.1f} levels of "
            f"255 over a noise of {noise:.1f}, at least {needed:g} levels and "
            f"{MIN_CONTRAST_OVER_NOISE:g} times the noise are needed. If it shows a "
            "contact, give its circle; a frame without one teaches nothing and is left out"
        )
    radius = float(
        np.clip(1.05 * turning_radius(change, circle), 0.5 * circle.radius_px, circle.radius_px)
    )
    first = replace(circle, radius_px=radius)
    return _First(first, contrast, change.drift)


def _refine(
    starts: Sequence[_Start], ball_px: Sequence[float]
) -> tuple[PhotometricFit, list[RingSamples]]:
    circles: Sequence[ContactCircle] = [start.first.circle for start in starts]
    ours = smoothing_px(starts[0].scene.background)
    blur = float(np.hypot(ours, SAMPLING_BLUR_SHARE * np.median(ball_px)))
    fit, samples = None, []
    for rounds in ROUNDS:
        samples = [
            sample_rings(change.change, circle, change.mask)
            for change, circle in zip((start.change for start in starts), circles, strict=True)
        ]
        for start, sample in zip(starts, samples, strict=True):
            if sample.visible < MIN_LABELLED_VISIBLE:
                raise _LostContactError(start)
        fit = fit_contacts(samples, fit or circles, ball_px, blur_px=blur, iterations=rounds)
        circles = [contact.circle for contact in fit.contacts]
    assert fit is not None
    return fit, samples


def _accept(
    start: _Start, contact: FittedContact, samples: RingSamples, label: ContactCircle | None
) -> DetectedContact:
    """The contact in the image's own pixels; InputError when it is none, or when the border cuts it
    and no label lies in it."""
    change, circle, size = start.change, contact.circle, start.scene.size
    own, grid = start.scene.whole_circle(circle), size.whole
    limit = min(change.change.shape[:2]) / 2
    center = np.array([circle.u_px, circle.v_px])
    # Share of the rays from the centre that see the rim.
    rim = float(fit_rim(change.change, center, max(circle.radius_px, 2.0)).inliers.mean())
    gathered = gathered_share(change, circle)
    score = contact.explained + RIM_WORTH * min(rim, MOST_RIM)
    score *= min(1.0, gathered / GATHERED)
    if score < MIN_ROUND or not MIN_RADIUS_PX <= circle.radius_px <= limit:
        raise InputError(
            f"{start.name}: no round contact found; {rim:.0%} of the rays agree on a circle of "
            f"radius {own.radius_px:.1f} px ({size.factor * MIN_RADIUS_PX:g} to "
            f"{size.factor * limit:g} are contacts); a ball's slope explains "
            f"{max(contact.explained, 0):.0%} of the colour change, {gathered:.0%} of which lies "
            f"within two radii; that is a score of {max(score, 0):.2f}, at least {MIN_ROUND:g} is "
            "needed. If it shows a contact, give its circle"
        )
    beyond = own.beyond_px(grid)
    known = label is not None and label.center_gap_px(own, grid) < own.radius_px
    used = beyond <= 0 or (known and own.has_center_in(grid))
    least = MIN_LABELLED_VISIBLE if known and beyond > 0 else MIN_VISIBLE
    if not used or samples.visible < least:
        raise CutContactError(
            f"{start.name}: the contact at ({own.u_px:.0f}, {own.v_px:.0f}) px with radius "
            f"{own.radius_px:.0f} px "
            + (f"reaches {beyond:.0f} px out of the image" if beyond > 0 else "is mostly masked")
            + f"; {samples.visible:.0%} of it and its surroundings can be seen: it is left out"
        )
    sigma = size.factor * np.sqrt(np.maximum(np.diag(contact.covariance), 0.0))
    return DetectedContact(
        circle=own,
        radius_sigma_px=float(sigma[2]),
        contrast_levels=start.first.contrast_levels,
        center_sigma_px=float(np.sqrt((sigma[0] ** 2 + sigma[1] ** 2) / 2)),
        explained=contact.explained,
        visible=samples.visible,
    )
