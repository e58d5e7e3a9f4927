# SPDX-License-Identifier: Apache-2.0
"""Captures of ball presses to the profile block ``normals``: colour and pixel to surface normal.

All figures are those of held-out presses, chosen before any image was read and read when the model
is frozen: in the circles given with them, and in those as the training presses say that labels lie.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np

from taccel_lab.calibration.capture.captures import CaptureSet, ContactCircle
from taccel_lab.calibration.capture.split import PressSplit
from taccel_lab.calibration.contacts.fit import place_heldout
from taccel_lab.calibration.contacts.labels import LabelPlacement
from taccel_lab.calibration.light.fit import fit_light
from taccel_lab.calibration.normals.network_fit import (
    InverseFit,
    InverseFitOptions,
    Progress,
    fit_normal_model,
)
from taccel_lab.calibration.normals.remarks import remarks_of
from taccel_lab.calibration.normals.samples import FLAT_RADII, InverseFrame, Scene, usable_pixels
from taccel_lab.calibration.normals.score import (
    HeldoutNormals,
    Reliability,
    flat_guess,
    mean_of,
    reliability_of,
    score_heldout,
)
from taccel_lab.calibration.result import Remark, judge
from taccel_lab.calibration.surfaces.press_surface import PressSurface
from taccel_lab.errors import InputError
from taccel_lab.profile import BackgroundBlock, NormalsBlock, Provenance, SensorProfile

DriftMode = Literal["auto", "on", "off"]
DRIFT_GAIN = 0.75
"""``auto`` takes the light's drift off when that leaves less than this part of the difference to
the background where the gel is at rest."""
PIXEL_BASELINE = InverseFitOptions(scales_px=(0.0,), slopes=False, members=1, steps=600)
"""The colour change and position of a pixel alone, as in gs_sdk with its background subtracted."""


@dataclass(frozen=True)
class NormalCalibration:
    """Result of ``calibrate_normals``."""

    fit: InverseFit
    background: np.ndarray
    """RGB levels, uint8, shape [height_px, width_px, 3]."""
    heldout: tuple[HeldoutNormals, ...]
    failures: dict[str, str]
    """Held-out presses that could not be read, and why: they count as a flat guess."""
    split: PressSplit | None
    """How the held-out presses were chosen; None where there are none."""
    baseline_deg: float | None
    """Mean held-out error of the single-pixel baseline in the circles as used [degrees]."""
    reliability: Reliability | None
    flat_noise_levels: tuple[float, float]
    """Mean difference of frames to the background where the gel is at rest, as captured and with
    the light's drift taken off [levels]."""
    train_names: tuple[str, ...]
    inputs: dict[str, str]
    source: str
    circles: str
    """How the circles were chosen."""
    surfaces: str
    """What gave the normals of the skirt."""
    valid_region: dict[str, tuple[float, float]]
    remarks: tuple[Remark, ...] = ()

    def heldout_means(self, circles: Literal["given", "used"]) -> dict[str, float]:
        """Mean figures of the held-out presses, failures as flat guesses."""
        scores = [getattr(item, circles) for item in self.heldout]
        return mean_of(scores + [flat_guess(scores)] * len(self.failures))

    def figures(self) -> dict[str, Any]:
        """Means over the held-out presses and the table of presses, worst first."""
        rows = [
            {"name": item.name, "given": asdict(item.given), "used": asdict(item.used)}
            for item in sorted(self.heldout, key=lambda item: -item.used.mean_deg)
        ]
        held: dict[str, Any] | None = None
        if self.heldout:
            held = {
                "in_given_circles": self.heldout_means("given"),
                "in_used_circles": self.heldout_means("used"),
            }
        return {
            "verdict": judge(self.remarks),
            "remarks": [str(remark) for remark in self.remarks],
            "heldout": held,
            "split": None if self.split is None else self.split.figures(),
            "failures": self.failures,
            "pixel_baseline_deg": self.baseline_deg,
            "reliability": None if self.reliability is None else asdict(self.reliability),
            "presses": rows,
            "left_out_deg": self.fit.left_out_deg,
            "label_shift_px": {k: v.length_px for k, v in self.fit.label_shifts.items()},
            "flat_noise_levels": self.flat_noise_levels,
            "light_drift": self.fit.model.config.light_drift,
            "circles": self.circles,
            "surfaces": self.surfaces,
            "curve": self.fit.curve,
            "stopped_at": self.fit.stopped_at,
            "fit_seconds": self.fit.seconds,
        }

    def apply_to(self, profile: SensorProfile) -> SensorProfile:
        """``profile`` with the block normals, and a background where it has none."""
        if profile.background is None:
            profile = profile.with_block(
                BackgroundBlock(
                    provenance=Provenance(
                        kind="measured",
                        method="captured background",
                        source=self.source,
                        inputs={"background": self.inputs["background"]},
                    )
                ),
                self.background,
            )
        return profile.with_block(
            NormalsBlock(
                architecture=self.fit.model.config.to_dict(), provenance=self._provenance()
            ),
            self.fit.model.weights,
        )

    def _provenance(self) -> Provenance:
        left_out = list(self.fit.left_out_deg.values())
        residuals, spread = {}, {}
        if left_out:
            residuals["left_out_angle_deg"] = float(np.mean(left_out))
            spread["left_out_angle_deg"] = float(np.std(left_out))
        if self.heldout:
            for key, value in self.heldout_means("used").items():
                residuals[f"heldout_{key}"] = value
            residuals["heldout_in_given_circles_deg"] = self.heldout_means("given")["mean_deg"]
            residuals["heldout_failures"] = float(len(self.failures))
            spread["heldout_angle_deg"] = float(np.std([i.used.mean_deg for i in self.heldout]))
        if not residuals:
            residuals["train_angle_deg"] = self.fit.curve[-1][1]
        if self.reliability is not None:
            residuals["observed_over_expected"] = self.reliability.ratio()
        config, options = self.fit.model.config, self.fit.options
        return Provenance(
            kind="calibrated",
            method=(
                f"{config.members} networks {list(config.hidden)} on colour change over windows "
                f"of {', '.join(f'{s:g}' for s in config.scales_px)} px and position"
                + f" in {config.position_bands} bands"
                * (config.position_bands > 0)
                + f"; {options.steps} Adam steps, stopped on left-out presses; circles: "
                f"{self.circles}; skirt: {self.surfaces}; light drift "
                + ("taken off" if config.light_drift else "left in")
            ),
            source=self.source,
            inputs=self.inputs,
            residuals=residuals,
            spread=spread,
            valid_region=self.valid_region,
            verdict=judge(self.remarks).value,
            remarks=tuple(str(remark) for remark in self.remarks),
        )


