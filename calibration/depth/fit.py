# SPDX-License-Identifier: Apache-2.0
"""Captures of a grey sensor to the profile block ``depth_response``.

What the depth is counted from has to be said. A ball's shape gives depths below the rim of the
contact; the rim itself lies below the untouched face, since the gel sinks around a ball, and by how
much no image tells. Presses of known travel settle it (``travel``). Without any, ``untouched``
counts from where the grey is that of untouched gel, so that the curve starts at zero without a
step; ``rim`` from the rim of the contact.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from taccel_lab.calibration.base_profile import (
    MEASURED,
    captures_on_pad,
    lost_blocks,
    measured_grid,
    on_grid,
    presses_on_camera,
    require_image_of,
    require_labels_and_view,
    with_measured_scale,
)
from taccel_lab.calibration.camera.rectification import RectificationMaps
from taccel_lab.calibration.capture.captures import (
    CapturedPress,
    CaptureSet,
    ContactCircle,
    widest_gap_px,
)
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.check.remarks import BALL_OR_DIAMETER
from taccel_lab.calibration.check.run import capture_findings, joined, refusing_with
from taccel_lab.calibration.circles.ball_surface import diameter_share, layer_of
from taccel_lab.calibration.circles.labels import choose_circles
from taccel_lab.calibration.circles.thickness import TOUCH_MM
from taccel_lab.calibration.circles.usable import usable_presses
from taccel_lab.calibration.depth.curve import (
    ContactPixels,
    contact_pixels,
    curve_spread_mm,
    depth_at_no_drop,
    fit_response,
    left_out_errors,
    reading_sigma_mm,
)
from taccel_lab.calibration.depth.options import DepthOptions
from taccel_lab.calibration.depth.result import DepthCalibration, PressFigures
from taccel_lab.calibration.remarks import (
    GREY_OR_COLOUR,
    HELDOUT_ERROR,
    LABELS_OFF,
    SCALE_NOT_MEASURED,
    TOO_FEW,
    warning,
)
from taccel_lab.errors import InputError
from taccel_lab.printable import counted
from taccel_lab.profile import SensorProfile
from taccel_lab.profile.assumed import scale_sigma
from taccel_lab.progress import Progress, silent
from taccel_lab.report.remark import Remark
from taccel_lab.signals.depth_response import DepthResponse, channel_of

BOOTSTRAPS = 40
TASK = "finding contacts and fitting the curve"
LABEL_OFF_SHARE, LABEL_OFF_PX = 0.18, 6.0
"""A label is off when its centre lies this part of its radius, and this far, from the dark patch:
the limits of the check of coloured captures."""
ONE_SPOT_RADII = 1.0
"""Presses are at one spot when no two centres are this many contact radii apart."""
POOR_CURVE, WRONG_CURVE = 0.15, 0.35
"""Left-out error over the mean depth, from which a curve is only usable, or weak. Presses of one
9DTact lie at 0.02 to 0.05, those of two different units under one curve at 0.1."""
COLOR_LEVELS = 8.0
"""Channels that differ by more inside the contacts, beside a quarter of the drop: colours."""
ZERO_UNSURE = warning(
    "zero_unsure",
    "depths are counted from {start}; all of them may be off alike by {zero:.2f} mm, and by what "
    "the rim itself has sunk. depth_mm of a press settles it",
)


def calibrate_depth(
    folder: CaptureFolder,
    base: SensorProfile,
    options: DepthOptions = DepthOptions(),
    progress: Progress = silent,
) -> DepthCalibration:
    """Fit the depth of a grey sensor to the ball presses of ``folder``, against its background.

    ``base`` is what the result extends: its camera gives the scale where it was measured, or where
    neither maps nor captures do.

    Raises:
        InputError: Captures that no curve can be fitted to, with what their check found.
    """
    if options.maps is None:
        require_labels_and_view(folder, base, "depth")
    captures, assumed = grey_captures(folder, base, options.maps)
    on_captures = on_grid(base, captures.grid, captures.provenance)
    findings = capture_findings(with_measured_scale(folder, base), "depth", progress)
    progress(TASK, 0, 1)
    with refusing_with(findings):
        share = scale_sigma(on_captures.camera)
        found = fit_depth(captures, options, assumed, scale_share=share)
    progress(TASK, 1, 1)
    lost = lost_blocks(base, on_captures)
    if any(finding.code == BALL_OR_DIAMETER.code for finding in findings):
        widest_mm = max(press.radius_px for press in found.presses) * captures.grid.mm_per_px_x
        share = diameter_share(widest_mm, captures.ball_radius_mm, layer_of(base))
        found = replace(found, ball_share=share)
    return replace(found, remarks=(*lost, *joined(findings, found.remarks)))


def grey_captures(
    folder: CaptureFolder, base: SensorProfile, maps: Path | None
) -> tuple[CaptureSet, list[Remark]]:
    """The presses, and what had to be assumed.

    The scale is that of the maps; else that of the profile's camera where it was measured on this
    unit and has images of this size; else that of the captures; else what the profile says.
    """
    remarks: list[Remark] = []
    if maps is not None:
        rectification = RectificationMaps.load(maps)
        grid = rectification.require_grid()
        captures = folder.ball_presses((grid.mm_per_px_x, grid.mm_per_px_y))
        raw = captures.grid.width_px, captures.grid.height_px
        rectification.require_raw_size(raw, folder.source)
        return _rectified(captures, rectification), remarks
    require_image_of(base, folder)
    if folder.mm_per_px is not None or measured_grid(folder, base) is not None:
        return presses_on_camera(folder, base)[0], remarks
    grid, kind = base.camera.grid(), base.camera.provenance.kind
    captures = folder.ball_presses((grid.mm_per_px_x, grid.mm_per_px_y))
    same = (captures.grid.width_px, captures.grid.height_px) == (grid.width_px, grid.height_px)
    if kind not in MEASURED:
        source = f"{grid.mm_per_px_x:.4g} mm/px of the profile ({kind})"
        remarks.append(SCALE_NOT_MEASURED(source=source))
    captures = replace(captures, grid=grid) if same else captures
    return captures_on_pad(captures, base), remarks


def _rectified(captures: CaptureSet, maps: RectificationMaps) -> CaptureSet:
    def press_of(press: CapturedPress) -> CapturedPress:
        if press.circle is not None:
            raise InputError(
                f"{press.source}: contact circles are those of raw images and do not fit "
                "--maps; leave them out, they are found"
            )
        return replace(press, read=lambda: maps.apply(press.image()))

    raw_size = captures.background.shape[:2]
    mask = maps.apply(captures.mask.astype(np.uint8)) > 0
    return replace(
        captures,
        background=maps.apply(captures.background),
        mask=mask & maps.inside(raw_size),
        grid=maps.require_grid(),
        presses=tuple(press_of(press) for press in captures.presses),
    )


def fit_depth(
    captures: CaptureSet,
    options: DepthOptions = DepthOptions(),
    remarks: Sequence[Remark] = (),
    *,
    scale_share: float = 0.0,
) -> DepthCalibration:
    """Fit the curve to ball presses at a known scale.

    Args:
        captures: Background and presses.
        options: What is read, and what depths are counted from.
        remarks: What is known already of the captures.
        scale_share: Standard deviation of the scale of the pixel grid, as a share of it.
    """
    background = channel_of(captures.background, options.channel)
    mask = None if captures.mask.all() else captures.mask
    if options.circles == "detected":
        unlabelled = (replace(press, circle=None) for press in captures.presses)
        captures = replace(captures, presses=tuple(unlabelled))
    captures, found, lost = usable_presses(captures, grey=options.channel)
    chosen = choose_circles(captures, found, "labels")
    off = [*lost, *label_remarks(captures, [contact.circle for contact in found])]
    contacts = [
        _Contact(
            press=press,
            circle=circle,
            sigma_px=contact.radius_sigma_px,
            ball_mm=press.radius_mm or captures.ball_radius_mm,
            radius_mm=circle.radius_px * captures.grid.mm_per_px_x,
            drop=background - channel_of(press.image(), options.channel),
        )
        for press, circle, contact in zip(captures.presses, chosen, found, strict=True)
    ]
    for one in contacts:
        if one.radius_mm >= one.ball_mm:
            raise InputError(
                f"{one.press.source}: the contact's radius of {one.radius_mm:.2f} mm is not below "
                f"the ball's of {one.ball_mm:g} mm; check the scale and the ball"
            )
    sunk = [0.0] * len(chosen)
    zeros = [sunk]
    by_travel = _rims_by_travel(contacts)
    zero = options.zero
    if zero == "auto":
        zero = "untouched" if by_travel is None else "travel"
    if zero == "travel":
        if by_travel is None:
            raise InputError(f"{captures.source}: zero travel needs depth_mm of a press")
        sunk = by_travel

    def pixels() -> tuple[ContactPixels, ...]:
        grid = captures.grid
        return tuple(
            contact_pixels(i, one.drop, background, one.circle, grid, one.ball_mm, rim, mask)
            for i, (one, rim) in enumerate(zip(contacts, sunk, strict=True))
        )

    parts = pixels()
    # Each press by itself: its rim is known no better than that of the others.
    by_grey = [rim - depth_at_no_drop(part) for rim, part in zip(sunk, parts, strict=True)]
    zeros.append(by_grey)
    if zero == "untouched":
        sunk = by_grey
        parts = pixels()
    try:
        response = fit_response(parts, options.channel)
    except InputError as fault:
        raise InputError("\n".join([str(fault), *(remark.message for remark in off)])) from None
    errors, left_out = left_out_errors(parts)
    spread = curve_spread_mm(parts, response, np.random.default_rng(options.seed), BOOTSTRAPS)
    all_errors = np.concatenate(errors)
    figures = tuple(
        _figures(part, response, one, rim)
        for part, one, rim in zip(parts, contacts, sunk, strict=True)
    )
    offset_mm = _offset_sigma_mm(contacts, captures.grid.mm_per_px_x)
    gap_mm = max(abs(float(np.mean(sunk) - np.mean(other))) for other in zeros)
    if zero == "travel":
        # The ball's lowest point is where the stage has it, whatever its circle.
        offset_mm, gap_mm = TOUCH_MM, 0.0
    result = DepthCalibration(
        response=DepthResponse(
            response.channel,
            response.drop_levels,
            response.depth_mm,
            reading_sigma_mm=reading_sigma_mm(errors),
            zero_sigma_mm=math.hypot(offset_mm, gap_mm),
            # A cap's depth grows with the square of its width.
            depth_share=2 * scale_share,
        ),
        spread_mm=spread,
        offset_sigma_mm=offset_mm,
        zero_gap_mm=gap_mm,
        left_out_mm=all_errors,
        left_out=left_out,
        presses=figures,
        parts=parts,
        zero=zero,
        captures=captures,
    )
    found_remarks = (
        *remarks,
        *off,
        *place_remarks(chosen),
        *error_remarks(all_errors, np.concatenate([part.depth_mm for part in parts]), left_out),
        *curve_remarks(result, [one.drop for one in contacts]),
    )
    return replace(result, remarks=found_remarks)


@dataclass(frozen=True)
class _Contact:
    """A press in its circle."""

    press: CapturedPress
    circle: ContactCircle
    sigma_px: float
    """Standard deviation of the circle's radius."""
    ball_mm: float
    radius_mm: float
    """Radius of the circle."""
    drop: np.ndarray
    """How far the channel darkens [levels], shape [height_px, width_px]."""

    @property
    def plane_mm(self) -> float:
        """Distance of the circle's plane from the ball's centre."""
        return math.sqrt(self.ball_mm**2 - self.radius_mm**2)


