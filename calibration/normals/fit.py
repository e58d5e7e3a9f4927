# SPDX-License-Identifier: Apache-2.0
"""Captures of ball presses to the profile block ``normals``: colour and pixel to surface normal.

All figures are those of held-out presses, chosen before any image was read and read when the model
is frozen: in the circles given with them, and in those as the training presses say that labels lie.
Last, the fit goes on with all presses: profiles get that one, with the scores and bands of the
first.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from taccel_lab.calibration.ball_presses import BallPresses, ball_presses
from taccel_lab.calibration.capture.folder import CaptureFolder, source_of
from taccel_lab.calibration.check.remarks import BALL_OR_DIAMETER
from taccel_lab.calibration.check.run import joined
from taccel_lab.calibration.circles.ball_surface import depth_share, diameter_share, layer_of
from taccel_lab.calibration.color.network_fit import fit_color_model
from taccel_lab.calibration.color.options import ColorFitOptions
from taccel_lab.calibration.normals.distilling import distilled
from taccel_lab.calibration.normals.network_fit import InverseFit, InverseTraining, fold_of
from taccel_lab.calibration.normals.options import InverseFitOptions, NormalOptions, NormalTraining
from taccel_lab.calibration.normals.result import NormalCalibration
from taccel_lab.calibration.normals.samples import KnownPress, with_reading_errors
from taccel_lab.calibration.normals.score import read_heldout, reliability_of
from taccel_lab.calibration.normals.synthetic_presses import ImageNoise, SyntheticPresses
from taccel_lab.calibration.remarks import (
    GREY_OR_COLOUR,
    HELDOUT_ERROR,
    NOTHING_HELD_OUT,
    TOO_FEW,
    left_out_remarks,
)
from taccel_lab.calibration.response.frame import (
    CaptureScene,
    CircleSigma,
    FittedPresses,
    PressFrame,
    in_background_light,
    noise_floor_l1,
    place_region,
    press_frames,
)
from taccel_lab.calibration.response.training import one_thread
from taccel_lab.calibration.result import in_figures
from taccel_lab.profile import SensorProfile
from taccel_lab.progress import Progress, counted, silent
from taccel_lab.reading.bonded_layer import BondedLayer
from taccel_lab.reading.slopes import NormalModel
from taccel_lab.report.remark import Remark
from taccel_lab.signals.color_model import ColorModel

CHECKED = 16
"""Synthetic presses that the networks never see and heights are judged by."""
READING = "reading synthetic presses"
READING_BALLS = "reading the training presses"
ENOUGH_PRESSES, LEAST_PRESSES = 8, 4
"""Fitted presses below which a model is only usable, or weak: it knows a few places and slopes."""
GOOD_OVER_FLAT = 0.25
WEAK_OVER_FLAT = 0.5
"""Error over that of guessing a flat surface, above which a model is only usable, or weak."""
GREY_LEVELS = 1.5


def calibrate_normals(
    folder: CaptureFolder,
    base: SensorProfile,
    options: NormalOptions = NormalOptions(),
    progress: Progress = silent,
) -> NormalCalibration:
    """Fit the model from colour to surface normal to the ball presses of ``folder``, against its
    background.

    ``base`` is what the result extends: its face at rest is what normals lean against.

    Raises:
        InputError: Captures that no model can be fitted to, with what their check found.
    """
    settings = InverseFitOptions(
        **{field.name: getattr(options, field.name) for field in fields(NormalTraining)}
    )
    presses = ball_presses(folder, base, "normals", options, progress)
    found = fit_normals(presses.fitted, settings, _unseeing_colors(presses), progress)
    if any(finding.code == BALL_OR_DIAMETER.code for finding in presses.findings):
        circles, captures = presses.fitted.circles, presses.captures
        widest_mm = max(circle.radius_px for circle in circles) * captures.grid.mm_per_px_x
        layer = layer_of(presses.profile)
        share = diameter_share(widest_mm, captures.ball_radius_mm, layer)
        found = replace(found, ball_share=share)
    remarks = joined(presses.findings, (*presses.remarks, *found.remarks))
    return replace(
        found, circles=options.circles, gel=presses.gel, untouched=presses.untouched,
        remarks=(*presses.lost, *remarks),
    )  # fmt: skip


def _unseeing_colors(presses: BallPresses) -> ColorModel | None:
    """The profile's colours, but where held-out presses had a part in them: synthetic presses in
    them would pass on what they know."""
    block = presses.profile.color
    seen = set() if block is None else set(block.provenance.inputs.values())
    held = presses.fitted.heldout
    if held is not None and any(press.sha256 in seen for press in held.captures.presses):
        return None
    return ColorModel.from_profile(presses.profile)


@one_thread()
def fit_normals(
    presses: FittedPresses,
    options: InverseFitOptions = InverseFitOptions(),
    colors: ColorModel | None = None,
    progress: Progress = silent,
) -> NormalCalibration:
    """Fit the inverse model to ``presses`` and score it on those that they hold out.

    Args:
        presses: Presses in their circles, and what is known of their gel.
        options: Settings of the networks and their fit.
        colors: Colours of the sensor, for synthetic presses; fitted to ``presses`` when None.
        progress: Told of the fit's steps.
    """
    captures, heldout, pad = presses.captures, presses.heldout, presses.pad
    scene = CaptureScene.of(captures, presses.background, presses.rest)
    frames = press_frames(captures, presses.circles, presses.surfaces, presses.circle_sigmas_px)
    training = [replace(frame, image=in_background_light(frame.image, scene)) for frame in frames]
    sigmas = [frame.circle_sigma_px for frame in training]
    drawn, unseen = iter(()), iter(())
    if pad is not None and options.synthetic_presses:
        tools = _synthetic_presses(training, scene, pad, colors, options.seed, progress)
        drawn, unseen = tools.presses(options.synthetic_presses, progress), tools.presses(CHECKED)
    networks = InverseTraining(training, scene, options, drawn)
    fit = networks.run(progress)
    config = replace(fit.model.config, **_shown(training, scene))
    model = distilled(NormalModel(config, fit.model.weights), networks, progress=progress)
    checked = counted(unseen, progress, READING, CHECKED)
    balls = counted(_left_out_balls(model, training, scene), progress, READING_BALLS, len(training))
    # What all circles are off by alike is in what each of them is said to be.
    radius_px = min(radius for _, radius in sigmas)
    share = depth_share(
        [(frame.surface, frame.circle) for frame in training],
        radius_px, captures.ball_radius_mm, captures.grid,
        presses.scale_share, presses.thickness_share,
    )  # fmt: skip
    model, synthetic = with_reading_errors(model, checked, balls, scene, share)
    frozen, final, every, items, failures = model.config, None, training, (), {}
    if heldout is not None:
        where = presses.placement
        held = read_heldout(model, heldout, where, scene, _typical(sigmas), progress)
        model, items, failures = held.model, held.items, held.failures
        joining = held.joining()
        every = [*training, *joining]
        if joining:
            again = _in_bands_of(model, networks.go_on(joining, progress), every, scene)
            final = replace(again, model=distilled(again.model, networks, model, progress))
    floors = [noise_floor_l1(frame, scene) for frame in training]
    result = NormalCalibration(
        fit=replace(fit, model=model),
        final=final,
        scene=replace(scene, background=captures.background, mask=captures.mask),
        heldout=items,
        failures=failures,
        rejected=frozenset() if heldout is None else heldout.captures.rejected,
        split=None if heldout is None else heldout.split,
        reliability=reliability_of(items, scene) if in_figures(items) else None,
        synthetic=synthetic,
        gel=None,
        frozen_radius95_sigmas=frozen.radius95_sigmas,
        frozen_along_factor=frozen.along_factor,
        flat_noise_levels=float(np.nanmedian(floors))
        if np.isfinite(floors).any()
        else float("nan"),
        background_sha256=captures.background_sha256,
        source=source_of(captures.provenance, captures.source),
        provenance=captures.provenance,
        circles="given",
        surfaces=presses.surfaces[0].provider,
        valid_region={
            **place_region(every),
            "surface_tilt_deg": (0.0, _shown(every, scene)["cone_deg"]),
        },
    )
    return replace(result, remarks=remarks_of(result, training, scene))


def _synthetic_presses(
    training: Sequence[PressFrame],
    scene: CaptureScene,
    pad: BondedLayer,
    colors: ColorModel | None,
    seed: int,
    progress: Progress,
) -> SyntheticPresses:
    """Presses of other tools in the sensor's pad and colours."""
    if colors is None:
        colors = fit_color_model(training, scene, ColorFitOptions(seed=seed), progress).model
    noise = ImageNoise.of(training, scene, colors)
    deepest_mm = max(frame.surface.depth_mm for frame in training)
    return SyntheticPresses(scene, pad, colors, noise, deepest_mm, np.random.default_rng(seed))


