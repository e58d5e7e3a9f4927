# SPDX-License-Identifier: Apache-2.0
"""Held-out presses, read by the frozen model and scored, and bands that hold these, too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from taccel_lab.calibration.capture.captures import CapturedPress, ContactCircle
from taccel_lab.calibration.circles.ball_surface import LARGEST_RADII, deeper_per_mm
from taccel_lab.calibration.circles.labels import LabelPlacement
from taccel_lab.calibration.normals.samples import (
    KnownPress,
    ReadingErrors,
    angle_between_deg,
    ball_normals,
    circle_angle_rad,
    errors_of,
    true_normals,
    widened,
)
from taccel_lab.calibration.response.frame import (
    CaptureScene,
    CircleSigma,
    HeldoutFailure,
    HeldoutSet,
    PressFrame,
    in_background_light,
)
from taccel_lab.calibration.result import in_figures
from taccel_lab.errors import InputError
from taccel_lab.networks.normal_settings import RAYLEIGH_95
from taccel_lab.processes.ahead import ahead
from taccel_lab.progress import Progress, counted, silent
from taccel_lab.reading.heights import BAND_SIGMAS, ReadHeights, read_heights, with_deviations
from taccel_lab.reading.slopes import RAYLEIGH_MEAN, NormalMap, NormalModel

READING = "reading the held-out presses"
RIM_BAND = 0.04
"""Depths are aligned on the circle: over the pixels within this share of the radius of it."""
WITHIN_68 = 1.5096
"""Length, in standard deviations of a component, that 68 % of two-component normal vectors stay
below: sqrt(-2 ln(1 - p))."""
BIN_COUNT = 8


@dataclass(frozen=True)
class AngleScore:
    """Errors of the normals inside one circle."""

    mean_deg: float
    median_deg: float
    p90_deg: float
    flat_deg: float
    """Mean error of guessing the resting surface everywhere."""
    depth_mae_mm: float
    """Mean absolute error of the integrated depth against the ball's, aligned on the circle."""
    depth_mm: float
    """Mean depth of the ball below the circle."""


@dataclass(frozen=True)
class AbsoluteDepth:
    """Depths inside the circle as they are read, aligned on nothing.

    What they should be is the ball's press in the sensor's pad until it touches in the circle: of
    the thickness that the profile states.
    """

    mae_mm: float
    """Mean absolute error."""
    deepest_mm: float
    """Deepest point, as read less as it should be."""
    wanted_mm: float
    """Deepest point as it should be."""
    within_68: float
    """Share of pixels within one standard deviation of what they should be; NaN where none is
    stated."""
    within_95: float
    """Share within two."""


@dataclass(frozen=True)
class HeldoutNormals:
    """A press that the fit never saw."""

    name: str
    frame: PressFrame
    predicted: NormalMap
    height_m: np.ndarray
    """Heights by integration, zero where the gel is at rest, shape [height_px, width_px]."""
    depth: AbsoluteDepth
    """Depth against the same press of the ball in the sensor's pad."""
    error_deg: np.ndarray
    """Angle to the ball's normal in the circle that was trained with, NaN outside, [h, w]."""
    given: AngleScore
    """Score in the circle given with the press, where there is one, else in that used."""
    used: AngleScore
    """Score in the circle that the label puts there as the training presses say
    (``LabelPlacement``); without a label, in the one found in the image."""
    rejected: bool = False
    """Whether the image rejects the label: it stands beside the mean figures."""


@dataclass(frozen=True)
class Reliability:
    """Expected against observed errors over pixels of held-out presses, in circles as trained."""

    expected_deg: tuple[float, ...]
    """Mean expected error in bins of equal size, rising; with what the circle may be off by, as in
    the shares below."""
    observed_deg: tuple[float, ...]
    """Mean observed error there."""
    within_68: float
    """Share of pixels within the radius that 68.0 % should lie in."""
    within_95: float
    """Share within that of 95.0 %."""

    def ratio(self) -> float:
        """Observed over expected mean error; 1 is right, above it the model is too sure."""
        return float(np.mean(self.observed_deg) / np.mean(self.expected_deg))


