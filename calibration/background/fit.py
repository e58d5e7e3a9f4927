# SPDX-License-Identifier: Apache-2.0
"""From the frames of a capture folder to the background block, and what its light did."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from taccel_lab.calibration.background.drift import Drift, fit_robust_drift
from taccel_lab.calibration.background.drift_report import DriftSpread, drift_remark, drift_spread
from taccel_lab.calibration.background.dust import dust_mask, speck_count
from taccel_lab.calibration.background.untouched import (
    RunningMean,
    background_from_presses,
    steady_pixels,
    untouched_pixels,
)
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.result import Remark, Severity, judge
from taccel_lab.errors import InputError
from taccel_lab.profile import BackgroundBlock, CameraBlock, Provenance, SensorProfile

Progress = Callable[[int, int], None]

CLIPPED_SHARE = 0.01
STALE_LEVELS = 2.0
MIN_SEEN_SHARE = 0.15
"""A frame that shows less untouched gel than this is left out."""


@dataclass(frozen=True)
class FrameLight:
    """One frame against the background."""

    name: str
    kind: str
    """``background``, ``untouched`` or ``press``."""
    drift: Drift
    seen_share: float
    """Share of the image that shows untouched gel."""
    plain_l1: float
    """Mean difference of the untouched part from the one background image [levels]."""
    corrected_l1: float
    """The same from the background that was made of the other frames, in this frame's light."""


@dataclass(frozen=True)
class BackgroundCalibration:
    """The background image with what is known of its quality."""

    image: np.ndarray
    """RGB levels, float32, shape [height_px, width_px, 3]."""
    frames: tuple[FrameLight, ...]
    spread: DriftSpread | None
    """None of a single frame."""
    noise: np.ndarray
    """Noise of each pixel between frames [levels], NaN where unknown, shape [height, width]."""
    dust: np.ndarray
    """Specks of the background, bool, shape [height_px, width_px]."""
    new_dust: np.ndarray
    """Specks that the presses show and the background image does not, likewise."""
    remarks: tuple[Remark, ...]
    inputs: dict[str, str]
    source: str
    mm_per_px: tuple[float, float] | None
    method: str

    @property
    def noise_levels(self) -> float | None:
        """Median noise of a pixel between frames [levels]; None with fewer than 3 frames."""
        known = self.noise[np.isfinite(self.noise)]
        return float(np.median(known)) if len(known) else None

    def figures(self) -> dict[str, Any]:
        """Everything measured, ready for JSON."""
        rows = []
        for frame in self.frames:
            drift = frame.drift
            rows.append(
                {
                    "name": frame.name,
                    "kind": frame.kind,
                    "gain_rgb": drift.gain.tolist(),
                    "offset_rgb": drift.offset.tolist(),
                    "gradient_rgb": drift.gradient.tolist(),
                    "noise_levels": drift.noise_levels,
                    "untouched_share": frame.seen_share,
                    "plain_l1": frame.plain_l1,
                    "corrected_l1": frame.corrected_l1,
                }
            )
        return {
            "verdict": judge(self.remarks),
            "plain_l1": self._mean("plain_l1"),
            "heldout_l1": self._mean("corrected_l1"),
            "noise_levels": self.noise_levels,
            "drift": None
            if self.spread is None
            else {**asdict(self.spread), "auto_white_balance": self.spread.auto_white_balance},
            "dust_specks": speck_count(self.dust),
            "dust_share": float(self.dust.mean()),
            "new_dust_specks": speck_count(self.new_dust),
            "frames": rows,
        }

    def _mean(self, name: str) -> float:
        return float(np.mean([getattr(frame, name) for frame in self.frames]))

    def apply_to(self, profile: SensorProfile) -> SensorProfile:
        """``profile`` with the background, and the image's size where the profile has another."""
        height, width = self.image.shape[:2]
        camera = profile.camera
        if (camera.width_px, camera.height_px) != (width, height):
            if self.mm_per_px is None:
                raise InputError(
                    f"the captures are {width}x{height} px, the profile's camera "
                    f"{camera.width_px}x{camera.height_px} px, and the captures state no scale; "
                    "give mm_per_px_x and mm_per_px_y, or a --base with a calibrated camera"
                )
            profile = profile.without("background", "color", "normals").with_block(
                CameraBlock(
                    width_px=width,
                    height_px=height,
                    mm_per_px_x=self.mm_per_px[0],
                    mm_per_px_y=self.mm_per_px[1],
                    center_u_px=(width - 1) / 2,
                    center_v_px=(height - 1) / 2,
                    provenance=Provenance(
                        kind="published",
                        method="image size and scale of the captures; the image centre lies over "
                        "the apex",
                        source=self.source,
                    ),
                )
            )
        residuals = {
            "heldout_untouched_l1_levels": self._mean("corrected_l1"),
            "plain_untouched_l1_levels": self._mean("plain_l1"),
        }
        spread = {
            "heldout_untouched_l1_levels": float(np.std([f.corrected_l1 for f in self.frames]))
        }
        if self.noise_levels is not None:
            spread["pixel_levels"] = self.noise_levels
        if self.spread is not None:
            for name, value in zip(("red", "green", "blue"), self.spread.shift_levels, strict=True):
                spread[f"drift_{name}_levels"] = value
        return profile.with_block(
            BackgroundBlock(
                provenance=Provenance(
                    kind="calibrated",
                    method=self.method,
                    source=self.source,
                    inputs=self.inputs,
                    residuals=residuals,
                    spread=spread,
                    valid_region={
                        "level": (float(self.image.min()), float(self.image.max())),
                    },
                    verdict=judge(self.remarks).value,
                    remarks=tuple(remark.message for remark in self.remarks),
                )
            ),
            self.image,
        )


