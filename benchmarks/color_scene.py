# SPDX-License-Identifier: Apache-2.0
"""Real captures as ``calibrate color`` prepares them, for fits with other settings than its own.

Circles, surfaces, drift and background are made once for all fits that share them; what is scored
is rendered where its label puts it, in its crop alone.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.calibration.background.drift import Drift, fit_drift
from taccel_lab.calibration.capture import CaptureSet, load_captures
from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.calibration.color.drift_choice import choose_drift
from taccel_lab.calibration.color.evaluate import crop_slices, psnr_db
from taccel_lab.calibration.color.fit_options import ColorFitOptions
from taccel_lab.calibration.color.frames import NO_DRIFT, ColorFrame, draw_samples, frame_drift
from taccel_lab.calibration.color.network_fit import rest_background
from taccel_lab.calibration.color.registration import RegistrationOptions, register_presses
from taccel_lab.calibration.color.taxim_table import fit_taxim_table, render_taxim_table
from taccel_lab.calibration.color.training import train
from taccel_lab.calibration.contacts import choose_circles, usable_presses
from taccel_lab.calibration.contacts.label_placement import LabelPlacement
from taccel_lab.calibration.simulate import simulate_presses
from taccel_lab.calibration.surfaces.design import fitted_design
from taccel_lab.calibration.surfaces.radial import RadialSurfaces
from taccel_lab.calibration.surfaces.types import PressSurface
from taccel_lab.calibration.surfaces.variation import moved_surfaces
from taccel_lab.profile import CameraBlock, Provenance
from taccel_lab.signals.color_model import ColorModel

HOLDOUT_EVERY = 4
"""As ``taccel-lab calibrate color`` has it."""
DEFAULT = ColorFitOptions(batch_pixels=1024)
"""Likewise."""


@dataclass(frozen=True)
class Candidate:
    """What differs from the defaults."""

    fit: Mapping[str, Any] = field(default_factory=dict)
    """Of ``ColorFitOptions``."""
    circles: Mapping[str, Any] = field(default_factory=dict)
    """Of ``RegistrationOptions``."""
    table: Mapping[str, Any] | None = None
    """Of ``fit_taxim_table``, for a candidate that is a table; None for a network."""

    def joined(self, other: Candidate) -> Candidate:
        """Both at once."""
        table = None if other.table is None else {**(self.table or {}), **other.table}
        return Candidate({**self.fit, **other.fit}, {**self.circles, **other.circles}, table)


NETWORK, TABLE = Candidate(), Candidate(table={})


def network(**fit: Any) -> Candidate:
    """A network with other settings of its fit; those that are the default's are dropped."""
    return Candidate({k: v for k, v in fit.items() if getattr(DEFAULT, k) != v})


def circles(**settings: Any) -> Candidate:
    """A network whose circles are read with other settings."""
    default = RegistrationOptions()
    return Candidate(circles={k: v for k, v in settings.items() if getattr(default, k) != v})


def table(**settings: Any) -> Candidate:
    """A Taxim table with other settings."""
    default = inspect.signature(fit_taxim_table).parameters
    return Candidate(table={k: v for k, v in settings.items() if default[k].default != v})


@dataclass(frozen=True)
class Target:
    """A press that is rendered: what the camera saw, and the surface where its label puts it."""

    image: np.ndarray
    label: ContactCircle
    surface: PressSurface
    drift: Drift


@dataclass(frozen=True)
class Placed:
    """Presses to fit in their circles, and those to render."""

    frames: list[ColorFrame]
    drifts: dict[str, Drift]
    background: np.ndarray
    targets: list[Target]