@dataclass(frozen=True)
class HeldoutReading:
    """Presses that nothing had seen, as the model reads them."""

    model: NormalModel
    """The frozen one, its bands widened to hold these presses: figures of bands are of it."""
    items: tuple[HeldoutNormals, ...]
    failures: dict[str, str]
    """Presses that could not be placed, and why."""

    def joining(self) -> list[PressFrame]:
        """The presses as the last fit takes them. One that is read no better than by a flat guess
        shows something else."""
        return [i.frame for i in self.items if i.used.mean_deg < i.used.flat_deg]


def read_heldout(
    model: NormalModel,
    heldout: HeldoutSet,
    labels: LabelPlacement,
    scene: CaptureScene,
    circle_sigma_px: CircleSigma,
    progress: Progress = silent,
) -> HeldoutReading:
    """Place each press by its label, read it, widen the bands, and score it.

    Args:
        model: The frozen one.
        heldout: The presses.
        labels: Where their labels put them.
        scene: What they share with the training presses.
        circle_sigma_px: Of the circles of training presses.
        progress: Told of each press.
    """

    def read_one(
        placed: tuple[CapturedPress, PressFrame] | HeldoutFailure,
    ) -> tuple[CapturedPress, PressFrame, ReadHeights, ReadingErrors | None] | HeldoutFailure:
        if isinstance(placed, HeldoutFailure):
            return placed
        press, captured = placed
        sigma_px = circle_sigma_px
        if press.circle is not None:
            sigma_px = labels.sigma_px(circle_sigma_px)
        try:
            image = in_background_light(captured.image.astype(np.float32), scene)
            frame = replace(captured, image=image, circle_sigma_px=sigma_px)
            read = read_heights(
                model, image, scene.background, scene.grid, mask=scene.mask,
                rest_normals=scene.rest_normals, uncertainty=False,
            )  # fmt: skip
        except InputError as error:
            return HeldoutFailure(press.name, str(error))
        if press.mislabelled:
            return press, frame, read, None
        known = KnownPress.of_ball(frame, scene, rise_sigma_m=_rise_sigma_m(frame, scene))
        return press, frame, read, errors_of(model, known, scene, read)

    failures, found = {}, []
    readings = ahead(read_one, heldout.placed(labels))
    for reading in counted(readings, progress, READING, heldout.count):
        if isinstance(reading, HeldoutFailure):
            failures[reading.name] = reading.reason
        else:
            found.append(reading)
    wide = widened(model, [error for *_, error in found if error is not None])
    items = ahead(
        lambda one: score_heldout(
            with_deviations(one[2], wide.config, scene.grid, scene.mask), one[1], one[0].circle,
            scene, rejected=one[0].mislabelled,
        ),
        found,
    )  # fmt: skip
    return HeldoutReading(wide, tuple(items), failures)


def _rise_sigma_m(frame: PressFrame, scene: CaptureScene) -> float:
    """Standard deviation of a press's depth [m] by the radius of its circle."""
    scale = scene.grid.mm_per_px_x
    rim_mm = min(frame.circle.radius_px * scale, LARGEST_RADII * scene.ball_radius_mm)
    per_mm = deeper_per_mm(rim_mm, scene.ball_radius_mm, frame.surface.depth_mm)
    return 1e-3 * per_mm * frame.circle_sigma_px[1] * scale


def score_heldout(
    found: ReadHeights,
    frame: PressFrame,
    given: ContactCircle | None,
    scene: CaptureScene,
    *,
    rejected: bool = False,
) -> HeldoutNormals:
    """Compare a press, read as ``depth`` does, with its ball, and absolute heights with the rise of
    the face under it."""
    predicted, height = found.normals, found.rise_m
    inside = scene.inside(frame.circle)
    truth = ball_normals(frame.circle, scene)
    error = np.where(inside, angle_between_deg(predicted.normals, truth), np.nan)
    wanted_mm = frame.surface.displacement_mm()
    off_mm = np.abs(1e3 * height - wanted_mm)[inside]
    deepest = float(wanted_mm[inside].min())
    within = [float("nan")] * 2
    if found.sigma_m is not None:
        sigma_mm = 1e3 * found.sigma_m[inside]
        within = [float((off_mm <= k * sigma_mm).mean()) for k in (1.0, BAND_SIGMAS)]
    return HeldoutNormals(
        name=frame.name,
        frame=frame,
        predicted=predicted,
        height_m=height,
        depth=AbsoluteDepth(
            mae_mm=float(off_mm.mean()),
            deepest_mm=deepest - float(1e3 * height[inside].min()),
            wanted_mm=-deepest,
            within_68=within[0],
            within_95=within[1],
        ),
        error_deg=error,
        given=score_circle(predicted, height, given or frame.circle, scene),
        used=score_circle(predicted, height, frame.circle, scene),
        rejected=rejected,
    )


