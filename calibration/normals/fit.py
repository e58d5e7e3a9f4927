# SPDX-License-Identifier: Apache-2.0
"""Captures of ball presses to the profile block ``normals``: colour and pixel to surface normal.

All figures are those of held-out presses, chosen before any image was read and read when the model
is frozen: in the circles given with them, and in those as the training presses say that labels lie.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np

from taccel_lab.calibration.ball_presses import ball_presses
from taccel_lab.calibration.capture.captures import CaptureSet, ContactCircle
from taccel_lab.calibration.capture.folder import CaptureFolder, source_of
from taccel_lab.calibration.capture.split import PressSplit
from taccel_lab.calibration.check.block_findings import joined
from taccel_lab.calibration.contacts.fit import place_heldout
from taccel_lab.calibration.contacts.labels import LabelPlacement
from taccel_lab.calibration.light.drift_choice import DriftChoice, DriftMode, choose_drift
from taccel_lab.calibration.light.fit import fit_light
from taccel_lab.calibration.light.light import Light
from taccel_lab.calibration.normals.network_fit import InverseFitOptions, fit_normal_model
from taccel_lab.calibration.normals.options import NormalOptions, NormalTraining
from taccel_lab.calibration.normals.remarks import remarks_of
from taccel_lab.calibration.normals.result import NormalCalibration
from taccel_lab.calibration.normals.samples import InverseFrame, Scene, usable_pixels
from taccel_lab.calibration.normals.score import HeldoutNormals, reliability_of, score_heldout
from taccel_lab.calibration.normals.skirt import hertz_skirts
from taccel_lab.calibration.simulate import PressSurfaces
from taccel_lab.calibration.surfaces.press_surface import PressSurface
from taccel_lab.errors import InputError
from taccel_lab.profile import SensorProfile
from taccel_lab.progress import Progress, silent
from taccel_lab.signals.rest_surface import rest_surface

PIXEL_BASELINE = InverseFitOptions(scales_px=(0.0,), slopes=False, members=1, steps=600)
"""The colour change and position of a pixel alone, as in gs_sdk with its background subtracted."""


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
        SimulationError: A simulated press that did not converge.
    """
    settings = InverseFitOptions(
        **{field.name: getattr(options, field.name) for field in fields(NormalTraining)}
    )
    presses = ball_presses(folder, base, "normals", options, progress)
    training, circles = presses.training, presses.circles
    surfaces = None
    if options.skirt == "simulated":
        surfaces = PressSurfaces("each", presses.profile, progress=progress)(training, circles)
    elif options.skirt == "hertz":
        surfaces = hertz_skirts(training, circles)
    rest = rest_surface(presses.profile.mesh, training.grid)
    found = fit_normals(
        training,
        circles,
        surfaces,
        presses.heldout,
        split=presses.split,
        rest_normals=None if rest.is_flat else rest.normals,
        options=settings,
        drift=options.drift,
        circle_source=options.circles,
        progress=progress,
    )
    remarks = joined(presses.findings, (*presses.remarks, *found.remarks))
    return replace(found, remarks=(*presses.lost, *remarks))