def _rims_by_travel(contacts: Sequence[_Contact]) -> list[float] | None:
    """How deep each contact's rim lies below the untouched face [mm]: what the press's travel says
    beyond the ball's cap, for presses without travel the mean of the others; None without any."""
    rims = [
        one.press.depth_mm - (one.ball_mm - one.plane_mm) if one.press.depth_mm else None
        for one in contacts
    ]
    known = [rim for rim in rims if rim is not None]
    if not known:
        return None
    return [float(np.mean(known)) if rim is None else rim for rim in rims]


def _figures(
    part: ContactPixels, response: DepthResponse, contact: _Contact, rim_mm: float
) -> PressFigures:
    circle = contact.circle
    left = response.depth_of(part.drop_levels) - part.depth_mm
    x = (part.u_px - circle.u_px) / circle.radius_px
    y = (part.v_px - circle.v_px) / circle.radius_px
    plane, *_ = np.linalg.lstsq(np.stack([x, y, np.ones_like(x)], axis=1), left, rcond=None)
    return PressFigures(
        name=contact.press.name,
        u_px=circle.u_px,
        v_px=circle.v_px,
        radius_px=circle.radius_px,
        radius_sigma_px=contact.sigma_px,
        given=contact.press.circle is not None,
        rim_depth_mm=rim_mm,
        depth_mm=contact.ball_mm - contact.plane_mm + rim_mm,
        mae_mm=float(np.abs(left).mean()),
        bias_mm=float(left.mean()),
        plane_mm=float(2 * np.hypot(plane[0], plane[1])),
    )


