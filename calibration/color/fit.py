# SPDX-License-Identifier: Apache-2.0
"""Captures and the surfaces of their presses to the profile blocks ``background`` and ``color``.

All that is chosen rests on the training presses; then the model is frozen, and the held-out
presses are read, placed and scored (``taccel_lab.calibration.color.result``). Last, the same
fit is made to all presses: profiles get that one, with the scores of the first.
"""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from taccel_lab.calibration.ball_presses import ball_presses
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.color.network_fit import fit_color_model
from taccel_lab.calibration.color.options import ColorFitOptions, ColorOptions, ColorTraining
from taccel_lab.calibration.color.result import (
    ColorCalibration,
    HeldoutPress,
    PressScore,
    in_light_of,
    mean_bare,
    score_heldout,
)
from taccel_lab.calibration.color.taxim_table import fit_taxim_table, render_taxim_table
from taccel_lab.calibration.remarks import (
    HELDOUT_ERROR,
    NOTHING_HELD_OUT,
    TOO_FEW,
    left_out_remarks,
    name_some,
    warning,
)
from taccel_lab.calibration.response.frame import (
    CaptureScene,
    FittedPresses,
    HeldoutFailure,
    PressFrame,
    noise_floor_l1,
    place_region,
    press_frames,
    score_image,
)
from taccel_lab.calibration.response.training import one_thread
from taccel_lab.calibration.result import in_figures
from taccel_lab.errors import InputError
from taccel_lab.exporters.taxim_table import TaximTable
from taccel_lab.networks.color_settings import STEEPEST
from taccel_lab.profile import SensorProfile
from taccel_lab.progress import Progress, counted, silent
from taccel_lab.report.remark import Remark
from taccel_lab.signals.tactile_image import tactile_images

SCORING = "scoring the held-out presses"
ASKED_ELSEWHERE = frozenset({"sensor_unknown"})
"""Findings of the check that the calibration says in its own words."""
LEAST_PRESSES = 4
"""Fewest presses: with fewer a model knows a few places and depths, and nothing tells of the
others."""
LEAST_GAIN_DB = 6.0
"""A colour model that beats the bare background by less, in the crop, explains little."""
OUTLIER_FACTOR = 2.5
"""A press that is rendered worse than the median by this factor is named."""
OUTLIER_LEVELS = 3.0
"""And by these levels at least."""
OUTLIERS = warning(
    "outliers",
    "{worse} of {count} presses are rendered much worse than the median of {median:.1f} levels: "
    "{names}; look at their images and circles (taccel-lab capture check), and leave out what is "
    "not a clean ball press",
)


def calibrate_color(
    folder: CaptureFolder,
    base: SensorProfile,
    options: ColorOptions = ColorOptions(),
    progress: Progress = silent,
) -> ColorCalibration:
    """Fit the colour model to the ball presses of ``folder``, against its background.

    ``base`` is what the result extends: its gel is what the ball sinks into.

    Raises:
        InputError: Captures that no model can be fitted to, with what their check found.
    """
    settings = ColorFitOptions(
        **{item.name: getattr(options, item.name) for item in fields(ColorTraining)}
    )
    presses = ball_presses(folder, base, "color", options, progress, cache=options.cache)
    findings = [item for item in presses.findings if item.code not in ASKED_ELSEWHERE]
    found = fit_color(presses.fitted, settings, table=options.table, progress=progress)
    remarks = (*presses.lost, *findings, *presses.remarks, *found.remarks)
    return replace(found, gel=presses.gel, untouched=presses.untouched, remarks=remarks)


