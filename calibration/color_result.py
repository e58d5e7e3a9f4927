# SPDX-License-Identifier: Apache-2.0
"""What a colour calibration found: the fit, its figures, and the blocks that it becomes."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from calibration.capture.captures import ContactCircle
from calibration.color_remarks import color_remarks
from calibration.estimators.color import ColorFit, DriftChoice, Registration
from calibration.evaluate import ImageScore, mean_score
from calibration.result import Remark, judge
from taccel_lab.geometry import PixelGrid
from taccel_lab.interop.taxim_table import TaximTable
from taccel_lab.profile import BackgroundBlock, ColorBlock, Provenance, SensorProfile


@dataclass(frozen=True)
class HeldoutRender:
    """A press the fit never saw: capture, render and figures."""

    name: str
    captured: np.ndarray
    """RGB uint8, shape [height_px, width_px, 3]."""
    rendered: np.ndarray
    """RGB levels, float32, same shape."""
    corrected: np.ndarray
    """The render in the capture's light: drift fitted beyond 3 contact radii applied."""
    circle: ContactCircle
    """Circle in which the figures are taken."""
    score: ImageScore
    score_drift_corrected: ImageScore
    """Of ``corrected``."""
    background_only: ImageScore
    """The captured background alone against the capture."""


@dataclass(frozen=True)
class PressScore:
    """Figures of one press by a fit that never saw it."""

    name: str
    plain: ImageScore
    corrected: ImageScore
    """With the capture's drift applied to the render."""
    corrected_image: np.ndarray


@dataclass(frozen=True)
class Spread:
    """Standard deviation of the renders of fits to different presses [levels]."""

    disc_levels: float
    """Mean inside the contacts."""
    ring_levels: float
    """Mean from one to two contact radii."""
    fit_count: int


