# SPDX-License-Identifier: Apache-2.0
"""What a calibration of normals found: the networks, their figures, and the block they become."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np

from taccel_lab.calibration.ball_presses import (
    ScoredFit,
    with_captured_background,
    with_doubtful_ball,
)
from taccel_lab.calibration.normals.network_fit import InverseFit
from taccel_lab.calibration.normals.samples import SyntheticScore
from taccel_lab.calibration.normals.score import HeldoutNormals, Reliability, flat_guess
from taccel_lab.calibration.response.frame import CaptureScene
from taccel_lab.calibration.result import calibrated, in_figures, mean_figures
from taccel_lab.calibration.scores import HELD_OUT
from taccel_lab.profile import NormalsBlock, Provenance, SensorProfile
from taccel_lab.report.remark import judge


@dataclass(frozen=True, repr=False, kw_only=True)
class NormalCalibration(ScoredFit[InverseFit]):
    """Result of ``calibrate_normals``."""

    scene: CaptureScene
    """Background, pixel grid, ball and resting face of the captures."""
    heldout: tuple[HeldoutNormals, ...]
    failures: dict[str, str]
    """Held-out presses that could not be read, and why: they count as a flat guess, but those whose
    labels their images reject."""
    rejected: frozenset[str]
    """Held-out presses whose labels their images reject: they are read where they are found, and
    stand beside the mean figures."""
    reliability: Reliability | None
    synthetic: SyntheticScore | None
    """Heights of synthetic presses that the networks never saw; None without any."""
    frozen_radius95_sigmas: float
    """What the model expected before the held-out presses widened it; figures are of the widened
    one, which is passed on."""
    frozen_along_factor: float
    flat_noise_levels: float
    """Mean difference of frames from the background in their light, beside the contacts [levels];
    NaN where no frame shows that much."""
    background_sha256: str
    source: str
    provenance: dict[str, str]
    """Provenance of the captures."""
    circles: str
    """How the circles were chosen."""
    surfaces: str
    """What gave the normals of the sink-in."""
    ball_share: float = 0.0
    """Standard deviation of slopes and depths, as a share of them, by a ball whose radius may be
    its diameter; 0 where that is known."""

    @property
    def train_names(self) -> tuple[str, ...]:
        """Names of the training presses in order."""
        return tuple(self.fit.inputs)

    def heldout_means(self, circles: Literal["given", "used"]) -> dict[str, float]:
        """Mean figures of the held-out presses, failures as flat guesses."""
        scores = [getattr(item, circles) for item in in_figures(self.heldout)]
        return mean_figures(scores + [flat_guess(scores)] * len(self.failed))

    @property
    def failed(self) -> dict[str, str]:
        """Entries of ``failures`` that count in the figures."""
        return {name: why for name, why in self.failures.items() if name not in self.rejected}

    def rejected_deg(self) -> dict[str, float | None]:
        """Mean error [degrees] of the held-out presses with rejected labels where they are found;
        None where they are not."""
        found = {item.name: item.used.mean_deg for item in self.heldout}
        return {name: found.get(name) for name in sorted(self.rejected)}

    def absolute_means(self) -> dict[str, float]:
        """Mean absolute depth figures of the held-out presses that were read."""
        return mean_figures([item.depth for item in in_figures(self.heldout)])

    def figures(self) -> dict[str, Any]:
        """Means over the held-out presses and the table of presses, worst first."""
        rows = [
            {
                "name": item.name,
                "depth": asdict(item.depth),
                "given": asdict(item.given),
                "used": asdict(item.used),
            }
            for item in sorted(self.heldout, key=lambda item: -item.used.mean_deg)
        ]
        held, config = None, self.fit.model.config
        if self.has_scores:
            held = {
                "absolute_depth": self.absolute_means(),
                "in_given_circles": self.heldout_means("given"),
                "in_used_circles": self.heldout_means("used"),
            }
        return {
            "verdict": judge(self.remarks),
            "remarks": [str(remark) for remark in self.remarks],
            "heldout": held,
            "split": None if self.split is None else self.split.figures(),
            "failures": self.failures,
            "rejected_labels": self.rejected_deg(),
            "reliability": None if self.reliability is None else asdict(self.reliability),
            "synthetic_presses": None if self.synthetic is None else asdict(self.synthetic),
            "gel_thickness": None if self.gel is None else self.gel.figures(),
            "presses": rows,
            "widened_by_heldout": {
                "radius95_sigmas": [self.frozen_radius95_sigmas, config.radius95_sigmas],
                "along_factor": [self.frozen_along_factor, config.along_factor],
            },
            "left_out_deg": self.fit.left_out_deg,
            "flat_noise_levels": self.flat_noise_levels,
            "circles": self.circles,
            "surfaces": self.surfaces,
            "curve": self.fit.curve,
            "stopped_at": self.fit.stopped_at,
            "fit_seconds": self.fit.seconds,
            "profile_presses": len(self.last.inputs),
        }

    def apply_to(self, profile: SensorProfile) -> SensorProfile:
        """``profile`` on the captures' grid, with the block normals, and a background where it has
        none."""
        profile = self.grounded(profile, self.scene.grid, self.provenance)
        profile = with_captured_background(
            profile, self.scene.background, self.source, self.background_sha256
        )
        model = self.last.model
        config = replace(model.config, unit_share=self.ball_share)
        return with_doubtful_ball(profile, self.ball_share).with_block(
            NormalsBlock(architecture=config.to_dict(), provenance=self.evidence), model.weights
        )

    @property
    def evidence(self) -> Provenance:
        """Provenance of the block."""
        left_out = list(self.fit.left_out_deg.values())
        residuals, spread = {}, {}
        if left_out:
            residuals["left_out_angle_deg"] = float(np.mean(left_out))
            spread["left_out_angle_deg"] = float(np.std(left_out))
        if self.has_scores:
            used = self.heldout_means("used")
            residuals |= {f"heldout_{key}": value for key, value in used.items()}
            residuals[HELD_OUT] = float(len(in_figures(self.heldout)) + len(self.failed))
            absolute = self.absolute_means()
            residuals["heldout_absolute_depth_mae_mm"] = absolute["mae_mm"]
            residuals["heldout_absolute_depth_mm"] = absolute["wanted_mm"]
            residuals["heldout_in_given_circles_deg"] = self.heldout_means("given")["mean_deg"]
            residuals["heldout_failures"] = float(len(self.failed))
            residuals["heldout_labels_rejected"] = float(len(self.rejected))
            kept = [item.used.mean_deg for item in in_figures(self.heldout)]
            spread["heldout_angle_deg"] = float(np.std(kept))
        if not residuals:
            residuals["train_angle_deg"] = self.fit.curve[-1][1]
        if self.synthetic is not None:
            residuals["synthetic_depth_rmse_mm"] = self.synthetic.rmse_mm
        if self.reliability is not None:
            residuals["observed_over_expected"] = self.reliability.ratio()
        config, options = self.fit.model.config, self.fit.options
        return calibrated(
            self.remarks,
            method=f"{config.members} networks {list(config.hidden)} on colour change over windows "
            f"of {', '.join(f'{s:g}' for s in config.scales_px)} px and position"
            + f" in {config.position_bands} bands"
            * (config.position_bands > 0)
            + f"; {options.steps} steps of Muon and Adam, stopped on left-out presses; "
            f"{options.synthetic_presses if self.synthetic else 0} synthetic presses; circles: "
            f"{self.circles}; sink-in: {self.surfaces}; light of each frame taken off"
            + f"; read by one of {list(config.small_hidden)} that was taught their answers"
            * bool(config.small_hidden)
            + f"; {self.then_fitted}" * (self.final is not None),
            source=self.source,
            inputs={"background": self.background_sha256} | self.last.inputs,
            residuals=residuals,
            spread=spread,
            valid_region=self.valid_region,
        )
