# SPDX-License-Identifier: Apache-2.0
"""Captures and simulated surfaces to the profile blocks ``background`` and ``color``.

Presses are split into those that are fitted and those that are held out; figures are those of the
held-out presses, with the bare background beside them, and of all presses by fits without them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from calibration.background.drift import fit_drift
from calibration.capture.captures import CaptureSet, ContactCircle
from calibration.color_result import ColorCalibration, HeldoutRender, PressScore, Spread
from calibration.estimators.color import (
    ColorFit,
    ColorFitOptions,
    ColorFrame,
    DriftChoice,
    FoldResult,
    Progress,
    Registration,
    choose_drift,
    fit_color_model,
    fold_fits,
    register_others,
    register_presses,
)
from calibration.estimators.color.frames import NO_DRIFT
from calibration.estimators.color.registration import MIN_PRESSES
from calibration.evaluate import noise_floor_l1, score_image
from calibration.result import Remark
from calibration.surfaces.radial import RadialSurfaces
from calibration.surfaces.types import PressSurface
from calibration.surfaces.variation import moved_surfaces
from calibration.taxim_table import fit_taxim_table, render_taxim_table
from taccel_lab.errors import InputError

__all__ = ["ColorCalibration", "ColorPlan", "HeldoutRender", "calibrate_color"]

Stage = Callable[[str], None]
"""Told what is being done."""
SPREAD_PIXELS = 2000
"""Pixels of each press at which the fits' disagreement is taken."""


@dataclass(frozen=True)
class ColorPlan:
    """What is done besides the fit itself; the defaults fit and score the held-out presses."""

    holdout_every: int = 4
    """Every how-manieth press is held out; 0 holds none out."""
    drift: Literal["auto", "on", "off"] | None = None
    """Whether drift is taken off; ``auto`` compares; None leaves it to the fit's options."""
    register: bool = False
    """Read the circles again with the colours of the other presses."""
    folds: int = 0
    """Fits that leave presses out, over all presses; 0 for none."""
    table: bool = False
    """Fit Taxim's table too, as a baseline and for export."""


def calibrate_color(
    captures: CaptureSet,
    circles: Sequence[ContactCircle],
    surfaces: Sequence[PressSurface],
    *,
    holdout_every: int = 4,
    options: ColorFitOptions | None = None,
    folds: int = 0,
    plan: ColorPlan | None = None,
    remarks: Sequence[Remark] = (),
    progress: Progress | None = None,
    stage: Stage | None = None,
) -> ColorCalibration:
    """Fit the colour model to the captures' training presses and score it on the others.

    ``circles`` and ``surfaces`` belong to the presses of ``captures``, in order. Figures are taken
    in the circle given with a press where there is one, so that they do not depend on how the
    circles for the simulation were chosen. ``folds`` > 1 also cross-validates over all presses.
    ``plan`` says more, and then rules over ``holdout_every`` and ``folds``. ``remarks`` are what is
    known of the captures already.
    """
    if not len(circles) == len(surfaces) == len(captures.presses):
        raise InputError(
            f"{len(captures.presses)} presses need as many circles and surfaces, got "
            f"{len(circles)} and {len(surfaces)}"
        )
    plan = plan or ColorPlan(holdout_every=holdout_every, folds=folds)
    frames = [
        ColorFrame(press.name, press.image(), circle, surface, press.sha256)
        for press, circle, surface in zip(captures.presses, circles, surfaces, strict=True)
    ]
    job = _Job(captures, frames, plan, options or ColorFitOptions(), stage or (lambda _: None))
    return job.run(surfaces, tuple(remarks), progress)


