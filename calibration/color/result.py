# SPDX-License-Identifier: Apache-2.0
"""What a colour calibration found: the fit, its figures, and the blocks that it becomes.

Held-out presses are rendered by the frozen model, and scored. One that cannot be placed, or that is
gone, counts as the bare background. One whose label its image rejects is rendered where it is
found, and stands beside the mean figures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np

from taccel_lab.calibration.ball_presses import ScoredFit
from taccel_lab.calibration.capture.captures import CapturedPress, CaptureSet, ContactCircle
from taccel_lab.calibration.capture.folder import source_of
from taccel_lab.calibration.circles.ball_surface import BallSurface
from taccel_lab.calibration.circles.labels import LabelPlacement
from taccel_lab.calibration.color.network_fit import ColorFit
from taccel_lab.calibration.response.frame import (
    CaptureScene,
    HeldoutFailure,
    ImageScore,
    PressFrame,
    light_beside,
    score_image,
)
from taccel_lab.calibration.result import calibrated, in_figures, mean_figures
from taccel_lab.calibration.scores import HELD_OUT
from taccel_lab.errors import InputError
from taccel_lab.exporters.taxim_table import TaximTable
from taccel_lab.profile import BackgroundBlock, ColorBlock, Provenance, SensorProfile

Placement = Literal["label", "found"]


@dataclass(frozen=True)
class PressScore:
    """Figures of one press, in the light of the capture where the fit took drift off."""

    name: str
    score: ImageScore


@dataclass(frozen=True, repr=False, kw_only=True)
class ColorCalibration(ScoredFit[ColorFit]):
    """Result of ``calibrate_color``."""

    heldout: Sequence[HeldoutPress]
    failures: list[HeldoutFailure]
    """Presses that were held out and could not: they count as the bare background, but those whose
    labels their images reject."""
    label_shift: LabelPlacement
    noise_floor_l1: float
    """Mean difference of captures from the background in their light beside the contacts [levels];
    NaN when no capture shows that much."""
    captures: CaptureSet
    """The training presses."""
    surface_provider: str
    """What made the surfaces."""
    circles: tuple[ContactCircle, ...]
    """Circles that the surfaces belong to, of the training presses in order."""
    table: TaximTable | None = None
    """Taxim's table, fitted to the training presses; None if not asked."""
    table_scores: list[PressScore] = field(default_factory=list)
    """Held-out presses rendered by the table."""

    @property
    def train_names(self) -> list[str]:
        """Names of the training presses in order."""
        return [press.name for press in self.captures.presses]

    @property
    def rejected(self) -> dict[str, float | None]:
        """PSNR of the crop [dB] of held-out presses whose labels their images reject, rendered
        where they are found; None where they are not. They stand beside the mean figures."""
        scores = {p.name: p.score.crop_psnr_db for p in self.heldout if p.rejected}
        return scores | {item.name: None for item in self.failures if item.rejected}

    @property
    def placement(self) -> Placement:
        """How the held-out presses were placed: ``found`` where any comes without a label."""
        return "found" if any(p.placement == "found" for p in in_figures(self.heldout)) else "label"

    def heldout_means(self) -> dict[str, float]:
        """Mean figures of the held-out presses, failures as the bare background."""
        return mean_heldout(self.heldout, self.failures)

    @property
    def score(self) -> ImageScore:
        """Mean score of the held-out presses, failures as the bare background; InputError where
        none was held out."""
        if not self.has_scores:
            raise InputError("no press was held out: there is no score")
        return ImageScore(**self.heldout_means())

    def heldout_l1(self) -> dict[str, float]:
        """L1 in the disc of each held-out press, as quoted [levels]."""
        return {item.name: item.score.disc_l1 for item in self.heldout}

    def table_means(self) -> dict[str, float]:
        """Mean figures of the held-out presses rendered by Taxim's table; empty without any."""
        scores = [item.score for item in self.table_scores]
        return mean_figures(scores) if scores else {}

    def figures(self) -> dict[str, Any]:
        """Means over the held-out presses and the table of presses, worst crop PSNR first."""
        found: dict[str, Any] = {"heldout": None, "background_only": None, "presses": []}
        if self.has_scores:
            worst_first = sorted(self.heldout, key=lambda item: item.score.crop_psnr_db)
            found = {
                "heldout": self.heldout_means(),
                "heldout_placed_by": self.placement,
                "background_only": mean_bare(self.heldout, self.failures),
                "presses": [{"name": item.name, **vars(item.score)} for item in worst_first],
            }
        found |= {
            "failures": {item.name: item.reason for item in self.failures},
            "heldout_failed": len(in_figures(self.failures)),
            "rejected_labels": self.rejected,
            "noise_floor_l1": self.noise_floor_l1,
            "train_disc_l1": self.fit.disc_l1_train,
            "loss_curve": self.fit.loss_curve,
            "fit_seconds": self.fit.seconds,
            "profile_presses": len(self.last.inputs),
        }
        if self.gel is not None:
            found["gel_thickness"] = self.gel.figures()
        if self.split is not None:
            found["split"] = self.split.figures()
        if self.label_shift.count:
            found["label_shift"] = {
                "mean_px": self.label_shift.mean_px.tolist(),
                "radius_slope": self.label_shift.radius_slope,
                "deviation_px": self.label_shift.deviation_px.tolist(),
                "presses": self.label_shift.count,
            }
        if self.table_scores:
            found["taxim_table"] = self.table_means()
        found["circles"] = {
            name: asdict(circle)
            for name, circle in zip(self.train_names, self.circles, strict=True)
        }
        return found

    def apply_to(self, profile: SensorProfile) -> SensorProfile:
        """``profile`` on the captures' grid, with the blocks background and color."""
        # An old background or model may be of another image size; both are replaced.
        profile = profile.without("background", "color")
        profile = self.grounded(profile, self.captures.grid, self.captures.provenance)
        fit = self.last
        if self.untouched is None:
            profile = profile.with_block(self._captured_background(), fit.background)
        block = ColorBlock(architecture=fit.model.config.to_dict(), provenance=self.evidence)
        return profile.with_block(block, fit.model.weights)

    def _inputs(self, fit: ColorFit) -> dict[str, str]:
        return {"background": self.captures.background_sha256} | fit.inputs

    def _source(self) -> str:
        return source_of(self.captures.provenance, self.captures.source)

    def _captured_background(self) -> BackgroundBlock:
        residuals = {}
        if np.isfinite(self.noise_floor_l1):
            residuals["far_field_l1_levels"] = self.noise_floor_l1
        provenance = Provenance(
            kind="calibrated",
            method="captured background",
            source=self._source(),
            inputs=self._inputs(self.fit),
            residuals=residuals,
            valid_region={"level": (0.0, 255.0)},
        )
        return BackgroundBlock(provenance=provenance)

    @property
    def evidence(self) -> Provenance:
        """Provenance of the block."""
        train = list(self.fit.disc_l1_train.values())
        residuals = {"train_disc_l1_levels": float(np.mean(train))}
        spread = {"train_disc_l1_levels": float(np.std(train))}
        if self.has_scores:
            residuals |= {f"heldout_{key}": value for key, value in self.heldout_means().items()}
            if self.heldout:
                spread["heldout_disc_l1_levels"] = float(np.std(list(self.heldout_l1().values())))
            residuals[HELD_OUT] = float(len(in_figures([*self.heldout, *self.failures])))
            bare = mean_bare(self.heldout, self.failures)
            residuals["background_crop_psnr_db"] = bare["crop_psnr_db"]
            residuals["heldout_failures"] = float(len(in_figures(self.failures)))
            residuals["heldout_labels_rejected"] = float(len(self.rejected))
        return calibrated(
            self.remarks,
            method=self._method(),
            source=self._source(),
            inputs=self._inputs(self.last),
            residuals=residuals,
            spread=spread,
            valid_region=self.valid_region,
        )

    def _method(self) -> str:
        options = self.fit.options
        parts = [
            f"MLP {list(options.hidden)} on {', '.join(options.inputs)}"
            + f" and {options.position_bands} bands of position" * (options.position_bands > 0)
            + f"; {options.steps} steps of Muon and Adam with "
            f"{options.batch_pixels} pixels, Huber loss, seed "
            f"{options.seed}; surfaces: {self.surface_provider}",
            "light of each frame taken off",
        ]
        if self.split is not None and self.has_scores:
            parts.append(
                f"{len(self.split.heldout) + len(self.split.gone)} presses held out by "
                f"{self.split.by} (SHA-256 of their names {self.split.sha256[:16]}), placed by "
                f"{self.placement}, {len(in_figures(self.failures))} failed"
                + f", {len(self.rejected)} with a rejected label apart"
                * bool(self.rejected)
            )
        parts += [self.then_fitted] * (self.final is not None)
        return "; ".join(parts)