def fit_normals(
    captures: CaptureSet,
    circles: Sequence[ContactCircle],
    surfaces: Sequence[PressSurface] | None = None,
    heldout: CaptureSet | None = None,
    *,
    split: PressSplit | None = None,
    rest_normals: np.ndarray | None = None,
    options: InverseFitOptions = InverseFitOptions(),
    drift: DriftMode = "auto",
    baseline: bool = True,
    circle_source: str = "given",
    progress: Progress = silent,
) -> NormalCalibration:
    """Fit the inverse model to ``captures`` and score it on ``heldout``.

    Args:
        captures: The training presses alone.
        circles: Contact circle of each press, in order.
        surfaces: Gel surface of each press, for the skirt around the contact; None leaves it out.
        heldout: Presses that are read when the model is frozen; None leaves figures out.
        split: How these were chosen, for the record.
        rest_normals: Normals of the undeformed face, shape [height_px, width_px, 3]; flat if None.
        options: Settings of the networks and their fit.
        drift: Whether each frame is brought to the background's light; ``auto`` looks at the noise.
        baseline: Also fit the single-pixel baseline for comparison.
        circle_source: How the circles were chosen, for the record.
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
    scene = Scene(
        captures.background.astype(np.float32),
        captures.grid,
        captures.ball_radius_mm,
        mask,
        rest_normals,
    )
    training, choice = _frames(captures, circles, surfaces, scene, drift)
    options = replace(options, light_drift=choice.remove)
    fit = fit_normal_model(training, scene, options, progress=progress)
    failures = {} if split is None else dict.fromkeys(split.gone, "it was left out of the captures")
    items: list[HeldoutNormals] = []
    labels = LabelPlacement.of(captures.presses, circles)
    for press in () if heldout is None else heldout.presses:
        image = press.image().astype(np.float32)
        try:
            circle = place_heldout(press, image, captures, labels)
        except InputError as error:
            failures[press.name] = str(error)
            continue
        if choice.remove:
            image = _light(image, scene).remove(image).astype(np.float32)
        frame = InverseFrame(press.name, image, circle, press.sha256, None)
        items.append(score_heldout(fit.model, frame, press.circle, scene))
    baseline_deg = None
    if baseline and items:
        plain = fit_normal_model(training, scene, replace(PIXEL_BASELINE, seed=options.seed))
        scores = [score_heldout(plain.model, item.frame, None, scene) for item in items]
        baseline_deg = float(np.mean([item.used.mean_deg for item in scores]))
    result = NormalCalibration(
        fit=fit,
        scene=replace(scene, background=captures.background, mask=captures.mask),
        heldout=tuple(items),
        failures=failures,
        split=split,
        baseline_deg=baseline_deg,
        reliability=reliability_of(items) if items else None,
        flat_noise_levels=(choice.captured_levels, choice.corrected_levels),
        train_names=tuple(frame.name for frame in training),
        inputs={"background": captures.background_sha256} | {f.name: f.sha256 for f in training},
        source=source_of(captures.provenance, captures.source),
        provenance=captures.provenance,
        circles=circle_source,
        surfaces="left out" if surfaces is None else surfaces[0].provider,
        valid_region=_valid_region(training, scene),
    )
    return replace(result, remarks=remarks_of(result, training, scene))


def _frames(
    captures: CaptureSet,
    circles: Sequence[ContactCircle],
    surfaces: Sequence[PressSurface] | None,
    scene: Scene,
    mode: DriftMode,
) -> tuple[list[InverseFrame], DriftChoice]:
    """Frames, and whether drift came off them."""
    images = [press.image().astype(np.float32) for press in captures.presses]
    lights = [_light(image, scene) for image in images]
    usable = usable_pixels(scene)
    untouched = [usable & circle.untouched(scene.grid) for circle in circles]
    choice = choose_drift(images, lights, untouched, scene.background, mode)
    if choice.remove:
        images = [
            light.remove(image).astype(np.float32)
            for image, light in zip(images, lights, strict=True)
        ]
    frames = [
        InverseFrame(press.name, image, circle, press.sha256, surfaces[i] if surfaces else None)
        for i, (press, image, circle) in enumerate(
            zip(captures.presses, images, circles, strict=True)
        )
    ]
    return frames, choice


def _light(image: np.ndarray, scene: Scene) -> Light:
    """Light of a frame against the background, as the model will bring new ones to it."""
    return fit_light(image, scene.background, scene.mask, gradient=False)


def _valid_region(frames: Sequence[InverseFrame], scene: Scene) -> dict[str, tuple[float, float]]:
    """Where the training presses lie, and how steep they are."""
    u = [frame.circle.u_px for frame in frames]
    v = [frame.circle.v_px for frame in frames]
    rim_mm = max(frame.circle.radius_px for frame in frames) * scene.grid.mm_per_px_x
    steepest = np.degrees(np.arcsin(min(1.0, rim_mm / scene.ball_radius_mm)))
    return {
        "contact_u_px": (min(u), max(u)),
        "contact_v_px": (min(v), max(v)),
        "surface_tilt_deg": (0.0, float(steepest)),
    }
