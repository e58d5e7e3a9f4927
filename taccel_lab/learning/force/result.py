# SPDX-License-Identifier: Apache-2.0
"""What the training of a force model found: the network, its errors, and the block they become."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from taccel_lab.calibration.result import BlockResult, calibrated
from taccel_lab.learning.force.options import ForceOptions
from taccel_lab.learning.force.samples import ForceSamples, Split
from taccel_lab.learning.force.score import Errors, Imposters, as_json
from taccel_lab.learning.force.train import COMPARED, Predictions, TrainedForces
from taccel_lab.networks.force_settings import (
    ForceModelConfig,
)
from taccel_lab.profile import ForceBlock, SensorProfile
from taccel_lab.report.remark import Remark, judge


@dataclass(frozen=True, repr=False)
class ForceCalibration(BlockResult):
    """Result of ``calibrate_force``."""

    trained: TrainedForces
    config: ForceModelConfig
    """Configuration with factors and limits."""
    split: Split
    options: ForceOptions
    counts: dict[str, int]
    """Images for training, validation and test."""
    test: ForceSamples
    predicted: Predictions
    """Predictions of ``test``, in drawn lights."""
    overall: Errors
    """Errors of all touched images of the test."""
    at_rest: Errors | None
    """Errors of its untouched images."""
    same_light: Errors
    """Errors as ``overall``, in the background's own light."""
    unknown_stiffness_n: float
    """Error of the force along z against the touch's own modulus, which no image shows [N, rms]."""
    tables: dict[str, list[Errors]]
    false_alarms: float
    """Share of the test's images that are called outside."""
    imposters: list[Imposters]
    label_floor_n: tuple[float, float]
    """Estimated discretisation error of the labels, median and 95th percentile [N]."""
    markers_tell: bool
    inputs: dict[str, str]
    source: str
    seconds: float
    remarks: tuple[Remark, ...] = ()

    @property
    def parameter_count(self) -> int:
        """Numbers that were trained."""
        return sum(
            value.size
            for name, value in self.trained.weights.items()
            if not name.startswith(COMPARED)
        )

    def headline(self) -> str:
        """The errors in one sentence."""
        found = self.overall
        return (
            f"on held-out touches the force along z is off by {found.fz_n:.3f} N of "
            f"{found.fz_spread_n:.3f} N (root mean squares; median {found.fz_relative:.1%} above "
            f"0.2 N), the force along the face by {found.shear_n:.3f} N of "
            f"{found.shear_spread_n:.3f} N, the area by {found.area_mm2:.2f} mm2"
        )

    def figures(self) -> dict[str, Any]:
        """Everything measured, ready for JSON."""
        return {
            "verdict": judge(self.remarks),
            "remarks": [str(remark) for remark in self.remarks],
            "parameters": self.parameter_count,
            "images": self.counts,
            "split": {
                "rule": self.split.rule,
                "validation_objects": list(self.split.validation_objects),
                "test_objects": list(self.split.test_objects),
                "test_units": list(self.split.test_units),
            },
            "markers": self.markers_tell,
            "heldout": as_json(self.overall),
            "heldout_at_rest": None if self.at_rest is None else as_json(self.at_rest),
            "heldout_same_light": as_json(self.same_light),
            "heldout_unknown_stiffness_fz_n": self.unknown_stiffness_n,
            "by": {name: [as_json(row) for row in rows] for name, rows in self.tables.items()},
            "false_alarms": self.false_alarms,
            "wrong_images_found": [as_json(row) for row in self.imposters],
            "label_floor_n": {"median": self.label_floor_n[0], "p95": self.label_floor_n[1]},
            "stiffness_relative": self.config.stiffness_relative,
            "young_modulus_pa": self.config.young_modulus_pa,
            "limits": {
                "distance_of_features": self.config.distance_limits[0],
                "distance_of_statistics": self.config.distance_limits[1],
                "distance_of_colors": self.config.distance_limits[2],
                "fz_n": self.config.most[0],
                "shear_n": self.config.most[1],
                "area_mm2": self.config.most[2],
                "patch_n": self.config.most[3],
            },
            "curve": [list(point) for point in self.trained.curve],
            "device": self.options.device,
            "seconds": self.seconds,
        }

    def apply_to(self, profile: SensorProfile) -> SensorProfile:
        """``profile`` with the block force."""
        found, truth = self.overall, self.test.targets
        shear = np.hypot(truth[:, 0], truth[:, 1])
        block = ForceBlock(
            architecture=self.config.to_dict(),
            provenance=calibrated(
                self.remarks,
                method=f"convolutional network of {self.parameter_count} numbers, trained on "
                f"{self.counts['training']} images of simulated touches, seed "
                f"{self.options.seed}; {self.split.rule}",
                source=self.source,
                inputs=self.inputs,
                residuals={
                    "heldout_fz_rms_n": found.fz_n,
                    "heldout_fz_spread_n": found.fz_spread_n,
                    "heldout_shear_rms_n": found.shear_n,
                    "heldout_tz_rms_nmm": found.tz_nmm,
                    "heldout_area_rms_mm2": found.area_mm2,
                    "heldout_inside_95": found.inside95,
                    "heldout_false_alarms": self.false_alarms,
                    "label_floor_n": self.label_floor_n[0],
                },
                spread={"stiffness_relative": self.config.stiffness_relative},
                valid_region={
                    "fz_n": (0.0, self.config.most[0]),
                    "shear_n": (0.0, self.config.most[1]),
                    "area_mm2": (0.0, self.config.most[2]),
                    "tested_fz_n": (0.0, float(truth[:, 2].max())),
                    "tested_shear_n": (0.0, float(shear.max())),
                },
            ),
        )
        return profile.with_block(block, self.trained.weights)