def score_circle(
    predicted: NormalMap, height_m: np.ndarray, circle: ContactCircle, scene: CaptureScene
) -> AngleScore:
    """Errors inside ``circle``; ``height_m`` is the rise over rest."""
    inside = scene.inside(circle)
    truth = ball_normals(circle, scene)
    error = angle_between_deg(predicted.normals, truth)[inside]
    rest = np.array([0.0, 0.0, 1.0]) if scene.rest_normals is None else scene.rest_normals
    flat = angle_between_deg(np.broadcast_to(rest, truth.shape), truth)[inside]
    wanted_mm = ball_depth_mm(circle, scene)
    found_mm = -height_m * 1e3
    band = np.abs(circle.distance_px(scene.grid) / circle.radius_px - 1) <= RIM_BAND
    band &= scene.usable
    if band.any():
        found_mm = found_mm - found_mm[band].mean() + wanted_mm[band].mean()
    return AngleScore(
        mean_deg=float(error.mean()),
        median_deg=float(np.median(error)),
        p90_deg=float(np.percentile(error, 90)),
        flat_deg=float(flat.mean()),
        depth_mae_mm=float(np.abs(found_mm - wanted_mm)[inside].mean()),
        depth_mm=float(wanted_mm[inside].mean()),
    )


def ball_depth_mm(circle: ContactCircle, scene: CaptureScene) -> np.ndarray:
    """Depth of a flat gel in the ball's shape below the circle [mm]; beyond it, shallower, negative
    at most by what the ball rises up to its equator. Shape [height_px, width_px].

    On a curved gel the depth is that below the plane of the circle.
    """
    distance = circle.distance_px(scene.grid) * scene.grid.mm_per_px_x
    radius = scene.ball_radius_mm
    rim = min(circle.radius_px * scene.grid.mm_per_px_x, radius)
    cap = np.sqrt(np.maximum(radius**2 - np.minimum(distance, radius) ** 2, 0.0))
    return cap - np.sqrt(radius**2 - rim**2)


def reliability_of(items: Sequence[HeldoutNormals], scene: CaptureScene) -> Reliability:
    """Pool the pixels of the held-out presses that figures are over, at least one."""
    errors, sigmas, radii = [], [], []
    for item in in_figures(items):
        inside = np.isfinite(item.error_deg)
        normals = true_normals(item.frame, scene)[inside]
        circle_deg = np.degrees(circle_angle_rad(item.frame, scene, normals))
        errors.append(item.error_deg[inside])
        sigmas.append(np.hypot(item.predicted.sigma_deg[inside], circle_deg))
        radii.append(np.hypot(item.predicted.radius95_deg[inside], RAYLEIGH_95 * circle_deg))
    error, sigma, radius95 = (np.concatenate(x) for x in (errors, sigmas, radii))
    order = np.argsort(sigma, kind="stable")
    parts = np.array_split(order, BIN_COUNT)
    return Reliability(
        expected_deg=tuple(float(sigma[p].mean() * RAYLEIGH_MEAN) for p in parts if len(p)),
        observed_deg=tuple(float(error[p].mean()) for p in parts if len(p)),
        within_68=float((error <= WITHIN_68 * sigma).mean()),
        within_95=float((error <= radius95).mean()),
    )


def flat_guess(scores: Sequence[AngleScore]) -> AngleScore:
    """What a press counts as that cannot be read: a flat guess on the worst of the others."""
    flat = max(score.flat_deg for score in scores)
    depth = max(score.depth_mm for score in scores)
    return AngleScore(flat, flat, flat, flat, depth, depth)
