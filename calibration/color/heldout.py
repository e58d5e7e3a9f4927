# SPDX-License-Identifier: Apache-2.0
"""Held-out presses scored by a frozen colour model, placed in three ways.

A render needs to know where the ball was, which no training says. Three answers, from the strictest
to the kindest:

- ``label``: by the label that came with the press, as the labels of the *training* presses lie
  against where these were placed (``LabelPlacement``). Nothing of the image is used.
- ``tiles``: by the frozen model on the even tiles of a checkerboard over the image; only the odd
  tiles are scored.
- ``self``: by the frozen model on the very pixels that are scored. It takes the error of the circle
  out and flatters by what three numbers can absorb.

Figures that are quoted are those by label where every held-out press has one, else those by tiles.
A press that cannot be placed or has no surface, or that is gone, counts as the bare background.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from taccel_lab.calibration.capture.captures import EQUATOR_SLACK, CaptureSet, ContactCircle, Press
from taccel_lab.calibration.capture.split import PressSplit
from taccel_lab.calibration.color.evaluate import ImageScore, score_image
from taccel_lab.calibration.color.frames import NO_DRIFT, ColorFrame
from taccel_lab.calibration.color.light_beside import fit_light_beside, too_little_left
from taccel_lab.calibration.color.network_fit import ColorFit
from taccel_lab.calibration.color.registration import place_press
from taccel_lab.calibration.color.tiles import even_tiles, filled_from
from taccel_lab.calibration.contacts.fit import place_heldout
from taccel_lab.calibration.contacts.labels import LabelPlacement
from taccel_lab.calibration.light.light import Light
from taccel_lab.calibration.result import mean_figures
from taccel_lab.calibration.surfaces.ball_in_layer import SurfaceMaker
from taccel_lab.calibration.surfaces.moved_press import moved_surfaces
from taccel_lab.calibration.surfaces.press_surface import PressSurface
from taccel_lab.calibration.surfaces.radial import RadialSurfaces
from taccel_lab.errors import InputError
from taccel_lab.signals.tactile_image import tactile_images

Placement = Literal["label", "tiles", "self"]
PLACEMENTS: tuple[Placement, ...] = ("label", "tiles", "self")


@dataclass(frozen=True)
class HeldoutSet:
    """Presses that only the scores see."""

    captures: CaptureSet
    """Their images are read when the model is frozen, not before."""
    surfaces: SurfaceMaker
    """Makes the surfaces under them, then."""
    split: PressSplit
    """How they were chosen."""

    @classmethod
    def of(
        cls, captures: CaptureSet, split: PressSplit, surfaces: SurfaceMaker
    ) -> HeldoutSet | None:
        """Those of ``captures`` that ``split`` holds out; None where it holds none out."""
        return cls(captures.only(split.heldout), surfaces, split) if split.heldout else None


@dataclass(frozen=True)
class Placed:
    """A press rendered where it was placed in one of the ways."""

    circle: ContactCircle
    rendered: np.ndarray
    """RGB levels in the light of the background, float32, shape [height_px, width_px, 3]."""
    shown: np.ndarray
    """The same in the light of the capture: its drift applied where the fit took drift off."""
    score: ImageScore
    """Of ``shown``."""


@dataclass(frozen=True)
class HeldoutPress:
    """A press the fit never saw: capture, renders and figures."""

    name: str
    captured: np.ndarray
    """RGB uint8, shape [height_px, width_px, 3]."""
    circle: ContactCircle
    """Circle in which the figures are taken: the label, or what was found without one."""
    placed: Mapping[Placement, Placed]
    surface: PressSurface
    """Under the press where its label puts it; without one, where its even tiles do."""
    pixels: np.ndarray | None
    """Pixels that may be scored there: all (None), or the odd tiles, shape [height_px, width_px]"""
    background_only: ImageScore
    """The captured background alone against the capture."""


@dataclass(frozen=True)
class HeldoutFailure:
    """A press that was held out and cannot be rendered."""

    name: str
    reason: str
    background_only: ImageScore | None
    """None where nobody knows where to look: the worst of the other presses then counts."""


def without_light(captures: CaptureSet, remove_drift: bool) -> dict[str, str]:
    """Held-out presses whose light cannot be told, by their labels alone: name and reason.

    Known before the fit, so that nobody waits for it to hear that a contact is too large.
    """
    found = {}
    for press in captures.presses:
        if remove_drift and press.circle is not None:
            reason = too_little_left(press.circle, captures.grid, captures.mask)
            if reason:
                found[press.name] = reason
    return found


def score_heldout(
    held: HeldoutSet,
    fit: ColorFit,
    shift: LabelPlacement,
    library: RadialSurfaces,
) -> tuple[list[HeldoutPress], list[HeldoutFailure]]:
    """Place and score the held-out presses; ``fit`` and all that led to it stay as they are.

    ``shift`` and ``library`` come from the training presses.
    """
    return _HeldoutScoring(held, fit, shift, library).run()


def mean_heldout(
    presses: Sequence[HeldoutPress], failures: Sequence[HeldoutFailure], placement: Placement
) -> dict[str, float]:
    """Mean figures of all held-out presses placed one way, failures as the bare background."""
    return mean_figures(
        [item.placed[placement].score for item in presses] + _bare(presses, failures)
    )


def mean_bare(
    presses: Sequence[HeldoutPress], failures: Sequence[HeldoutFailure]
) -> dict[str, float]:
    """Mean figures of the bare background over all held-out presses."""
    return mean_figures([item.background_only for item in presses] + _bare(presses, failures))


def _bare(presses: Sequence[HeldoutPress], failures: Sequence[HeldoutFailure]) -> list[ImageScore]:
    known = [item.background_only for item in presses]
    known += [item.background_only for item in failures if item.background_only is not None]
    if not known:
        return []
    worst = min(known, key=lambda score: score.crop_psnr_db)
    return [item.background_only or worst for item in failures]


class _HeldoutScoring:
    def __init__(
        self, held: HeldoutSet, fit: ColorFit, shift: LabelPlacement, library: RadialSurfaces
    ) -> None:
        self.captures, self.make, self.split = held.captures, held.surfaces, held.split
        self.fit, self.shift, self.library = fit, shift, library
        self.grid, self.mask = held.captures.grid, held.captures.mask
        self.failures: list[HeldoutFailure] = [
            HeldoutFailure(name, "it was left out of the captures", None)
            for name in held.split.gone
        ]

    def run(self) -> tuple[list[HeldoutPress], list[HeldoutFailure]]:
        started: list[tuple[Press, np.ndarray, ContactCircle]] = []
        for press in self.captures.presses:
            image = press.image()
            try:
                started.append((press, image, self._start(press, image)))
            except InputError as error:
                self.failures.append(HeldoutFailure(press.name, str(error), None))
        surfaces = self._surfaces([s[0] for s in started], [s[2] for s in started])
        found = []
        for (press, image, start), surface in zip(started, surfaces, strict=True):
            figures_in = press.circle or start
            bare = score_image(self.captures.background, image, figures_in, self.grid)
            reason = surface if isinstance(surface, str) else self._no_light(figures_in)
            if isinstance(surface, str) or reason:
                self.failures.append(HeldoutFailure(press.name, reason, bare))
                continue
            found.append(self._scored(press, image, figures_in, start, surface, bare))
        return found, self.failures

    def _start(self, press: Press, image: np.ndarray) -> ContactCircle:
        """Where the label puts a press; without a label, what its even tiles show."""
        ball_px = self._ball_px(press)
        if press.circle is None:
            seen = even_tiles(self.grid, ball_px) & self.mask
            image = filled_from(image, self.captures.background, seen)
        found = place_heldout(press, image, self.captures, self.shift)
        return replace(found, radius_px=min(found.radius_px, EQUATOR_SLACK * ball_px))

    def _ball_px(self, press: Press) -> float:
        return (press.radius_mm or self.captures.ball_radius_mm) / self.grid.mm_per_px_x

    def _surfaces(
        self, presses: Sequence[Press], circles: Sequence[ContactCircle]
    ) -> list[PressSurface | str]:
        """The surfaces, or why there is none; one that cannot be made spoils no other."""
        if not presses:
            return []
        chosen = replace(self.captures, presses=tuple(presses))
        try:
            return list(self.make(chosen, circles))
        except InputError:
            found: list[PressSurface | str] = []
            for i, circle in enumerate(circles):
                try:
                    found += self.make(chosen.only([i]), [circle])
                except InputError as error:
                    found.append(f"it has no surface: {error}")
            return found

    def _no_light(self, circle: ContactCircle) -> str:
        if not self.fit.options.remove_drift:
            return ""
        return too_little_left(circle, self.grid, self.mask)

    def _scored(
        self,
        press: Press,
        image: np.ndarray,
        figures_in: ContactCircle,
        start: ContactCircle,
        surface: PressSurface,
        bare: ImageScore,
    ) -> HeldoutPress:
        drift = NO_DRIFT
        if self.fit.options.remove_drift:
            drift = fit_light_beside(image, self.fit.background, figures_in, self.grid, self.mask)
        even = even_tiles(self.grid, self._ball_px(press))
        frame = ColorFrame(press.name, image, start, surface)
        labelled = press.circle is not None
        on_tiles = self._moved(frame, drift, self.mask & even)
        ways: dict[Placement, ColorFrame] = {"label": frame} if labelled else {}
        ways |= {"tiles": on_tiles, "self": self._moved(frame, drift, self.mask)}
        renders = tactile_images(
            self.fit.model, self.fit.background, [way.surface for way in ways.values()]
        )
        placed: dict[Placement, Placed] = {}
        for (name, way), rendered in zip(ways.items(), renders, strict=True):
            shown = np.clip(drift.apply(rendered), 0.0, 255.0)
            pixels = ~even if name == "tiles" else None
            score = score_image(shown, image, figures_in, self.grid, pixels)
            placed[name] = Placed(way.circle, rendered, shown, score)
        return HeldoutPress(
            press.name, image, figures_in, placed,
            surface if labelled else on_tiles.surface, None if labelled else ~even, bare,
        )  # fmt: skip

    def _moved(self, frame: ColorFrame, drift: Light, mask: np.ndarray) -> ColorFrame:
        """The press where the frozen model puts it, looking at the pixels of ``mask``."""
        circle = place_press(
            self.fit.model, self.fit.background, frame, self.library, self.grid, drift, mask=mask
        )
        (surface,) = moved_surfaces([frame.surface], [frame.circle], [circle], self.library)
        return replace(frame, circle=circle, surface=surface)