def calibrate_normals(
    captures: CaptureSet,
    circles: Sequence[ContactCircle],
    surfaces: Sequence[PressSurface] | None = None,
    heldout: CaptureSet | None = None,
    *,
    split: PressSplit | None = None,
    rest_normals: np.ndarray | None = None,
    options: InverseFitOptions | None = None,
    drift: DriftMode = "auto",
    baseline: bool = True,
    circle_source: str = "given",
    progress: Progress | None = None,
) -> NormalCalibration:
    """Fit the inverse model to ``captures`` and score it on ``heldout``.

    Args:
        captures: The training presses alone.
        circles: Contact circle of each press, in order.
        surfaces: Gel surface of each press, for the skirt around the contact; None leaves it out.
        heldout: Presses that are read when the model is frozen; None leaves figures out.
        split: How these were chosen, for the record.
        rest_normals: Normals of the undeformed face, shape [height_px, width_px, 3]; flat if None.
        drift: Whether each frame is brought to the background's light; ``auto`` looks at the noise.
        baseline: Also fit the single-pixel baseline for comparison.
        circle_source: How the circles were chosen, for the record.
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
    frames, noise, with_drift = _frames(captures, circles, surfaces, scene, drift)
    options = replace(options or InverseFitOptions(), light_drift=with_drift)
    training = frames
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
        if with_drift:
            image = _without_drift(image, scene)
        frame = InverseFrame(press.name, image, circle, press.sha256, None)
        items.append(score_heldout(fit.model, frame, press.circle, scene))
    baseline_deg = None
    if baseline and items:
        plain = fit_normal_model(training, scene, replace(PIXEL_BASELINE, seed=options.seed))
        scores = [score_heldout(plain.model, item.frame, None, scene) for item in items]
        baseline_deg = float(np.mean([item.used.mean_deg for item in scores]))
    result = NormalCalibration(
        fit=fit,
        background=captures.background,
        heldout=tuple(items),
        failures=failures,
        split=split,
        baseline_deg=baseline_deg,
        reliability=reliability_of(items) if items else None,
        flat_noise_levels=noise,
        train_names=tuple(frame.name for frame in training),
        inputs={"background": captures.background_sha256} | {f.name: f.sha256 for f in training},
        source=captures.provenance.get("source", captures.source),
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
) -> tuple[list[InverseFrame], tuple[float, float], bool]:
    """Frames, the noise where the gel is at rest before and after, and whether drift came off."""
    raw = [press.image().astype(np.float32) for press in captures.presses]
    still = [_without_drift(image, scene) for image in raw]
    before, after = (
        float(np.median([_flat_noise(im, c, scene) for im, c in zip(images, circles, strict=True)]))
        for images in (raw, still)
    )
    with_drift = mode == "on" or (mode == "auto" and after < DRIFT_GAIN * before)
    chosen = still if with_drift else raw
    frames = [
        InverseFrame(press.name, image, circle, press.sha256, surfaces[i] if surfaces else None)
        for i, (press, image, circle) in enumerate(
            zip(captures.presses, chosen, circles, strict=True)
        )
    ]
    return frames, (before, after), with_drift


def _without_drift(image: np.ndarray, scene: Scene) -> np.ndarray:
    """The frame in the light of the background, as the model will see new ones."""
    found = fit_light(image, scene.background, scene.mask, gradient=False)
    return found.remove(image).astype(np.float32)


def _flat_noise(image: np.ndarray, circle: ContactCircle, scene: Scene) -> float:
    flat = circle.distance_px(scene.grid) > FLAT_RADII * circle.radius_px
    flat &= usable_pixels(scene)
    if not flat.any():
        return 0.0
    return float(np.abs(image[flat] - scene.background[flat]).mean())


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
