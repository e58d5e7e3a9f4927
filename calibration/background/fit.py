# SPDX-License-Identifier: Apache-2.0
"""Fit of the background block to the frames of a capture folder, and what its light did."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from taccel_lab.calibration.background import remarks
from taccel_lab.calibration.background.options import BackgroundOptions
from taccel_lab.calibration.background.perturbation import spread_of_units
from taccel_lab.calibration.background.result import (
    BackgroundCalibration,
    FrameLight,
    dust_mask,
    speck_count,
)
from taccel_lab.calibration.background.untouched import (
    RunningMean,
    background_from_presses,
    untouched_pixels,
)
from taccel_lab.calibration.base_profile import require_image_of
from taccel_lab.calibration.capture.folder import CaptureFolder, source_of
from taccel_lab.calibration.check.background import check_background
from taccel_lab.calibration.light_drift import drift_remarks, drift_spread
from taccel_lab.calibration.remarks import TOO_FEW
from taccel_lab.errors import InputError
from taccel_lab.profile import SensorProfile
from taccel_lab.progress import Progress, silent
from taccel_lab.reading.light import LightDrift, fit_light, smoothed
from taccel_lab.report.remark import Remark, Severity

_COMPARED = "background of all frames"
"""Key of what is made once of a folder."""
CLIPPED_SHARE = 0.01
MIN_SEEN_SHARE = 0.15
"""A frame that shows less untouched gel than this is left out."""
GRAIN_SHARE = 1 / 40
"""What is smooth over more than this part of the shorter side is no grain."""
MIN_SEEN_FRAMES = 3
"""Frames that have to show a new speck."""


def calibrate_background(
    folder: CaptureFolder,
    base: SensorProfile,
    options: BackgroundOptions = BackgroundOptions(),
    progress: Progress = silent,
) -> BackgroundCalibration:
    """The untouched sensor from all the frames of ``folder``, in the light of its background.

    The background image and the other untouched images are brought to one light and averaged;
    presses beside their contacts add fine grain alone, held-out ones nothing. Without any untouched
    image the background is the median of the presses. Each frame is then compared with the mean of
    the others. ``base`` is what the result extends; of it only the kind of image counts. Raises
    InputError when there is nothing to make a background of, for raw images of a rectified
    profile, and for units that cannot be compared.
    """
    require_image_of(base, folder)
    units = spread_of_units(options.units) if options.units else None
    # Colours and normals are fitted against it, too.
    found = folder.once.of(_COMPARED, lambda: _of_frames(folder, progress))
    return found if units is None else replace(found, units=units)


def _of_frames(folder: CaptureFolder, progress: Progress) -> BackgroundCalibration:
    sources = _sources(folder)
    mask = folder.mask
    if mask is not None and mask.all():
        mask = None
    from_presses = all(source.kind == "press" for source in sources)
    if from_presses:
        reference = background_from_presses([source.read for source in sources], mask)
    else:
        reference = sources[0].read().astype(np.float32)
    running = RunningMean.empty(reference.shape)
    compared: list[_Compared] = []
    new = RunningMean.empty(reference.shape)
    for k, source in enumerate(sources):
        image, kind = source.read(), source.kind
        light = fit_light(image, reference, mask)
        seen = untouched_pixels(image, reference, light, mask)
        used = seen if seen.mean() >= MIN_SEEN_SHARE else np.zeros_like(seen)
        compared.append(_Compared(source, light, seen, used))
        steady = light.remove(image.astype(np.float64))
        if kind == "press" and not from_presses:
            running.add(reference + _grain(steady - reference, used), used)
        else:
            running.add(steady, used)
        if kind != "background":
            new.add(steady - reference, seen)
        progress("comparing the frames", k + 1, len(sources))
    average = running.mean(reference)
    if mask is not None:
        average[~mask] = reference[~mask]
    frames = tuple(_against_others(frame, running, reference) for frame in compared)
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
        mask=mask,
        remarks=(
            *_remarks(sources, frames, drifts, reference, new_dust, from_presses),
            *_against_presses(folder),
        ),
        inputs={source.name: source.sha256 for source in sources},
        source=source_of(folder.provenance, folder.source),
        mm_per_px=folder.mm_per_px,
        method=(
            "median of the untouched parts of the presses"
            if from_presses
            else "mean of the untouched images, with the fine grain of the presses beside their "
            "contacts"
        )
        + ", each frame's gain, offset and gradient of the light taken off",
    )


def _grain(difference: np.ndarray, used: np.ndarray) -> np.ndarray:
    """What a press adds to the background: its fine grain [levels], shape [h, w, 3].

    The gel sinks far beyond a contact, and its colours change smoothly there. So what is smooth of
    the background is that of untouched images alone, and no press moves it.
    """
    sigma = max(GRAIN_SHARE * min(used.shape), 1.0)
    return difference - smoothed(difference, used, sigma)


@dataclass(frozen=True)
class _Source:
    """An image of the folder that has not been read."""

    name: str
    kind: str
    sha256: str
    read: Callable[[], np.ndarray]


@dataclass(frozen=True)
class _Compared:
    """A frame against the reference."""

    source: _Source
    light: LightDrift
    seen: np.ndarray
    """Untouched pixels, bool, shape [height_px, width_px]."""
    used: np.ndarray
    """Pixels of ``seen`` that the average takes."""


def _sources(folder: CaptureFolder) -> list[_Source]:
    """Every frame, the background first."""
    sources: list[_Source] = []
    if folder.background is not None:
        frame = folder.background
        sources.append(_Source("background", "background", frame.sha256, frame.read))
    for i, frame in enumerate(folder.untouched):
        name = f"untouched_{i}_{frame.name}"
        sources.append(_Source(name, "untouched", frame.sha256, frame.read))
    presses = folder.fitted().presses if sources else folder.presses
    sources += [_Source(p.name, "press", p.sha256, p.read) for p in presses]
    if not sources:
        raise InputError(
            f"{folder.source} holds neither an untouched image nor presses; give background or "
            "untouched"
        )
    sizes = {source.read().shape[:2] for source in sources}
    if len(sizes) > 1:
        found = ", ".join(f"{w}x{h}" for h, w in sorted(sizes))
        raise InputError(f"{folder.source}: images of several sizes ({found} px); one is allowed")
    return sources


def _against_others(frame: _Compared, running: RunningMean, reference: np.ndarray) -> FrameLight:
    """The frame against the mean of the others alone."""
    light, seen, used = frame.light, frame.seen, frame.used
    image = frame.source.read().astype(np.float64)
    total = running.total - np.where(used[..., None], light.remove(image), 0.0)
    count = running.count - used
    others = np.where(count[..., None] > 0, total / np.maximum(count, 1)[..., None], reference)
    where = seen if seen.any() else np.ones_like(seen)
    return FrameLight(
        name=frame.source.name,
        kind=frame.source.kind,
        drift=light,
        seen_share=float(seen.mean()),
        plain_l1=float(np.abs(image - reference)[where].mean()),
        corrected_l1=float(np.abs(image - light.apply(others))[where].mean()),
    )


def _against_presses(folder: CaptureFolder) -> list[Remark]:
    """Errors when the background is framed otherwise than the presses, another one, or pressed."""
    if folder.background is None:
        return []
    found = check_background(folder).findings
    return [finding for finding in found if finding.severity is Severity.ERROR]


def _remarks(
    sources: Sequence[_Source],
    frames: tuple[FrameLight, ...],
    drifts: Sequence[LightDrift],
    reference: np.ndarray,
    new_dust: np.ndarray,
    from_presses: bool,
) -> tuple[Remark, ...]:
    found = []
    if from_presses:
        found.append(remarks.NO_UNTOUCHED_IMAGE(count=len(sources)))
    if len(sources) == 1:
        wanted = "neither noise nor drift can be told; give more as untouched"
        found.append(TOO_FEW(found="1 frame", wanted=wanted))
    if len(drifts) > 1:
        found += drift_remarks(drifts, reference)
    clipped = float(((reference <= 0.5) | (reference >= 254.5)).any(axis=-1).mean())
    if clipped > CLIPPED_SHARE:
        found.append(remarks.BACKGROUND_CLIPPED(clipped=clipped))
    specks = speck_count(new_dust)
    if specks:
        found.append(remarks.NEW_DUST(specks=specks))
    return tuple(found)