def _offset_sigma_mm(contacts: Sequence[_Contact], mm_per_px: float) -> float:
    """Uncertain radius times the ball's slope at the rim, averaged over the presses."""
    each = [one.sigma_px * mm_per_px * one.radius_mm / one.plane_mm for one in contacts]
    return float(np.sqrt(np.mean(np.square(each)) / len(each)))


def label_remarks(captures: CaptureSet, found: Sequence[ContactCircle]) -> list[Remark]:
    """Whether given circles lie on the dark patches of their images."""
    gaps = {
        press.name: seen.center_gap_px(press.circle, captures.grid)
        for press, seen in zip(captures.presses, found, strict=True)
        if press.circle is not None
    }
    radii = {press.name: press.circle.radius_px for press in captures.presses if press.circle}
    off = [n for n, gap in gaps.items() if gap > max(LABEL_OFF_PX, LABEL_OFF_SHARE * radii[n])]
    if not off:
        return []
    off.sort(key=lambda name: -gaps[name])
    worst = ", ".join(f"{name} by {gaps[name]:.0f} px" for name in off[:4])
    advice = "Calibrate with the circles found (--circles detected), or correct them"
    figures = {"wrong": len(off), "count": len(gaps), "how": worst, "advice": advice}
    return [LABELS_OFF(labels="given circles", grave=True, **figures)]