def _left_out_balls(
    model: NormalModel, training: Sequence[PressFrame], scene: CaptureScene
) -> Iterator[KnownPress]:
    """Training presses, each with the network that did not see it."""
    for i, frame in enumerate(training):
        member = fold_of(i, model.config.members, len(training))
        if member is not None:
            yield KnownPress.of_ball(frame, scene, left_out=member)


def _typical(sigmas: Sequence[CircleSigma]) -> CircleSigma:
    center, radius = np.sqrt(np.mean(np.square(sigmas), axis=0))
    return float(center), float(radius)


def _shown(frames: Sequence[PressFrame], scene: CaptureScene) -> dict[str, Any]:
    """What a model was shown, for its settings: the steepest slope and the circles."""
    circles = [frame.circle for frame in frames]
    rim_mm = max(circle.radius_px for circle in circles) * scene.grid.mm_per_px_x
    return {
        "cone_deg": float(np.degrees(np.arcsin(min(1.0, rim_mm / scene.ball_radius_mm)))),
        "presses_px": tuple(float(x) for c in circles for x in (c.u_px, c.v_px, c.radius_px)),
    }


def _in_bands_of(
    scored: NormalModel, last: InverseFit, frames: Sequence[PressFrame], scene: CaptureScene
) -> InverseFit:
    """The last fit with what is known of the scored one's errors: held-out presses tell no more of
    a fit that has seen them. Networks that err more on what they left out expect more, too."""
    factor = max(scored.config.error_factor, last.model.config.error_factor)
    config = replace(scored.config, error_factor=factor, small_hidden=(), **_shown(frames, scene))
    return replace(last, model=NormalModel(config, last.model.weights))