def calibrate_background(
    folder: CaptureFolder, progress: Progress | None = None
) -> BackgroundCalibration:
    """The untouched sensor from all the frames of ``folder``, in the light of its background.

    The background image, the other untouched images and the untouched parts of the presses are
    brought to one light and averaged; without any untouched image the background is the median of
    the presses. Each frame is then compared with the mean of the others. Raises InputError when
    there is nothing to make a background of.
    """
    sources = _sources(folder)
    mask = folder.mask
    if mask is not None and mask.all():
        mask = None
    from_presses = not any(kind != "press" for _, kind, _, _ in sources)
    if from_presses:
        reference = background_from_presses([read for _, _, _, read in sources], mask)
    else:
        reference = sources[0][3]().astype(np.float32)
    running = RunningMean.empty(reference.shape)
    lights: list[_Light] = []
    new = RunningMean.empty(reference.shape)
    for k, (_, kind, _, read) in enumerate(sources):
        image = read()
        drift = fit_robust_drift(image, reference, mask)
        seen = untouched_pixels(image, reference, drift, mask)
        used = seen if kind != "press" else steady_pixels(image, reference, drift, mask)
        if seen.mean() < MIN_SEEN_SHARE:
            used = np.zeros_like(used)
        lights.append((drift, seen, used))
        steady = drift.remove(image.astype(np.float64))
        running.add(steady, used)
        if kind != "background":
            new.add(steady - reference, seen)
        if progress is not None:
            progress(k + 1, len(sources))
    average = running.mean(reference)
    if mask is not None:
        average[~mask] = reference[~mask]
    frames = tuple(
        _compare(source, light, running, reference)
        for source, light in zip(sources, lights, strict=True)
    )
    drifts = [frame.drift for frame in frames if frame.kind != "background"]
    dust = dust_mask(average, mask)
    new_dust = np.zeros_like(dust)
    if not from_presses and new.count.max() >= MIN_SEEN_FRAMES:
        new_dust = dust_mask(new.mean(np.zeros_like(reference)), mask)
        new_dust &= new.count >= MIN_SEEN_FRAMES
    return BackgroundCalibration(
        image=np.clip(average, 0, 255).astype(np.float32),
        frames=frames,
        spread=drift_spread(drifts, reference) if len(drifts) > 1 else None,
        noise=running.noise(),
        dust=dust,
        new_dust=new_dust,
        remarks=(
            *_remarks(sources, frames, drifts, reference, new_dust, from_presses),
            *_against_presses(folder),
        ),
        inputs={name: sha for name, _, sha, _ in sources},
        source=folder.provenance.get("source", folder.source),
        mm_per_px=folder.mm_per_px,
        method=(
            "median of the untouched parts of the presses"
            if from_presses
            else "mean of the untouched images and the untouched parts of the presses"
        )
        + ", each frame's gain, offset and gradient of the light taken off",
    )


