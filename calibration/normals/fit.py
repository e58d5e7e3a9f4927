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

import numpy as np

from taccel_lab.calibration.ball_presses import ball_presses
from taccel_lab.calibration.capture.captures import CaptureSet, ContactCircle
from taccel_lab.calibration.capture.folder import CaptureFolder, source_of
from taccel_lab.calibration.capture.split import PressSplit
from taccel_lab.calibration.check.block_findings import joined
from taccel_lab.calibration.circles.ball_surface import (
    BallSurface,
    depth_share,
    layer_of,
    sunk_share,
)
from taccel_lab.calibration.circles.bonded_layer import BondedLayer
from taccel_lab.calibration.circles.labels import LabelPlacement
from taccel_lab.calibration.color.fit_options import ColorFitOptions
from taccel_lab.calibration.color.frames import ColorFrame
from taccel_lab.calibration.color.network_fit import fit_color_model
from taccel_lab.calibration.color.untouched_light import noise_floor_l1
from taccel_lab.calibration.normals.heldout import HeldoutReading, in_background_light
from taccel_lab.calibration.normals.network_fit import (
    InverseFit,
    InverseFitOptions,
    fit_normal_model,
    fold_of,
)
from taccel_lab.calibration.normals.options import NormalOptions, NormalTraining
from taccel_lab.calibration.normals.reading_error import (
    KnownPress,
    widened,
    with_reading_errors,
)
from taccel_lab.calibration.normals.remarks import remarks_of
from taccel_lab.calibration.normals.result import NormalCalibration
from taccel_lab.calibration.normals.samples import (
    EXACT,
    CaptureScene,
    CircleSigma,
    InverseFrame,
    circle_angle_rad,
    true_normals,
)
from taccel_lab.calibration.normals.score import (
    inside_of,
    reliability_of,
)
from taccel_lab.calibration.normals.synthetic_presses import ImageNoise, SyntheticPresses
from taccel_lab.calibration.result import in_figures
from taccel_lab.errors import InputError
from taccel_lab.profile import SensorProfile
from taccel_lab.profile.assumed import scale_sigma, thickness_interval_mm
from taccel_lab.progress import Progress, counted, silent
from taccel_lab.signals.color_model import ColorModel
from taccel_lab.signals.normal_model import NormalModel
from taccel_lab.signals.rest_surface import RestSurface, flat_rest, rest_surface

CHECKED = 16
"""Synthetic presses that the networks never see and heights are judged by."""
READING = "reading synthetic presses"
READING_BALLS = "reading the training presses"


def calibrate_normals(
    folder: CaptureFolder,
    base: SensorProfile,
    options: NormalOptions = NormalOptions(),
    progress: Progress = silent,
) -> NormalCalibration:
    """Fit the model from colour to surface normal to the ball presses of ``folder``.

    Args:
        folder: Its background and presses are used.
        base: Profile that the result extends; its face at rest is what normals lean against.
        options: Which presses are fitted, and how.
        progress: Told what is done.

    Raises:
        InputError: Captures that no model can be fitted to, with what their check found.
    """
    settings = InverseFitOptions(
        **{field.name: getattr(options, field.name) for field in fields(NormalTraining)}
    )
    presses = ball_presses(folder, base, "normals", options, progress)
    training, circles = presses.training, presses.circles
    profile = presses.profile
    pad, rest = layer_of(profile), rest_surface(profile.mesh, training.grid)
    typical_mm = float(np.median([circle.radius_px for circle in circles]))
    typical_mm *= training.grid.mm_per_px_x
    by_gel = sunk_share(
        thickness_interval_mm(profile.gel), typical_mm, training.ball_radius_mm, pad
    )
    found = fit_normals(
        training,
        circles,
        presses.surfaces,
        presses.heldout,
        split=presses.split,
        rest=rest,
        options=settings,
        circle_source=options.circles,
        circle_sigmas_px=presses.circle_sigmas_px,
        labels=presses.labels,
        background=profile.background_rgb,
        pad=pad,
        colors=None if _knows(profile, presses.heldout) else ColorModel.from_profile(profile),
        scale_share=scale_sigma(profile.camera),
        thickness_share=by_gel,
        progress=progress,
    )
    remarks = joined(presses.findings, (*presses.remarks, *found.remarks))
    return replace(
        found, gel=presses.gel, untouched=presses.untouched, remarks=(*presses.lost, *remarks)
    )


def _knows(profile: SensorProfile, heldout: CaptureSet | None) -> bool:
    """Whether the colours of a profile were fitted to held-out presses: synthetic presses in them
    would pass on what they know."""
    if profile.color is None or heldout is None:
        return False
    seen = set(profile.color.provenance.inputs.values())
    return any(press.sha256 in seen for press in heldout.presses)