class Scene:
    """A set of captures with its circles and surfaces, as ``calibrate color`` makes them."""

    def __init__(self, name: str, folder: Path) -> None:
        self.name = name
        captures = load_captures(folder)
        split = captures.split(HOLDOUT_EVERY)
        self.heldout = captures.only(split.heldout)
        self.training, found, _ = usable_presses(captures.only(split.train), cache=True)
        self.circles = choose_circles(self.training, found, "fused")
        where = Provenance(kind="published", method="as the captures state", source=name)
        self.profile = (
            fitted_design(captures.sensor, captures.grid)
            .profile.without("background", "color", "normals")
            .with_block(CameraBlock.from_grid(captures.grid, where))
        )
        self._laws: dict[float, Any] = {}
        self.surfaces = self._made(self.training, self.circles)
        self.frames = [
            ColorFrame(press.name, press.image(), circle, surface)
            for press, circle, surface in zip(
                self.training.presses, self.circles, self.surfaces, strict=True
            )
        ]
        self.drift = choose_drift(
            self.frames, captures.background, captures.grid, mask=captures.mask
        )

    def _made(self, captures: CaptureSet, circles: Sequence[ContactCircle]) -> list[PressSurface]:
        return simulate_presses(
            captures, circles, self.profile, cache=True, share=True, laws=self._laws
        )

    def circles_again(
        self, kept: Sequence[int], settings: RegistrationOptions, seed: int
    ) -> list[ContactCircle]:
        """Circles of the training presses ``kept``, read again without any other press."""
        training = self.training
        return register_presses(
            [self.frames[i] for i in kept], training.background, training.grid,
            mask=training.mask, remove_drift=self.drift.remove, seed=seed, settings=settings,
        ).circles  # fmt: skip

    def placed(
        self, kept: Sequence[int], circles: Sequence[ContactCircle], targets: CaptureSet
    ) -> Placed:
        """Training presses ``kept`` in ``circles``, and presses to render where labels put them."""
        training, grid = self.training, self.training.grid
        frames = [self.frames[i] for i in kept]
        start, surfaces = [f.circle for f in frames], [f.surface for f in frames]
        moved = moved_surfaces(surfaces, start, circles, RadialSurfaces.of(surfaces, start, grid))
        frames = [
            replace(frame, circle=circle, surface=surface)
            for frame, circle, surface in zip(frames, circles, moved, strict=True)
        ]
        options = replace(DEFAULT, remove_drift=self.drift.remove)
        background = training.background
        drifts = {f.name: frame_drift(f, background, grid, training.mask, options) for f in frames}
        rest = rest_background(frames, background, drifts, grid, training.mask, options)
        shift = LabelPlacement.of([training.presses[i] for i in kept], circles)
        return Placed(frames, drifts, rest, self._targets(targets, shift, rest))

    def _targets(
        self, captures: CaptureSet, shift: LabelPlacement, background: np.ndarray
    ) -> list[Target]:
        grid, labels = captures.grid, [p.circle for p in captures.presses if p.circle is not None]
        ball_px = [(p.radius_mm or captures.ball_radius_mm) / grid.mm_per_px_x
                   for p in captures.presses]  # fmt: skip
        circles = [shift.applied(*each) for each in zip(labels, ball_px, strict=True)]
        found = []
        for press, label, surface in zip(
            captures.presses, labels, self._made(captures, circles), strict=True
        ):
            image, drift = press.image(), NO_DRIFT
            if self.drift.remove:
                drift = fit_drift(image, background, label, grid, captures.mask)
            found.append(Target(image, label, surface, drift))
        return found

    def figures(self, placed: Placed, candidate: Candidate, seed: int) -> list[list[float]]:
        """PSNR of the crop [dB] and L1 in the disc [levels] of every target."""
        grid, mask = self.training.grid, self.training.mask
        options = replace(DEFAULT, remove_drift=self.drift.remove, seed=seed, **candidate.fit)
        if candidate.table is None:
            samples = draw_samples(
                placed.frames, placed.background, placed.drifts, grid, mask, options
            )
            model = train(samples, grid, options).model
            return [
                self._scored(t, _network_crop(model, placed.background)) for t in placed.targets
            ]
        table = fit_taxim_table(
            placed.frames, placed.background, placed.drifts, grid, mask=mask, **candidate.table
        )

        def crop(surface: PressSurface, where: tuple[slice, slice]) -> np.ndarray:
            return render_taxim_table(table, surface, placed.background)[where]

        return [self._scored(target, crop) for target in placed.targets]

    def _scored(
        self, target: Target, render: Callable[[PressSurface, tuple[slice, slice]], np.ndarray]
    ) -> list[float]:
        grid = self.training.grid
        where = crop_slices(target.label, grid)
        shown = np.clip(target.drift.apply(render(target.surface, where)), 0.0, 255.0)
        captured = target.image[where]
        disc = target.label.distance_px(grid)[where] <= target.label.radius_px
        psnr = psnr_db(shown, captured)
        return [round(psnr, 4), round(float(np.abs(shown - captured)[disc].mean()), 4)]


def _network_crop(
    model: ColorModel, background: np.ndarray
) -> Callable[[PressSurface, tuple[slice, slice]], np.ndarray]:
    def crop(surface: PressSurface, where: tuple[slice, slice]) -> np.ndarray:
        index = np.arange(background.shape[0] * background.shape[1]).reshape(background.shape[:2])
        change = model.predict_pixels(
            index[where].ravel(), surface.normals[where].reshape(-1, 3),
            surface.displacement_mm()[where].ravel(), surface.rest_normals[where].reshape(-1, 3),
        )  # fmt: skip
        return np.clip(background[where] + change.reshape(background[where].shape), 0.0, 255.0)

    return crop


def measure(
    scene: Scene,
    parts: Iterable[tuple[Sequence[int], CaptureSet]],
    candidates: Mapping[str, Candidate],
    seed: int,
) -> dict[str, list[list[float]]]:
    """Figures of the targets of all ``parts`` in order, by candidate.

    A part holds the training presses that are fitted, and the presses that are rendered.
    """
    found: dict[str, list[list[float]]] = {name: [] for name in candidates}
    for kept, targets in parts:
        placings: list[tuple[list[ContactCircle], Placed, dict[str, list[list[float]]]]] = []
        by_settings: dict[str, dict[str, Candidate]] = {}
        for name, candidate in candidates.items():
            by_settings.setdefault(repr(sorted(candidate.circles.items())), {})[name] = candidate
        for group in by_settings.values():
            settings = RegistrationOptions(**next(iter(group.values())).circles)
            again = scene.circles_again(kept, settings, seed)
            # Settings that lead to the same circles lead to the same fits.
            if not any(again == circles for circles, _, _ in placings):
                placings.append((again, scene.placed(kept, again, targets), {}))
            placed, known = next((p, k) for circles, p, k in placings if again == circles)
            for name, candidate in group.items():
                key = repr((candidate.fit, candidate.table))
                if key not in known:
                    known[key] = scene.figures(placed, candidate, seed)
                found[name] += known[key]
    return found
