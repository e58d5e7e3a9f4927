# SPDX-License-Identifier: Apache-2.0
"""Captures and simulated surfaces to the profile blocks ``background`` and ``color``.

Presses are split into those that are fitted and those that are held out; figures are those of the
held-out presses, with the bare background beside them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.capture.captures import CaptureSet, ContactCircle
from calibration.estimators.background import fit_drift
from calibration.estimators.color import (
    ColorFit,
    ColorFitOptions,
    ColorFrame,
    Progress,
    cross_validate,
    fit_color_model,
)
from calibration.evaluate import ImageScore, mean_score, noise_floor_l1, score_image
from calibration.surfaces.types import PressSurface
from taccel_lab.errors import InputError
from taccel_lab.profile import BackgroundBlock, ColorBlock, Provenance, SensorProfile


@dataclass(frozen=True)
class HeldoutRender:
    """A press the fit never saw: capture, render and figures."""

    name: str
    captured: np.ndarray
    """RGB uint8, shape [height_px, width_px, 3]."""
    rendered: np.ndarray
    """RGB levels, float32, same shape."""
    circle: ContactCircle
    """Circle in which the figures are taken."""
    score: ImageScore
    score_drift_corrected: ImageScore
    """With an affine drift of the light, fitted beyond 3 contact radii of the capture, applied."""
    background_only: ImageScore
    """The captured background alone against the capture."""


@dataclass(frozen=True)
class ColorCalibration:
    """Result of ``calibrate_color``."""

    fit: ColorFit
    heldout: list[HeldoutRender]
    train_names: list[str]
    noise_floor_l1: float
    """Mean difference of captures to the background beyond 3 contact radii [levels]."""
    cross_validated_l1: dict[str, float]
    """L1 in the disc of each training press by a fit without it [levels]; empty if not asked."""
    source: str
    provenance: dict[str, str]
    background_sha256: str
    surface_provider: str
    """What made the surfaces."""
    valid_region: dict[str, tuple[float, float]]
    """Range of contact positions, tilts and displacements in the training presses."""

    def figures(self) -> dict[str, object]:
        """Means over the held-out presses and the table of presses, worst crop PSNR first."""
        if not self.heldout:
            return {"heldout": None, "background_only": None, "presses": []}
        worst_first = sorted(self.heldout, key=lambda item: item.score.crop_psnr_db)
        return {
            "heldout": mean_score([item.score for item in self.heldout]),
            "heldout_drift_corrected": mean_score(
                [item.score_drift_corrected for item in self.heldout]
            ),
            "background_only": mean_score([item.background_only for item in self.heldout]),
            "noise_floor_l1": self.noise_floor_l1,
            "presses": [{"name": item.name, **vars(item.score)} for item in worst_first],
            "train_disc_l1": self.fit.disc_l1_train,
            "cross_validated_disc_l1": self.cross_validated_l1,
            "loss_curve": self.fit.loss_curve,
            "fit_seconds": self.fit.seconds,
        }

    def apply_to(self, profile: SensorProfile) -> SensorProfile:
        """``profile`` with the blocks background and color of this calibration."""
        # An old background or model may be of another image size; both are replaced.
        profile = profile.without("background", "color")
        return profile.with_block(
            BackgroundBlock(provenance=self._background_provenance()), self.fit.background
        ).with_block(
            ColorBlock(
                architecture=self.fit.model.config.to_dict(), provenance=self._color_provenance()
            ),
            self.fit.model.weights,
        )

    def _inputs(self) -> dict[str, str]:
        return {"background": self.background_sha256} | self.fit.inputs

    def _source(self) -> str:
        return self.provenance.get("source", self.source)

    def _background_provenance(self) -> Provenance:
        averaged = "; averaged with the untouched parts of the training presses"
        return Provenance(
            kind="calibrated",
            method="captured background" + averaged * self.fit.options.average_background,
            source=self._source(),
            inputs=self._inputs(),
            residuals={"far_field_l1_levels": self.noise_floor_l1},
            valid_region={"level": (0.0, 255.0)},
        )

    def _color_provenance(self) -> Provenance:
        train = list(self.fit.disc_l1_train.values())
        residuals = {"train_disc_l1_levels": float(np.mean(train))}
        spread = {"train_disc_l1_levels": float(np.std(train))}
        if self.heldout:
            for key, value in mean_score([item.score for item in self.heldout]).items():
                residuals[f"heldout_{key}"] = value
            disc = [item.score.disc_l1 for item in self.heldout]
            spread["heldout_disc_l1_levels"] = float(np.std(disc))
        if self.cross_validated_l1:
            values = list(self.cross_validated_l1.values())
            residuals["cross_validated_disc_l1_levels"] = float(np.mean(values))
            spread["cross_validated_disc_l1_levels"] = float(np.std(values))
        options = self.fit.options
        return Provenance(
            kind="calibrated",
            method=(
                f"MLP {list(options.hidden)} on {', '.join(options.inputs)}; {options.steps} Adam "
                f"steps of {options.batch_pixels} pixels, Huber loss, seed {options.seed}; "
                f"surfaces: {self.surface_provider}"
            ),
            source=self._source(),
            inputs=self._inputs(),
            residuals=residuals,
            spread=spread,
            valid_region=self.valid_region,
        )


def calibrate_color(
    captures: CaptureSet,
    circles: Sequence[ContactCircle],
    surfaces: Sequence[PressSurface],
    *,
    holdout_every: int = 4,
    options: ColorFitOptions | None = None,
    folds: int = 0,
    progress: Progress | None = None,
) -> ColorCalibration:
    """Fit the colour model to the captures' training presses and score it on the others.

    ``circles`` and ``surfaces`` belong to the presses of ``captures``, in order. Figures are taken
    in the circle given with a press where there is one, so that they do not depend on how the
    circles for the simulation were chosen. ``folds`` > 1 also cross-validates over the training
    presses.
    """
    if not len(circles) == len(surfaces) == len(captures.presses):
        raise InputError(
            f"{len(captures.presses)} presses need as many circles and surfaces, got "
            f"{len(circles)} and {len(surfaces)}"
        )
    train, held = captures.split(holdout_every)
    frames = [
        ColorFrame(press.name, press.image(), circle, surface, press.sha256)
        for press, circle, surface in zip(captures.presses, circles, surfaces, strict=True)
    ]
    training = [frames[i] for i in train]
    grid, mask = captures.grid, captures.mask
    fit = fit_color_model(
        training, captures.background, grid, options, mask=mask, progress=progress
    )
    validated: dict[str, float] = {}
    if folds > 1:
        validated = cross_validate(
            training, captures.background, grid, options, folds=folds, mask=mask
        )
    return ColorCalibration(
        fit=fit,
        heldout=[
            _render_heldout(frames[i], captures.presses[i].circle, fit, captures) for i in held
        ],
        train_names=[frame.name for frame in training],
        noise_floor_l1=float(
            np.mean([noise_floor_l1(f.image, captures.background, f.circle, grid) for f in frames])
        ),
        cross_validated_l1=validated,
        source=captures.source,
        provenance=captures.provenance,
        background_sha256=captures.background_sha256,
        surface_provider=", ".join(sorted({surface.provider for surface in surfaces})),
        valid_region=_valid_region(training),
    )


def _render_heldout(
    frame: ColorFrame, given: ContactCircle | None, fit: ColorFit, captures: CaptureSet
) -> HeldoutRender:
    surface, grid = frame.surface, captures.grid
    circle = given if given is not None else frame.circle
    rendered = fit.model.render(
        surface.normals, surface.displacement_mm(), surface.rest_normals, fit.background
    )
    drift = fit_drift(frame.image, fit.background, frame.circle, grid, captures.mask)
    corrected = np.clip(drift.apply(rendered), 0.0, 255.0)
    return HeldoutRender(
        name=frame.name,
        captured=frame.image,
        rendered=rendered,
        circle=circle,
        score=score_image(rendered, frame.image, circle, grid),
        score_drift_corrected=score_image(corrected, frame.image, circle, grid),
        background_only=score_image(captures.background, frame.image, circle, grid),
    )


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