@dataclass(frozen=True)
class ColorCalibration:
    """Result of ``calibrate_color``."""

    fit: ColorFit
    heldout: list[HeldoutRender]
    train_names: list[str]
    noise_floor_l1: float
    """Mean difference of captures to the background beyond 3 contact radii [levels]; NaN when no
    capture shows that much."""
    source: str
    provenance: dict[str, str]
    background_sha256: str
    surface_provider: str
    """What made the surfaces."""
    valid_region: dict[str, tuple[float, float]]
    """Range of contact positions, tilts and displacements in the training presses."""
    circles: tuple[ContactCircle, ...]
    """Circles that the surfaces belong to, of all presses in order."""
    start_circles: tuple[ContactCircle, ...]
    """Circles that were simulated."""
    press_names: tuple[str, ...]
    grid: PixelGrid
    validated: list[PressScore] = field(default_factory=list)
    """All presses by fits without them; empty if not asked."""
    drift_choice: DriftChoice | None = None
    """None where the options alone said whether drift is taken off."""
    registration: Registration | None = None
    """How the circles of the training presses were read again; None if not."""
    spread: Spread | None = None
    table: TaximTable | None = None
    """Taxim's table, fitted to the training presses; None if not asked."""
    table_scores: list[PressScore] = field(default_factory=list)
    """Held-out presses rendered by the table."""
    capture_remarks: tuple[Remark, ...] = ()
    """What was known of the captures before the fit."""

    @property
    def drift_corrected(self) -> bool:
        """Whether figures in the capture's own light are the ones that count."""
        return self.fit.options.remove_drift

    @property
    def cross_validated_l1(self) -> dict[str, float]:
        """L1 in the disc of each press by a fit without it [levels]; empty if not asked."""
        return {item.name: self.counted(item).disc_l1 for item in self.validated}

    def counted(self, item: PressScore) -> ImageScore:
        """The figures that count: in the capture's light where drift was taken off."""
        return item.corrected if self.drift_corrected else item.plain

    def heldout_counted(self) -> list[ImageScore]:
        """The figures that count of the held-out presses."""
        return [
            item.score_drift_corrected if self.drift_corrected else item.score
            for item in self.heldout
        ]

    @property
    def remarks(self) -> tuple[Remark, ...]:
        """What a person has to know before the model is used."""
        return (*self.capture_remarks, *color_remarks(self))

    def figures(self) -> dict[str, Any]:
        """Means over the held-out presses and the table of presses, worst crop PSNR first."""
        common = self._common_figures()
        if not self.heldout:
            return {"heldout": None, "background_only": None, "presses": [], **common}
        worst_first = sorted(self.heldout, key=lambda item: item.score.crop_psnr_db)
        return {
            "heldout": mean_score([item.score for item in self.heldout]),
            "heldout_drift_corrected": mean_score(
                [item.score_drift_corrected for item in self.heldout]
            ),
            "background_only": mean_score([item.background_only for item in self.heldout]),
            "presses": [{"name": item.name, **vars(item.score)} for item in worst_first],
            **common,
        }

    def _common_figures(self) -> dict[str, Any]:
        found: dict[str, Any] = {
            "noise_floor_l1": self.noise_floor_l1,
            "train_disc_l1": self.fit.disc_l1_train,
            "cross_validated_disc_l1": self.cross_validated_l1,
            "loss_curve": self.fit.loss_curve,
            "fit_seconds": self.fit.seconds,
            "drift_removed": self.drift_corrected,
        }
        if self.validated:
            found["cross_validated"] = mean_score([self.counted(item) for item in self.validated])
        if self.drift_choice is not None:
            found["drift_choice"] = asdict(self.drift_choice)
        if self.spread is not None:
            found["spread"] = asdict(self.spread)
        if self.table_scores:
            found["taxim_table"] = mean_score([self.counted(item) for item in self.table_scores])
        if self.registration is not None:
            found["circles"] = {
                "scale": self.registration.scale,
                "scale_losses": self.registration.scale_losses,
                "sigma_px": self.registration.sigma_px.mean(axis=0).tolist(),
                **self.circle_changes(),
                "presses": {
                    name: {"u_px": c.u_px, "v_px": c.v_px, "radius_px": c.radius_px}
                    for name, c in zip(self.press_names, self.circles, strict=True)
                },
            }
        return found

    def circle_changes(self) -> dict[str, float]:
        """How far the circles moved when they were read again [px]."""
        pairs = list(zip(self.start_circles, self.circles, strict=True))
        moved = [np.hypot(b.u_px - a.u_px, b.v_px - a.v_px) for a, b in pairs]
        grown = [b.radius_px - a.radius_px for a, b in pairs]
        return {
            "center_moved_median_px": float(np.median(moved)),
            "center_moved_largest_px": float(np.max(moved)),
            "radius_grown_median_px": float(np.median(grown)),
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
        residuals = {}
        if np.isfinite(self.noise_floor_l1):
            residuals["far_field_l1_levels"] = self.noise_floor_l1
        return Provenance(
            kind="calibrated",
            method="captured background" + averaged * self.fit.options.average_background,
            source=self._source(),
            inputs=self._inputs(),
            residuals=residuals,
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
            if self.drift_corrected:
                for key, value in mean_score(self.heldout_counted()).items():
                    residuals[f"heldout_drift_corrected_{key}"] = value
        if self.validated:
            for key, value in mean_score([self.counted(v) for v in self.validated]).items():
                residuals[f"cross_validated_{key}"] = value
            values = list(self.cross_validated_l1.values())
            residuals["cross_validated_disc_l1_levels"] = float(np.mean(values))
            spread["cross_validated_disc_l1_levels"] = float(np.std(values))
        if self.spread is not None:
            spread["ensemble_disc_levels"] = self.spread.disc_levels
            spread["ensemble_ring_levels"] = self.spread.ring_levels
        return Provenance(
            kind="calibrated",
            method=self._method(),
            source=self._source(),
            inputs=self._inputs(),
            residuals=residuals,
            spread=spread,
            valid_region=self.valid_region,
            verdict=judge(self.remarks).value,
            remarks=tuple(str(remark) for remark in self.remarks),
        )

    def _method(self) -> str:
        options = self.fit.options
        parts = [
            f"MLP {list(options.hidden)} on {', '.join(options.inputs)}"
            + f" and {options.position_bands} bands of position" * (options.position_bands > 0)
            + f"; {options.steps} Adam "
            f"steps of {options.batch_pixels} pixels, {options.loss.capitalize()} loss, seed "
            f"{options.seed}; surfaces: {self.surface_provider}"
        ]
        if options.validation_every:
            parts.append(f"stopped at step {self.fit.step} by held-back presses")
        if options.remove_drift:
            parts.append("drift of the light taken off each frame")
        if self.registration is not None:
            parts.append("contact circles read again with the colours of the other presses")
        return "; ".join(parts)