def fit_normals(
    captures: CaptureSet,
    circles: Sequence[ContactCircle],
    surfaces: Sequence[BallSurface] | None = None,
    heldout: CaptureSet | None = None,
    *,
    split: PressSplit | None = None,
    rest: RestSurface | None = None,
    options: InverseFitOptions = InverseFitOptions(),
    circle_source: str = "given",
    circle_sigmas_px: Sequence[CircleSigma] | None = None,
    labels: LabelPlacement | None = None,
    background: np.ndarray | None = None,
    pad: BondedLayer | None = None,
    colors: ColorModel | None = None,
    scale_share: float = 0.0,
    thickness_share: float = 0.0,
    progress: Progress = silent,
) -> NormalCalibration:
    """Fit the inverse model to ``captures`` and score it on ``heldout``.

    Args:
        captures: The training presses alone.
        circles: Contact circle of each press, in order.
        surfaces: Gel surface of each press, for the sink-in around the contact; None leaves it out.
        heldout: Presses that are read when the model is frozen; None leaves figures out.
        split: How these were chosen, for the record.
        rest: The undeformed face; flat if None.
        options: Settings of the networks and their fit.
        circle_source: How the circles were chosen, for the record.
        circle_sigmas_px: What each circle may be off by; nothing when None.
        labels: Where labels put held-out presses; by ``circles`` when None.
        background: What images will be compared with, RGB levels; that of the captures when None.
        pad: The gel, for synthetic presses; without it there are none.
        colors: Colours of the sensor, for the same; fitted to ``captures`` when None.
        scale_share: Standard deviation of the scale of the pixel grid, as a share of it.
        thickness_share: That of depths by the thickness of ``pad``, as a share of them.
        progress: Told of the fit's steps.
    """
    if len(circles) != len(captures.presses) or (
        surfaces is not None and len(surfaces) != len(circles)
    ):
        raise InputError(
            f"{len(captures.presses)} presses need as many circles and surfaces, got "
            f"{len(circles)} and {0 if surfaces is None else len(surfaces)}"
        )
    mask = None if captures.mask.all() else captures.mask
    scene = CaptureScene(
        (captures.background if background is None else background).astype(np.float32),
        captures.grid,
        captures.ball_radius_mm,
        mask,
        None if rest is None or rest.is_flat else rest.normals,
    )
    sigmas = circle_sigmas_px or [EXACT] * len(circles)
    training = _frames(captures, circles, sigmas, surfaces, scene)
    synthetic_presses = None
    if pad is not None and options.synthetic_presses and surfaces is not None:
        synthetic_presses = _synthetic_presses(training, scene, pad, colors, options.seed, progress)
    fit, going = fit_normal_model(
        training,
        scene,
        options,
        synthetic_presses=()
        if synthetic_presses is None
        else synthetic_presses.presses(options.synthetic_presses, progress),
        progress=progress,
    )
    config = replace(
        fit.model.config,
        cone_deg=_steepest_deg(training, scene),
        presses_px=_presses_px(training),
    )
    fit = replace(fit, model=NormalModel(config, fit.model.weights))
    unseen = () if synthetic_presses is None else synthetic_presses.presses(CHECKED)
    checked = counted(map(KnownPress.of_synthetic, unseen), progress, READING, CHECKED)
    balls = left_out_balls(fit.model, training, scene)
    balls = counted(balls, progress, READING_BALLS, len(training))
    known = [(f.surface, f.circle) for f in training if f.surface is not None]
    # What all circles are off by alike is in what each of them is said to be.
    radius_px = min(radius for _, radius in sigmas)
    share = depth_share(
        known, radius_px, captures.ball_radius_mm, captures.grid, scale_share, thickness_share
    )
    model, synthetic = with_reading_errors(fit.model, checked, balls, scene, share)
    fit = replace(fit, model=model)
    frozen = fit.model.config
    held, final, every = None, None, training
    failures = {} if split is None else dict.fromkeys(split.gone, "it was left out of the captures")
    if heldout is not None:
        held = HeldoutReading(
            fit.model,
            heldout,
            labels or LabelPlacement.of(captures.presses, circles),
            scene,
            rest or flat_rest(captures.grid),
            pad,
            _typical(sigmas),
        )
        held.run(captures, progress)
        failures |= held.failures
        fit = replace(fit, model=widened(fit.model, held.errors))
        joining = held.joining()
        every = [*training, *joining]
        if joining:
            final = _in_bands_of(fit, going.go_on(joining, progress), every, scene)
    items = [] if held is None else held.items
    result = NormalCalibration(
        fit=fit,
        final=final,
        scene=replace(scene, background=captures.background, mask=captures.mask),
        heldout=tuple(items),
        failures=failures,
        rejected=frozenset() if heldout is None else heldout.rejected,
        split=split,
        reliability=reliability_of(items, scene) if in_figures(items) else None,
        synthetic=synthetic,
        gel=None,
        frozen_radius95_sigmas=frozen.radius95_sigmas,
        frozen_along_factor=frozen.along_factor,
        flat_noise_levels=_flat_noise_levels(training, scene),
        background_sha256=captures.background_sha256,
        source=source_of(captures.provenance, captures.source),
        provenance=captures.provenance,
        circles=circle_source,
        surfaces="left out" if surfaces is None else surfaces[0].provider,
        valid_region=_valid_region(every, scene),
    )
    return replace(result, remarks=remarks_of(result, training, scene))