@one_thread()
def fit_color(
    presses: FittedPresses,
    options: ColorFitOptions = ColorFitOptions(),
    *,
    table: bool = False,
    progress: Progress = silent,
) -> ColorCalibration:
    """Fit the colour model to ``presses`` and score it on those that they hold out.

    Args:
        presses: Presses in their circles.
        options: Settings of the fit.
        table: Fit Taxim's table too, as a baseline and for export.
        progress: Told what is done.

    Raises:
        InputError: Numbers that do not match, a press on both sides, or captures no fit can take.
    """
    captures, heldout = presses.captures, presses.heldout
    frames = press_frames(captures, presses.circles, presses.surfaces)
    if heldout is not None:
        both = {p.name for p in captures.presses} & {p.name for p in heldout.captures.presses}
        if both:
            raise InputError(f"{', '.join(sorted(both))}: held out and fitted at once")
    scene = CaptureScene.of(captures, presses.background)
    fit = fit_color_model(frames, scene, options, progress)
    taxim = fit_taxim_table(frames, scene, fit.drifts) if table else None
    labels = presses.placement
    held: list[HeldoutPress] = []
    failures: list[HeldoutFailure] = []
    joining: list[PressFrame] = []
    if heldout is not None:
        placed = list(counted(heldout.placed(labels), progress, SCORING, heldout.count))
        failures = [found for found in placed if isinstance(found, HeldoutFailure)]
        shown = [found for found in placed if not isinstance(found, HeldoutFailure)]
        faces = [frame.surface for _, frame in shown]
        rendered = tactile_images(fit.model, fit.background, faces) if faces else []
        for (press, frame), image in zip(shown, rendered, strict=True):
            item = score_heldout(press, frame, image, scene, captures.background)
            held.append(item)
            # One that is rendered no better than the bare background shows something else.
            if item.score.crop_psnr_db > item.background_only.crop_psnr_db:
                joining.append(frame)
    every = [*frames, *joining]
    final = fit_color_model(every, scene, options, progress) if joining else None
    floors = [noise_floor_l1(frame, scene) for frame in frames]
    last = (final or fit).model
    displacements = [frame.surface.displacement_mm() for frame in every]
    result = ColorCalibration(
        fit=fit,
        final=final,
        heldout=held,
        failures=failures,
        split=None if heldout is None else heldout.split,
        label_shift=labels,
        noise_floor_l1=float(np.nanmean(floors)) if np.isfinite(floors).any() else float("nan"),
        captures=captures,
        surface_provider=", ".join(sorted({surface.provider for surface in presses.surfaces})),
        valid_region={
            **place_region(every),
            STEEPEST: (0.0, last.cone_deg),
            "displacement_mm": (
                min(float(mm.min()) for mm in displacements),
                max(float(mm.max()) for mm in displacements),
            ),
        },
        circles=tuple(presses.circles),
        table=taxim,
        table_scores=[] if taxim is None else [_by_table(taxim, item, scene) for item in held],
    )
    return replace(result, remarks=tuple(color_remarks(result)))


def _by_table(table: TaximTable, item: HeldoutPress, scene: CaptureScene) -> PressScore:
    """A held-out press by Taxim's table, placed as the model's quoted figures have it."""
    rendered = render_taxim_table(table, item.surface, scene.background)
    shown = in_light_of(item.captured, rendered, item.circle, scene)
    return PressScore(item.name, score_image(shown, item.captured, item.circle, scene.grid))


def color_remarks(result: ColorCalibration) -> list[Remark]:
    """Remarks on a fit and its figures."""
    found, count = [], len(result.train_names)
    if count < LEAST_PRESSES:
        wanted = (
            "the model holds at their places and depths at best. Give 30 to 50, all over the gel"
        )
        fitted = f"{count} press{'es' * (count != 1)} fitted"
        found.append(TOO_FEW(found=fitted, wanted=wanted, grave=True))
    failures = {item.name: item.reason for item in in_figures(result.failures)}
    return [
        *found,
        *_against_background(result),
        *left_out_remarks(failures, result.rejected, "dB"),
        *_outliers(result),
    ]


def _against_background(result: ColorCalibration) -> list[Remark]:
    if not result.has_scores:
        return [NOTHING_HELD_OUT()]
    model = result.heldout_means()["crop_psnr_db"]
    bare = mean_bare(result.heldout, result.failures)["crop_psnr_db"]
    if model - bare >= LEAST_GAIN_DB:
        return []
    error = f"{model:.1f} dB, the bare background alone by {bare:.1f} dB"
    advice = (
        "circles, scale, ball or background are wrong, or the gel was not pressed where these are"
    )
    return [HELDOUT_ERROR(what="colours", error=error, advice=advice, grave=True)]


def _outliers(result: ColorCalibration) -> list[Remark]:
    values = {**result.fit.disc_l1_train, **result.heldout_l1()}
    if len(values) < 5:
        return []
    median = float(np.median(list(values.values())))
    limit = max(OUTLIER_FACTOR * median, median + OUTLIER_LEVELS)
    worst = sorted((name for name in values if values[name] > limit), key=lambda n: -values[n])
    if not worst:
        return []
    names = name_some([f"{name} ({values[name]:.1f})" for name in worst])
    return [OUTLIERS(worse=len(worst), count=len(values), median=median, names=names)]