@dataclass(frozen=True)
class HeldoutPress:
    """A press the fit never saw: capture, render and figures."""

    name: str
    captured: np.ndarray
    """RGB uint8, shape [height_px, width_px, 3]."""
    circle: ContactCircle
    """Circle in which the figures are taken: the label, or what was found without one."""
    placed: ContactCircle
    """Where it is rendered: where its label puts it, or where it was found."""
    placement: Placement
    rejected: bool
    """Whether the image rejects the label."""
    surface: BallSurface
    """Surface under the press in that circle."""
    rendered: np.ndarray
    """RGB levels in the light of the background, float32, shape [height_px, width_px, 3]."""
    shown: np.ndarray
    """The same in the light of the capture."""
    score: ImageScore
    """Score of ``shown``."""
    background_only: ImageScore
    """The captured background alone against the capture."""


def score_heldout(
    press: CapturedPress,
    frame: PressFrame,
    rendered: np.ndarray,
    scene: CaptureScene,
    captured_background: np.ndarray,
) -> HeldoutPress:
    """A press in its place, ``rendered`` there, and compared with its capture."""
    figures_in = press.circle or frame.circle
    shown = in_light_of(frame.image, rendered, figures_in, scene)
    return HeldoutPress(
        press.name, frame.image, figures_in, frame.circle,
        "found" if press.circle is None else "label", press.mislabelled, frame.surface, rendered,
        shown,
        score_image(shown, frame.image, figures_in, scene.grid),
        score_image(captured_background, frame.image, figures_in, scene.grid),
    )  # fmt: skip


