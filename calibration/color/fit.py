# SPDX-License-Identifier: Apache-2.0
"""Captures and the surfaces of their presses to the profile blocks ``background`` and ``color``.

All that is chosen rests on the training presses; then the model is frozen, and the held-out
presses are read, placed and scored (``taccel_lab.calibration.color.heldout``). Last, the same fit
is made to all presses: profiles get that one, with the scores of the first.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import partial

import numpy as np

from taccel_lab.calibration.ball_presses import ball_presses
from taccel_lab.calibration.capture.captures import CaptureSet, ContactCircle
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.circles.ball_surface import BallSurface, layer_of, layer_surfaces
from taccel_lab.calibration.circles.labels import LabelPlacement
from taccel_lab.calibration.color.evaluate import ImageScore, score_image
from taccel_lab.calibration.color.fit_options import ColorFitOptions
from taccel_lab.calibration.color.frames import ColorFrame
from taccel_lab.calibration.color.heldout import (
    HeldoutFailure,
    HeldoutPress,
    HeldoutSet,
    score_heldout,
)
from taccel_lab.calibration.color.network_fit import ColorFit, fit_color_model
from taccel_lab.calibration.color.options import ColorOptions, ColorTraining
from taccel_lab.calibration.color.remarks import color_remarks
from taccel_lab.calibration.color.result import ColorCalibration, PressScore
from taccel_lab.calibration.color.taxim_table import fit_taxim_table, render_taxim_table
from taccel_lab.calibration.color.untouched_light import light_beside, noise_floor_l1
from taccel_lab.errors import InputError
from taccel_lab.exporters.taxim_table import TaximTable
from taccel_lab.networks.color_settings import STEEPEST
from taccel_lab.profile import SensorProfile
from taccel_lab.progress import Progress, silent
from taccel_lab.report.remark import Remark
from taccel_lab.signals.color_model import ColorModel
from taccel_lab.signals.rest_surface import rest_surface

SCORING = "scoring the held-out presses"
ASKED_ELSEWHERE = frozenset({"sensor_unknown"})
"""Findings of the check that the calibration says in its own words."""


def calibrate_color(
    folder: CaptureFolder,
    base: SensorProfile,
    options: ColorOptions = ColorOptions(),
    progress: Progress = silent,
) -> ColorCalibration:
    """Fit the colour model to the ball presses of ``folder``.

    Args:
        folder: Its background and presses are used.
        base: Profile that the result extends: its gel is what the ball sinks into.
        options: Which presses are fitted, and how.
        progress: Told what is done.

    Raises:
        InputError: Captures that no model can be fitted to, with what their check found.
    """
    settings = ColorFitOptions(
        **{item.name: getattr(options, item.name) for item in fields(ColorTraining)}
    )
    presses = ball_presses(folder, base, "color", options, progress, cache=options.cache)
    findings = [item for item in presses.findings if item.code not in ASKED_ELSEWHERE]
    surfaces = partial(
        layer_surfaces,
        layer=layer_of(presses.profile),
        rest=rest_surface(presses.profile.mesh, presses.captures.grid),
    )
    found = fit_color(
        presses.training,
        presses.circles,
        presses.surfaces,
        HeldoutSet.of(presses.captures, presses.split, surfaces),
        options=settings,
        background=presses.profile.background_rgb,
        labels=presses.labels,
        table=options.table,
        remarks=(*presses.lost, *findings, *presses.remarks),
        progress=progress,
    )
    return replace(found, gel=presses.gel, untouched=presses.untouched)


def fit_color(
    captures: CaptureSet,
    circles: Sequence[ContactCircle],
    surfaces: Sequence[BallSurface],
    heldout: HeldoutSet | None = None,
    *,
    options: ColorFitOptions = ColorFitOptions(),
    background: np.ndarray | None = None,
    labels: LabelPlacement | None = None,
    table: bool = False,
    remarks: Sequence[Remark] = (),
    progress: Progress = silent,
) -> ColorCalibration:
    """Fit the colour model to ``captures`` and score it on ``heldout``.

    Args:
        captures: The training presses alone.
        circles: Their contact circles, in order.
        surfaces: Their surfaces, in order.
        heldout: Presses that are read when the model is frozen; None leaves figures out.
        options: Settings of the fit.
        background: Untouched sensor to fit and render on, levels; that of ``captures`` when None.
        labels: Where labels put held-out presses; by ``circles`` when None.
        table: Fit Taxim's table too, as a baseline and for export.
        remarks: What is known of the captures already.
        progress: Told what is done.

    Raises:
        InputError: Numbers that do not match, a press on both sides, or captures no fit can take.
    """
    if not len(circles) == len(surfaces) == len(captures.presses):
        raise InputError(
            f"{len(captures.presses)} presses need as many circles and surfaces, got "
            f"{len(circles)} and {len(surfaces)}"
        )
    if heldout is not None:
        both = {p.name for p in captures.presses} & {p.name for p in heldout.captures.presses}
        if both:
            raise InputError(f"{', '.join(sorted(both))}: held out and fitted at once")
    frames = [
        ColorFrame(press.name, press.image(), circle, surface, press.sha256)
        for press, circle, surface in zip(captures.presses, circles, surfaces, strict=True)
    ]
    untouched = captures.background if background is None else background
    found = _Fitting(captures, frames, untouched, options, progress, labels, table)
    result = found.run(surfaces, heldout)
    return replace(result, remarks=(*remarks, *color_remarks(result)))


@dataclass
class _Fitting:
    """One fit on its way."""

    captures: CaptureSet
    frames: list[ColorFrame]
    background: np.ndarray
    options: ColorFitOptions
    progress: Progress
    labels: LabelPlacement | None
    table: bool

    def run(
        self,
        surfaces: Sequence[BallSurface],
        heldout: HeldoutSet | None,
    ) -> ColorCalibration:
        captures, grid, mask = self.captures, self.captures.grid, self.captures.mask
        circles = tuple(frame.circle for frame in self.frames)
        fit = fit_color_model(
            self.frames, self.background, grid, self.options, mask=mask, progress=self.progress
        )
        table = None
        if self.table:
            table = fit_taxim_table(self.frames, fit.background, fit.drifts, grid, mask=mask)
        shift = self.labels or LabelPlacement.of(captures.presses, circles)
        held: list[HeldoutPress] = []
        failures: list[HeldoutFailure] = []
        if heldout is not None:
            self.progress(SCORING, 0, 1)
            held, failures = score_heldout(heldout, fit, shift)
            self.progress(SCORING, 1, 1)
        every = list(self.frames)
        if heldout is not None:
            every += _joining(heldout, held)
        final = None
        if len(every) > len(self.frames):
            final = fit_color_model(
                every, self.background, grid, self.options, mask=mask, progress=self.progress
            )
        return ColorCalibration(
            fit=fit,
            final=final,
            heldout=held,
            failures=failures,
            split=None if heldout is None else heldout.split,
            label_shift=shift,
            noise_floor_l1=self._noise_floor(),
            captures=captures,
            surface_provider=", ".join(sorted({surface.provider for surface in surfaces})),
            valid_region=_valid_region(every, (final or fit).model),
            circles=circles,
            table=table,
            table_scores=[] if table is None else self._table_scores(table, fit, held),
        )

    def _table_scores(
        self, table: TaximTable, fit: ColorFit, held: Sequence[HeldoutPress]
    ) -> list[PressScore]:
        """Held-out presses by Taxim's table, placed as the model's quoted figures have them."""
        return [
            PressScore(
                item.name,
                self._in_its_light(
                    render_taxim_table(table, item.surface, fit.background),
                    item.captured,
                    item.circle,
                ),
            )
            for item in held
        ]

    def _in_its_light(
        self,
        rendered: np.ndarray,
        captured: np.ndarray,
        circle: ContactCircle,
    ) -> ImageScore:
        """Figures of a render in the light of the capture."""
        grid = self.captures.grid
        light = light_beside(captured, rendered, circle, grid, self.captures.mask)
        return score_image(np.clip(light.apply(rendered), 0.0, 255.0), captured, circle, grid)

    def _noise_floor(self) -> float:
        grid, mask = self.captures.grid, self.captures.mask
        floors = [
            noise_floor_l1(frame.image, self.background, frame.circle, grid, mask)
            for frame in self.frames
        ]
        return float(np.nanmean(floors)) if np.isfinite(floors).any() else math.nan


def _joining(heldout: HeldoutSet, held: Sequence[HeldoutPress]) -> list[ColorFrame]:
    """Held-out presses as the last fit takes them. One that is rendered no better than the bare
    background shows something else."""
    hashes = {press.name: press.sha256 for press in heldout.captures.presses}
    return [
        ColorFrame(press.name, press.captured, press.placed, press.surface, hashes[press.name])
        for press in held
        if press.score.crop_psnr_db > press.background_only.crop_psnr_db
    ]


def _valid_region(
    frames: Sequence[ColorFrame], model: ColorModel
) -> dict[str, tuple[float, float]]:
    """Where the training presses lie: positions of the contacts, slopes and displacements."""
    u = [frame.circle.u_px for frame in frames]
    v = [frame.circle.v_px for frame in frames]
    low = min(float(f.surface.displacement_mm().min()) for f in frames)
    high = max(float(f.surface.displacement_mm().max()) for f in frames)
    return {
        "contact_u_px": (min(u), max(u)),
        "contact_v_px": (min(v), max(v)),
        STEEPEST: (0.0, model.cone_deg),
        "displacement_mm": (low, high),
    }