def _frames(
    captures: CaptureSet,
    circles: Sequence[ContactCircle],
    sigmas: Sequence[CircleSigma],
    surfaces: Sequence[BallSurface] | None,
    scene: CaptureScene,
) -> list[InverseFrame]:
    """Frames in the light of the background."""
    return [
        InverseFrame(
            press.name,
            in_background_light(press.image(), scene),
            circle,
            press.sha256,
            surfaces[i] if surfaces else None,
            sigma,
        )
        for i, (press, circle, sigma) in enumerate(
            zip(captures.presses, circles, sigmas, strict=True)
        )
    ]


def _flat_noise_levels(frames: Sequence[InverseFrame], scene: CaptureScene) -> float:
    """Mean difference from the background beside the contacts, median over the frames [levels]."""
    floors = [
        noise_floor_l1(frame.image, scene.background, frame.circle, scene.grid, scene.mask)
        for frame in frames
    ]
    return float(np.nanmedian(floors)) if np.isfinite(floors).any() else float("nan")


def _synthetic_presses(
    training: Sequence[InverseFrame],
    scene: CaptureScene,
    pad: BondedLayer,
    colors: ColorModel | None,
    seed: int,
    progress: Progress,
) -> SyntheticPresses:
    """Presses of other tools in the sensor's pad and colours."""
    if colors is None:
        frames = [
            ColorFrame(frame.name, frame.image, frame.circle, frame.surface, frame.sha256)
            for frame in training
            if frame.surface is not None
        ]
        settings = ColorFitOptions(seed=seed)
        colors = fit_color_model(
            frames, scene.background, scene.grid, settings, mask=scene.mask, progress=progress
        ).model
    noise = ImageNoise.of(training, scene, colors)
    deepest_mm = max(frame.surface.depth_mm for frame in training if frame.surface is not None)
    return SyntheticPresses(scene, pad, colors, noise, deepest_mm, np.random.default_rng(seed))


def left_out_balls(
    model: NormalModel, training: Sequence[InverseFrame], scene: CaptureScene
) -> Iterator[KnownPress]:
    """Training presses, each with the network that did not see it."""
    for i, frame in enumerate(training):
        member = fold_of(i, model.config.members, len(training))
        if member is None:
            continue
        rise = None if frame.surface is None else 1e-3 * frame.surface.displacement_mm()
        normals = true_normals(frame, scene)
        yield KnownPress(
            image=frame.image,
            normals=normals,
            rise_m=rise,
            compared=inside_of(frame.circle, scene),
            left_out=member,
            normals_sigma_deg=np.degrees(circle_angle_rad(frame, scene, normals)),
        )


def _typical(sigmas: Sequence[CircleSigma]) -> CircleSigma:
    center, radius = np.sqrt(np.mean(np.square(sigmas), axis=0))
    return float(center), float(radius)


def _presses_px(frames: Sequence[InverseFrame]) -> tuple[float, ...]:
    circles = [frame.circle for frame in frames]
    return tuple(float(x) for c in circles for x in (c.u_px, c.v_px, c.radius_px))


def _in_bands_of(
    scored: InverseFit, last: InverseFit, frames: Sequence[InverseFrame], scene: CaptureScene
) -> InverseFit:
    """The last fit with what is known of the scored one's errors: held-out presses tell no more of
    a fit that has seen them. Networks that err more on what they left out expect more, too."""
    known = scored.model.config
    factor = max(known.error_factor, last.model.config.error_factor)
    config = replace(
        known,
        error_factor=factor,
        cone_deg=_steepest_deg(frames, scene),
        presses_px=_presses_px(frames),
    )
    return replace(last, model=NormalModel(config, last.model.weights))


def _steepest_deg(frames: Sequence[InverseFrame], scene: CaptureScene) -> float:
    rim_mm = max(frame.circle.radius_px for frame in frames) * scene.grid.mm_per_px_x
    return float(np.degrees(np.arcsin(min(1.0, rim_mm / scene.ball_radius_mm))))


def _valid_region(
    frames: Sequence[InverseFrame], scene: CaptureScene
) -> dict[str, tuple[float, float]]:
    """Where the training presses lie, and how steep they are."""
    u = [frame.circle.u_px for frame in frames]
    v = [frame.circle.v_px for frame in frames]
    return {
        "contact_u_px": (min(u), max(u)),
        "contact_v_px": (min(v), max(v)),
        "surface_tilt_deg": (0.0, _steepest_deg(frames, scene)),
    }