def place_remarks(circles: Sequence[ContactCircle]) -> list[Remark]:
    """Whether all presses are at one place."""
    reach = widest_gap_px(circles)
    if len(circles) > 1 and reach < ONE_SPOT_RADII * float(
        np.median([c.radius_px for c in circles])
    ):
        wanted = f"all lie within {reach:.0f} px; press in the middle and near the borders"
        return [TOO_FEW(found=f"{len(circles)} presses at one spot", wanted=wanted)]
    return []


def error_remarks(left_out_mm: np.ndarray, depth_mm: np.ndarray, left_out: str) -> list[Remark]:
    """Whether left-out pixels lie far from the curve, for the depths that there are."""
    share = float(left_out_mm.mean() / max(float(depth_mm.mean()), 1e-9))
    if share <= POOR_CURVE:
        return []
    error = f"{left_out_mm.mean():.3f} mm, {share:.0%} of the mean depth"
    advice = "check circles, balls, and that all presses are of one sensor under one light"
    what = f"pixels of a {left_out}"
    return [HELDOUT_ERROR(what=what, error=error, advice=advice, grave=share > WRONG_CURVE)]


def curve_remarks(result: DepthCalibration, drops: Sequence[np.ndarray]) -> list[Remark]:
    """Remarks on the curve and the images; ``drops`` are the presses' grey drops [levels]."""
    found: list[Remark] = []
    if len(result.presses) < 3:
        wanted = "give three or more, one in the middle and others near the borders"
        found.append(TOO_FEW(found=counted(len(result.presses), "press", "presses"), wanted=wanted))
    sigma, zero = result.offset_sigma_mm, result.zero_sigma_mm
    depth = float(np.concatenate([part.depth_mm for part in result.parts]).mean())
    if zero > POOR_CURVE * depth and result.zero in ("untouched", "rim"):
        rim = f"the contact's rim, which is known to {sigma:.2f} mm"
        start = rim if result.zero == "rim" else "where the grey is that of untouched gel"
        found.append(ZERO_UNSURE(start=start, zero=zero))
    background = result.captures.background
    colors = [
        np.abs(np.ptp(background - p.image().astype(np.float64), axis=-1))[d > d.max() / 2]
        for p, d in zip(result.captures.presses, drops, strict=True)
    ]
    spread = float(np.mean([c.mean() for c in colors]))
    if spread > COLOR_LEVELS + 0.25 * max(float(d.max()) for d in drops):
        coloured = f"coloured (channels differ by {spread:.0f} levels in the contacts)"
        found.append(GREY_OR_COLOUR(found=coloured, expected="grey", grave=True))
    return found