def remarks_of(
    result: NormalCalibration, training: Sequence[PressFrame], scene: CaptureScene
) -> tuple[Remark, ...]:
    """Remarks on the data and on how well the held-out presses are read."""
    found: list[Remark] = []
    if len(training) < ENOUGH_PRESSES:
        count = len(training)
        wanted = "give 30 to 50, spread over the image"
        grave = count < LEAST_PRESSES
        fitted = f"{count} press{'es' * (count != 1)} fitted"
        found.append(TOO_FEW(found=fitted, wanted=wanted, grave=grave))
    if not result.has_scores:
        found.append(NOTHING_HELD_OUT())
    else:
        scores = result.heldout_means("used")
        share = scores["mean_deg"] / max(scores["flat_deg"], 1e-9)
        if share > GOOD_OVER_FLAT:
            grave = share > WEAK_OVER_FLAT
            error = f"{scores['mean_deg']:.1f} degrees, {share:.0%} of what a flat guess is off"
            advice = "check the circles, the ball's radius and the scale, or give more presses"
            found.append(HELDOUT_ERROR(what="normals", error=error, advice=advice, grave=grave))
    found += left_out_remarks(result.failed, result.rejected_deg(), "degrees")
    change = np.mean([_grey_share(frame, scene) for frame in training])
    if change < GREY_LEVELS:
        alike = f"grey (channels change alike, to {change:.1f} levels)"
        found.append(GREY_OR_COLOUR(found=alike, expected="coloured", grave=True))
    return tuple(found)


def _grey_share(frame: PressFrame, scene: CaptureScene) -> float:
    """How far the channels' changes differ inside the contact [levels]."""
    inside = frame.circle.distance_px(scene.grid) <= frame.circle.radius_px
    change = (frame.image - scene.background)[inside]
    return float(np.abs(change - change.mean(axis=1, keepdims=True)).mean())