def in_light_of(
    captured: np.ndarray, rendered: np.ndarray, circle: ContactCircle, scene: CaptureScene
) -> np.ndarray:
    """A render in the light of its capture, levels, shape [height_px, width_px, 3]."""
    # Against the render, which has the gel's shade beside the contact, too.
    light = light_beside(captured, scene, circle, rendered)
    return np.clip(light.apply(rendered), 0.0, 255.0)


def mean_heldout(
    presses: Sequence[HeldoutPress], failures: Sequence[HeldoutFailure]
) -> dict[str, float]:
    """Mean figures of the held-out presses but those with rejected labels, failures as the bare
    background."""
    return mean_figures([item.score for item in in_figures(presses)] + _bare(presses, failures))


def mean_bare(
    presses: Sequence[HeldoutPress], failures: Sequence[HeldoutFailure]
) -> dict[str, float]:
    """Mean figures of the bare background over the same presses."""
    kept = [item.background_only for item in in_figures(presses)]
    return mean_figures(kept + _bare(presses, failures))


def _bare(presses: Sequence[HeldoutPress], failures: Sequence[HeldoutFailure]) -> list[ImageScore]:
    """What failures count as: nobody knows where to look, so the worst background of the others."""
    worst = min((item.background_only for item in presses), key=lambda score: score.crop_psnr_db)
    return [worst] * len(in_figures(failures))
