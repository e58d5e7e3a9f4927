# SPDX-License-Identifier: Apache-2.0
"""A calibration of markers: the fitted block with its evidence, and the tracks."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from taccel_lab.calibration.capture.folder import Video
from taccel_lab.calibration.markers.gel_view import PixelView
from taccel_lab.calibration.markers.tracks import (
    MarkerFlow,
    MarkerTracks,
    TrackFigures,
    marker_flow_mm,
)
from taccel_lab.calibration.result import BlockResult, Estimate, calibrated
from taccel_lab.profile import MarkersBlock, SensorProfile
from taccel_lab.reading.dots.detection import DotFlag
from taccel_lab.reading.dots.lattice import (
    CENTRE_X,
    CENTRE_Y,
    PITCH_X,
    PITCH_Y,
    ROTATION,
    LayoutFit,
)
from taccel_lab.reading.dots.marker_picture import MarkerPicture
from taccel_lab.report.remark import Remark


@dataclass(frozen=True)
class TrackedVideo:
    """One video and what was followed in it."""

    name: str
    video: Video
    tracks: MarkerTracks
    figures: TrackFigures


@dataclass(frozen=True, repr=False)
class MarkerCalibration(BlockResult):
    """Dots at rest, their layout on the gel, and their motion."""

    source: str
    image: np.ndarray
    """Picture at rest, RGB, shape [height_px, width_px, 3]."""
    picture: MarkerPicture
    layout_mm: LayoutFit
    radius_mm: float
    radius_sigma_mm: float
    view: PixelView
    videos: tuple[TrackedVideo, ...]
    remarks: tuple[Remark, ...]
    inputs: dict[str, str] = field(default_factory=dict)

    def flows(self) -> dict[str, MarkerFlow]:
        """Flow in millimetres of every video, by name."""
        return {
            video.name: marker_flow_mm(video.tracks, self.view, fps=video.video.entry.fps)
            for video in self.videos
        }

    def estimates(self) -> dict[str, Estimate]:
        """Fitted quantities with their standard deviations, the scale's included."""
        layout, scale = self.layout_mm, self.view.scale_sigma
        found = {}
        for name, which in (("pitch_x_mm", PITCH_X), ("pitch_y_mm", PITCH_Y)):
            value = float(layout.parameters[which])
            sigma = float(np.hypot(layout.sigma(which), scale * value))
            found[name] = Estimate(value, sigma, "mm")
        found["radius_mm"] = Estimate(
            self.radius_mm, float(np.hypot(self.radius_sigma_mm, scale * self.radius_mm)), "mm"
        )
        for name, which in (("offset_x_mm", CENTRE_X), ("offset_y_mm", CENTRE_Y)):
            found[name] = Estimate(float(layout.parameters[which]), layout.sigma(which), "mm")
        sigma_deg = float(np.degrees(layout.sigma(ROTATION)))
        found["rotation_deg"] = Estimate(layout.rotation_deg, sigma_deg, "deg")
        return found

    def residuals(self) -> dict[str, float]:
        """What the fits left over."""
        dots = self.picture.dots
        left = {
            "grid_rms_mm": self.layout_mm.residual_rms,
            "dot_sigma_px": float(np.median(dots.sigma_px)),
            "grid_rms_px": self.picture.layout_px.residual_rms,
        }
        worst = {
            "rest_jitter_px": [video.figures.jitter_px for video in self.videos],
            "return_error_px": [video.figures.return_median_px for video in self.videos],
        }
        for name, values in worst.items():
            if known := [value for value in values if value is not None]:
                left[name] = max(known)
        return left

    def apply_to(self, profile: SensorProfile) -> SensorProfile:
        """``profile`` with the ``markers`` block."""
        layout, uv = self.layout_mm, self.picture.dots.uv_px[self.picture.lattice.numbered]
        estimates = self.estimates()
        valid = {
            "u_px": (float(uv[:, 0].min()), float(uv[:, 0].max())),
            "v_px": (float(uv[:, 1].min()), float(uv[:, 1].max())),
        }
        moved = [v.figures.largest_px for v in self.videos]
        if moved:
            valid["displacement_px"] = (0.0, max(moved))
        sigmas = layout.sigma(PITCH_X) * layout.sigma(PITCH_Y)
        correlation = float(layout.covariance[PITCH_X, PITCH_Y] / sigmas) if sigmas > 0 else 0.0
        block = MarkersBlock(
            rows=layout.rows,
            columns=layout.columns,
            pitch_x_mm=layout.pitch[0],
            pitch_y_mm=layout.pitch[1],
            radius_mm=self.radius_mm,
            offset_mm=(float(layout.centre[0]), float(layout.centre[1])),
            rotation_deg=layout.rotation_deg,
            stagger=layout.stagger,
            missing=layout.missing,
            provenance=calibrated(
                self.remarks,
                method="ellipses fitted to the dots of a picture at rest, numbered by lattice "
                f"growth, a grid fitted to them on the gel; millimetres from "
                f"{self.view.description}; only dots in view are described",
                source=self.source.replace("\\", "/").split("/")[-1],
                inputs=self.inputs,
                residuals=self.residuals(),
                spread={name: estimate.sigma for name, estimate in estimates.items()},
                correlation={"pitch_x_mm*pitch_y_mm": correlation},
                valid_region=valid,
            ),
        )
        return profile.with_block(block)

    def figures(self) -> dict[str, Any]:
        """Everything measured, ready for JSON."""
        dots, layout_px = self.picture.dots, self.picture.layout_px
        return {
            "source": self.source,
            "dots": dots.count,
            "dark": dots.scale.sign < 0,
            "cut": int(dots.flagged(DotFlag.CUT).sum()),
            "merged": int(dots.flagged(DotFlag.MERGED).sum()),
            "odd": int(dots.flagged(DotFlag.ODD).sum()),
            "lattice": self.picture.lattice.kind,
            "rows": self.layout_mm.rows,
            "columns": self.layout_mm.columns,
            "stagger": self.layout_mm.stagger,
            "missing": [list(place) for place in self.layout_mm.missing],
            "skew_deg": float(np.degrees(self.layout_mm.skew_rad)),
            "scale_from": self.view.description,
            "estimates": {name: found.figures() for name, found in self.estimates().items()},
            "residuals": self.residuals(),
            "videos": [asdict(video.figures) for video in self.videos],
            "pitch_px": list(layout_px.pitch),
            "pitch_sigma_px": [layout_px.sigma(PITCH_X), layout_px.sigma(PITCH_Y)],
        }
