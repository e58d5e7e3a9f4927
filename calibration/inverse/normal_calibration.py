# SPDX-License-Identifier: Apache-2.0
"""Captures of ball presses to the profile block ``normals``: colour and pixel to surface normal.

Presses are split into those that are fitted and those that are held out; all figures are those of
held-out presses, in the circles given with them and in those that were used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np

from calibration.background import fit_robust_drift
from calibration.capture.captures import CaptureSet, ContactCircle
from calibration.inverse.fit import InverseFit, InverseFitOptions, Progress, fit_normal_model
from calibration.inverse.remarks import remarks_of
from calibration.inverse.samples import FLAT_RADII, InverseFrame, Scene, usable_pixels
from calibration.inverse.score import (
    HeldoutNormals,
    Reliability,
    mean_of,
    reliability_of,
    score_heldout,
)
from calibration.result import Remark, judge
from calibration.surfaces.types import PressSurface
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

    def figures(self) -> dict[str, Any]:
        """Means over the held-out presses and the table of presses, worst first."""
        rows = [
            {"name": item.name, "given": asdict(item.given), "used": asdict(item.used)}
            for item in sorted(self.heldout, key=lambda item: -item.used.mean_deg)
        ]
        held: dict[str, Any] | None = None
        if self.heldout:
            held = {
                "in_given_circles": mean_of([item.given for item in self.heldout]),
                "in_used_circles": mean_of([item.used for item in self.heldout]),
            }
        return {
            "verdict": judge(self.remarks),
            "remarks": [str(remark) for remark in self.remarks],
            "heldout": held,
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
            for key, value in mean_of([item.used for item in self.heldout]).items():
                residuals[f"heldout_{key}"] = value
            given = [item.given.mean_deg for item in self.heldout]
            residuals["heldout_in_given_circles_deg"] = float(np.mean(given))
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
    *,
    rest_normals: np.ndarray | None = None,
    holdout_every: int = 4,
    options: InverseFitOptions | None = None,
    drift: DriftMode = "auto",
    baseline: bool = True,
    circle_source: str = "given",
    progress: Progress | None = None,
) -> NormalCalibration:
    """Fit the inverse model to the captures' training presses and score it on the others.

    Args:
        circles: Contact circle of each press, in order.
        surfaces: Gel surface of each press, for the skirt around the contact; None leaves it out.
        rest_normals: Normals of the undeformed face, shape [height_px, width_px, 3]; flat if None.
        holdout_every: Every how-manieth press is held out.
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
    train, held = captures.split(holdout_every)
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
    training = [frames[i] for i in train]
    fit = fit_normal_model(training, scene, options, progress=progress)
    items = tuple(
        score_heldout(fit.model, frames[i], captures.presses[i].circle, scene) for i in held
    )
    baseline_deg = None
    if baseline and items:
        plain = fit_normal_model(training, scene, replace(PIXEL_BASELINE, seed=options.seed))
        scores = [score_heldout(plain.model, item.frame, None, scene) for item in items]
        baseline_deg = float(np.mean([item.used.mean_deg for item in scores]))
    result = NormalCalibration(
        fit=fit,
        background=captures.background,
        heldout=items,
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
    still = []
    for image in raw:
        found = fit_robust_drift(image, captures.background, scene.mask, gradient=False)
        still.append(found.remove(image).astype(np.float32))
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