@dataclass
class _Job:
    captures: CaptureSet
    frames: list[ColorFrame]
    plan: ColorPlan
    options: ColorFitOptions
    tell: Stage
    drift: DriftChoice | None = None
    registration: Registration | None = None
    train: list[int] = field(default_factory=list)
    held: list[int] = field(default_factory=list)

    def run(
        self,
        surfaces: Sequence[PressSurface],
        remarks: tuple[Remark, ...],
        progress: Progress | None,
    ) -> ColorCalibration:
        captures, grid, mask = self.captures, self.captures.grid, self.captures.mask
        self.train, self.held = captures.split(self.plan.holdout_every)
        self._choose_drift()
        start = [frame.circle for frame in self.frames]
        if self.plan.register and len(self.train) >= MIN_PRESSES:
            self._register_training()
        self.tell("fitting the colour model")
        training = [self.frames[i] for i in self.train]
        fit = fit_color_model(
            training, captures.background, grid, self.options, mask=mask, progress=progress
        )
        if self.registration is not None and self.held:
            self._register_held(fit)
        found: FoldResult | None = None
        if self.plan.folds > 1:
            self.tell("cross-validating")
            found = fold_fits(
                self.frames, captures.background, grid, self.options, folds=self.plan.folds,
                mask=mask, progress=progress,
            )  # fmt: skip
        table = fit_taxim_table(training, fit, grid, mask=mask) if self.plan.table else None
        held = [self._render(i, fit) for i in self.held]
        return ColorCalibration(
            fit=fit,
            heldout=held,
            train_names=[frame.name for frame in training],
            noise_floor_l1=self._noise_floor(),
            validated=[] if found is None else self._validated(found),
            source=captures.source,
            provenance=captures.provenance,
            background_sha256=captures.background_sha256,
            surface_provider=", ".join(sorted({surface.provider for surface in surfaces})),
            valid_region=_valid_region(training),
            circles=tuple(frame.circle for frame in self.frames),
            start_circles=tuple(start),
            press_names=tuple(frame.name for frame in self.frames),
            grid=grid,
            drift_choice=self.drift,
            registration=self.registration,
            spread=None if found is None else self._spread(found),
            table=table,
            table_scores=[]
            if table is None
            else [
                self._scored(
                    i,
                    render_taxim_table(table, self.frames[i].surface, fit.background),
                    fit,
                )[1]
                for i in self.held
            ],
            capture_remarks=remarks,
        )

    def _choose_drift(self) -> None:
        wanted = self.plan.drift
        if wanted is None:
            return
        if wanted == "auto":
            self.tell("comparing fits with and without drift")
            captures = self.captures
            self.drift = choose_drift(
                [self.frames[i] for i in self.train], captures.background, captures.grid,
                mask=captures.mask, seed=self.options.seed,
            )  # fmt: skip
        else:
            self.drift = DriftChoice(wanted == "on", reason="as asked")
        self.options = replace(self.options, remove_drift=self.drift.remove)

    def _register_training(self) -> None:
        self.tell("reading the circles again with the colours")
        captures = self.captures
        self.registration = register_presses(
            [self.frames[i] for i in self.train],
            captures.background,
            captures.grid,
            mask=captures.mask,
            remove_drift=self.options.remove_drift,
            seed=self.options.seed,
        )
        self._library = RadialSurfaces.of(
            [self.frames[i].surface for i in self.train],
            [self.frames[i].circle for i in self.train],
            captures.grid,
        )
        self._move(self.train, self.registration.circles)

    def _register_held(self, fit: ColorFit) -> None:
        """Held-out presses are placed by the finished model: only their circles change."""
        assert self.registration is not None
        captures, frames = self.captures, [self.frames[i] for i in self.held]
        drifts = [
            fit_drift(f.image, captures.background, f.circle, captures.grid, captures.mask)
            if self.options.remove_drift
            else NO_DRIFT
            for f in frames
        ]
        circles = register_others(
            fit.model, fit.background, frames, self._library, captures.grid, drifts,
            scale=self.registration.scale, mask=captures.mask,
        )  # fmt: skip
        self._move(self.held, circles)

    def _move(self, indices: Sequence[int], circles: Sequence[ContactCircle]) -> None:
        frames = [self.frames[i] for i in indices]
        surfaces = moved_surfaces(
            [f.surface for f in frames], [f.circle for f in frames], circles, self._library
        )
        for i, frame, circle, surface in zip(indices, frames, circles, surfaces, strict=True):
            self.frames[i] = replace(frame, circle=circle, surface=surface)

    def _render(self, index: int, fit: ColorFit) -> HeldoutRender:
        frame = self.frames[index]
        surface = frame.surface
        rendered = fit.model.render(
            surface.normals, surface.displacement_mm(), surface.rest_normals, fit.background
        )
        circle, score = self._scored(index, rendered, fit)
        return HeldoutRender(
            name=frame.name,
            captured=frame.image,
            rendered=rendered,
            corrected=score.corrected_image,
            circle=circle,
            score=score.plain,
            score_drift_corrected=score.corrected,
            background_only=score_image(
                self.captures.background, frame.image, circle, self.captures.grid
            ),
        )

    def _scored(
        self, index: int, rendered: np.ndarray, fit: ColorFit
    ) -> tuple[ContactCircle, PressScore]:
        frame, grid = self.frames[index], self.captures.grid
        given = self.captures.presses[index].circle
        circle = frame.circle if given is None else given
        corrected = rendered
        try:
            drift = fit_drift(frame.image, fit.background, frame.circle, grid, self.captures.mask)
            corrected = np.clip(drift.apply(rendered), 0.0, 255.0)
        except InputError:
            # No untouched pixels to fit a drift to: the render as it is.
            pass
        return circle, PressScore(
            frame.name,
            score_image(rendered, frame.image, circle, grid),
            score_image(corrected, frame.image, circle, grid),
            corrected,
        )

    def _validated(self, found: FoldResult) -> list[PressScore]:
        scores = []
        for i, frame in enumerate(self.frames):
            fit, surface = found.fit_without(i), frame.surface
            rendered = fit.model.render(
                surface.normals, surface.displacement_mm(), surface.rest_normals, fit.background
            )
            score = self._scored(i, rendered, fit)[1]
            scores.append(replace(score, corrected_image=np.empty(0)))
        return scores

    def _spread(self, found: FoldResult) -> Spread:
        """Disagreement of the fits inside and outside the contacts."""
        grid = self.captures.grid
        inside, beside = [], []
        for frame in self.frames:
            away = frame.circle.distance_px(grid) / frame.circle.radius_px
            for region, kept in ((away <= 1, inside), ((away > 1) & (away <= 2), beside)):
                idx = np.flatnonzero(region & self.captures.mask)
                idx = idx[:: max(1, len(idx) // SPREAD_PIXELS)]
                if len(idx):
                    kept.append(found.spread_levels(frame, idx).mean())
        return Spread(float(np.mean(inside)), float(np.mean(beside)), len(found.fits))

    def _noise_floor(self) -> float:
        floors = []
        for frame in self.frames:
            try:
                floors.append(
                    noise_floor_l1(
                        frame.image, self.captures.background, frame.circle, self.captures.grid
                    )
                )
            except InputError:
                # This contact fills the image; the others tell the floor.
                continue
        return float(np.mean(floors)) if floors else math.nan


def _valid_region(frames: Sequence[ColorFrame]) -> dict[str, tuple[float, float]]:
    """Where the training presses lie: positions of the contacts, slopes and displacements."""
    u = [frame.circle.u_px for frame in frames]
    v = [frame.circle.v_px for frame in frames]
    tilt = max(math.degrees(math.acos(min(1.0, f.surface.normals[..., 2].min()))) for f in frames)
    low = min(float(f.surface.displacement_mm().min()) for f in frames)
    high = max(float(f.surface.displacement_mm().max()) for f in frames)
    return {
        "contact_u_px": (min(u), max(u)),
        "contact_v_px": (min(v), max(v)),
        "surface_tilt_deg": (0.0, tilt),
        "displacement_mm": (low, high),
    }