MIN_SEEN_FRAMES = 3
"""Frames that have to show a new speck."""

_Light = tuple[Drift, np.ndarray, np.ndarray]
"""Drift, untouched pixels, and those of them that the average takes."""
_Source = tuple[str, str, str, Callable[[], np.ndarray]]


def _sources(folder: CaptureFolder) -> list[_Source]:
    """(name, kind, hash, read) of every frame, the background first."""
    sources: list[_Source] = []
    if folder.background is not None:
        frame = folder.background
        sources.append(("background", "background", frame.sha256, frame.read))
    for i, frame in enumerate(folder.untouched):
        sources.append((f"untouched_{i}_{frame.name}", "untouched", frame.sha256, frame.read))
    sources += [(p.name, "press", p.sha256, p.read) for p in folder.presses]
    if not sources:
        raise InputError(
            f"{folder.source} holds neither an untouched image nor presses; give background or "
            "untouched"
        )
    sizes = {read().shape[:2] for _, _, _, read in sources}
    if len(sizes) > 1:
        found = ", ".join(f"{w}x{h}" for h, w in sorted(sizes))
        raise InputError(f"{folder.source}: images of several sizes ({found} px); one is allowed")
    return sources


def _compare(
    source: _Source, light: _Light, running: RunningMean, reference: np.ndarray
) -> FrameLight:
    name, kind, _, read = source
    drift, seen, used = light
    image = read().astype(np.float64)
    # The mean of the others alone.
    total = running.total - np.where(used[..., None], drift.remove(image), 0.0)
    count = running.count - used
    others = np.where(count[..., None] > 0, total / np.maximum(count, 1)[..., None], reference)
    where = seen if seen.any() else np.ones_like(seen)
    return FrameLight(
        name=name,
        kind=kind,
        drift=drift,
        seen_share=float(seen.mean()),
        plain_l1=float(np.abs(image - reference)[where].mean()),
        corrected_l1=float(np.abs(image - drift.apply(others))[where].mean()),
    )


def _against_presses(folder: CaptureFolder) -> list[Remark]:
    """Errors when the background is framed otherwise than the presses, another one, or pressed."""
    # Loaded here: the check of captures itself compares light by this package.
    from taccel_lab.calibration.check.background import check_background

    if folder.background is None:
        return []
    found = check_background(folder).findings
    return [finding for finding in found if finding.severity is Severity.ERROR]


def _remarks(
    sources: list[_Source],
    frames: tuple[FrameLight, ...],
    drifts: list[Drift],
    reference: np.ndarray,
    new_dust: np.ndarray,
    from_presses: bool,
) -> tuple[Remark, ...]:
    remarks = []
    if from_presses:
        remarks.append(
            Remark(
                Severity.WARNING,
                "no_untouched_image",
                f"no image of the untouched sensor: the background is the median of "
                f"{len(sources)} presses; what they all touch is wrong. Record one",
            )
        )
    if len(sources) == 1:
        remarks.append(
            Remark(
                Severity.WARNING,
                "single_frame",
                "one frame: neither noise nor drift can be told; give more as untouched",
            )
        )
    if len(drifts) > 1:
        remarks.append(drift_remark(drifts, reference))
    clipped = float(((reference <= 0.5) | (reference >= 254.5)).any(axis=-1).mean())
    if clipped > CLIPPED_SHARE:
        remarks.append(
            Remark(
                Severity.WARNING,
                "background_clipped",
                f"{clipped:.0%} of the background's pixels are at 0 or 255 in a channel: their "
                "change cannot be read. Change the exposure",
            )
        )
    specks = speck_count(new_dust)
    if specks:
        remarks.append(
            Remark(
                Severity.WARNING,
                "new_dust",
                f"{specks} specks lie in the later frames and not in the background image: the gel "
                "has collected dust since. Clean it, or record a new background",
            )
        )
    crowded = [f.name for f in frames if f.seen_share < MIN_SEEN_SHARE]
    if crowded:
        remarks.append(
            Remark(
                Severity.WARNING,
                "little_untouched",
                f"{', '.join(crowded[:6])}: less than {MIN_SEEN_SHARE:.0%} of the frame looks like "
                "the background; left out",
            )
        )
    return tuple(remarks)
