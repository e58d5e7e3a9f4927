# SPDX-License-Identifier: Apache-2.0
"""Captures of a grey sensor to the profile block ``depth_response``.

What the depth is counted from has to be said. A ball's shape gives depths below the rim of the
contact; the rim itself lies below the untouched face, since the gel sinks around a ball, and by how
much no image tells. ``untouched`` counts from where the grey is that of untouched gel, so that the
curve starts at zero without a step; ``rim`` from the rim of the contact; ``hertz`` and
``simulated`` add the sinking of an elastic half-space or of the designed gel to that.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from taccel_lab.calibration.capture.captures import CaptureSet, ContactCircle
from taccel_lab.calibration.depth.contradictions import error_remarks, label_remarks, repeat_remarks
from taccel_lab.calibration.depth.depth_fit import (
    ContactPixels,
    contact_pixels,
    curve_spread_mm,
    depth_at_no_drop,
    fit_response,
    left_out_errors,
)
from taccel_lab.calibration.depth.grey_contact import find_grey_contact
from taccel_lab.calibration.result import Remark, Severity, judge
from taccel_lab.calibration.surfaces.press_surface import PressSurface
from taccel_lab.errors import InputError
from taccel_lab.profile import BackgroundBlock, DepthResponseBlock, Provenance, SensorProfile
from taccel_lab.signals.depth_response import Channel, DepthResponse, channel_of

Zero = Literal["untouched", "rim", "hertz", "simulated"]
BOOTSTRAPS = 40
COLOR_LEVELS = 8.0
SATURATED_LEVEL = 3.0
CLEAR_R2 = 0.25


@dataclass(frozen=True)
class PressFigures:
    """One press against the curve."""

    name: str
    u_px: float
    v_px: float
    radius_px: float
    radius_sigma_px: float
    given: bool
    """Whether the circle was given with the press."""
    rim_depth_mm: float
    """Depth of the contact's rim below the zero; negative where the zero lies deeper."""
    depth_mm: float
    """Of the ball's lowest point below the untouched face."""
    mae_mm: float
    bias_mm: float
    plane_mm: float
    """Rise of the residuals' plane across the contact: a wrong centre, a tilt, or uneven light."""


@dataclass(frozen=True)
class DepthCalibration:
    """Result of ``calibrate_depth``."""

    response: DepthResponse
    spread_mm: np.ndarray
    """Standard deviation of the curve at its drops."""
    offset_sigma_mm: float
    """Standard deviation of its zero: what the uncertain rim makes of it."""
    left_out_mm: np.ndarray
    left_out: str
    presses: tuple[PressFigures, ...]
    parts: tuple[ContactPixels, ...]
    light_r2: float
    """Share of the residuals' variance that the level of the untouched pixel explains."""
    normalised_mae_mm: float
    """Left-out error when drops are divided by the untouched level first."""
    zero: Zero
    background: np.ndarray
    inputs: dict[str, str]
    source: str
    remarks: tuple[Remark, ...] = ()

    def figures(self) -> dict[str, Any]:
        """Everything measured, ready for JSON."""
        return {
            "verdict": judge(self.remarks),
            "remarks": [str(remark) for remark in self.remarks],
            "channel": self.response.channel,
            "zero": self.zero,
            "left_out_mae_mm": float(self.left_out_mm.mean()),
            "left_out_p90_mm": float(np.percentile(self.left_out_mm, 90)),
            "left_out": self.left_out,
            "normalised_mae_mm": self.normalised_mae_mm,
            "light_r2": self.light_r2,
            "curve_sigma_mm": float(self.spread_mm[1:].mean()),
            "offset_sigma_mm": self.offset_sigma_mm,
            "presses": [asdict(p) for p in sorted(self.presses, key=lambda p: -p.mae_mm)],
            "drop_levels": self.response.drop_levels.tolist(),
            "depth_mm": self.response.depth_mm.tolist(),
        }

    def apply_to(self, profile: SensorProfile) -> SensorProfile:
        """``profile`` with the block depth_response, and a background where it has none."""
        if profile.background is None:
            measured = Provenance(
                kind="measured",
                method="captured background",
                source=self.source,
                inputs={"background": self.inputs["background"]},
            )
            profile = profile.with_block(BackgroundBlock(provenance=measured), self.background)
        response = self.response
        return profile.with_block(
            DepthResponseBlock(
                channel=response.channel,
                drop_levels=tuple(float(x) for x in response.drop_levels),
                depth_mm=tuple(float(x) for x in response.depth_mm),
                provenance=Provenance(
                    kind="calibrated",
                    method=(
                        f"isotonic regression of depth on grey drop inside {len(self.presses)} "
                        f"ball contacts; depth zero: {self.zero}"
                    ),
                    source=self.source,
                    inputs=self.inputs,
                    residuals={
                        "left_out_depth_mm": float(self.left_out_mm.mean()),
                        "left_out_p90_depth_mm": float(np.percentile(self.left_out_mm, 90)),
                    },
                    spread={
                        "curve_mm": float(self.spread_mm[1:].mean()),
                        "zero_mm": self.offset_sigma_mm,
                    },
                    valid_region={
                        "drop_levels": (
                            float(response.drop_levels[1]),
                            float(response.drop_levels[-1]),
                        ),
                        "depth_mm": (float(response.depth_mm[1]), float(response.depth_mm[-1])),
                    },
                    verdict=judge(self.remarks).value,
                    remarks=tuple(str(remark) for remark in self.remarks),
                ),
            )
        )


def calibrate_depth(
    captures: CaptureSet,
    *,
    channel: Channel = "grey",
    zero: Zero = "untouched",
    surface_of: Callable[[Sequence[ContactCircle]], Sequence[PressSurface]] | None = None,
    circles: Literal["auto", "detected"] = "auto",
    seed: int = 0,
    remarks: Sequence[Remark] = (),
) -> DepthCalibration:
    """Fit the depth of a grey sensor to ball presses.

    Args:
        channel: Channel whose drop is read.
        zero: What depths are counted from, see the module.
        surface_of: Gives the surfaces of the presses for ``hertz`` and ``simulated``.
        circles: ``auto`` takes the circles that are given, and finds the others.
        seed: Of the resampling.
        remarks: What is known already of the captures.
    """
    background = channel_of(captures.background, channel)
    mask = None if captures.mask.all() else captures.mask
    drops, contacts, given, seen = [], [], [], []
    for press in captures.presses:
        drop = background - channel_of(press.image(), channel)
        found = find_grey_contact(drop, captures.grid, mask=mask, name=press.source)
        drops.append(drop)
        seen.append(found.circle)
        given.append(press.circle is not None and circles == "auto")
        contacts.append((press.circle if given[-1] else found.circle, found.radius_sigma_px))
    chosen = [circle for circle, _ in contacts if circle is not None]
    labels = [
        press.circle if flag else None for press, flag in zip(captures.presses, given, strict=True)
    ]
    off = label_remarks(captures, labels, seen)
    radii = [press.radius_mm or captures.ball_radius_mm for press in captures.presses]
    for press, circle, radius in zip(captures.presses, chosen, radii, strict=True):
        if circle.radius_px * captures.grid.mm_per_px_x >= radius:
            raise InputError(
                f"{press.source}: the contact's radius of "
                f"{circle.radius_px * captures.grid.mm_per_px_x:.2f} mm is not below the ball's of "
                f"{radius:g} mm; check the scale and the ball"
            )
    sunk = [0.0] * len(chosen)
    if zero in ("hertz", "simulated"):
        if surface_of is None:
            raise InputError(f"zero {zero!r} needs the surfaces of the presses")
        sunk = [
            _rim_depth_mm(surface, circle, captures)
            for surface, circle in zip(surface_of(chosen), chosen, strict=True)
        ]

    def pixels() -> tuple[ContactPixels, ...]:
        return tuple(
            contact_pixels(i, drop, background, circle, captures.grid, radius, rim, mask)
            for i, (drop, circle, radius, rim) in enumerate(
                zip(drops, chosen, radii, sunk, strict=True)
            )
        )

    parts = pixels()
    if zero == "untouched":
        # Each press by itself: its rim is known no better than that of the others.
        sunk = [-depth_at_no_drop(part) for part in parts]
        parts = pixels()
    try:
        response = fit_response(parts, channel)
    except InputError as fault:
        raise InputError("\n".join([str(fault), *(remark.message for remark in off)])) from None
    errors, left_out = left_out_errors(parts)
    spread = curve_spread_mm(parts, response, np.random.default_rng(seed), BOOTSTRAPS)
    level = float(np.median(background))
    normalised, _ = left_out_errors([_normalised(part, level) for part in parts])
    sigma_px = [sigma for _, sigma in contacts]
    presses = tuple(
        _figures(part, response, captures, circle, sigma, flag, radius, rim)
        for part, circle, sigma, flag, radius, rim in zip(
            parts, chosen, sigma_px, given, radii, sunk, strict=True
        )
    )
    result = DepthCalibration(
        response=response,
        spread_mm=spread,
        offset_sigma_mm=_offset_sigma_mm(chosen, sigma_px, radii, captures),
        left_out_mm=errors,
        left_out=left_out,
        presses=presses,
        parts=parts,
        light_r2=_light_r2(parts, response),
        normalised_mae_mm=float(normalised.mean()),
        zero=zero,
        background=captures.background,
        inputs=captures.hashes(),
        source=captures.provenance.get("source", captures.source),
    )
    found_remarks = (
        *remarks,
        *off,
        *repeat_remarks(captures, chosen),
        *error_remarks(errors, np.concatenate([part.depth_mm for part in parts]), left_out),
        *_remarks(result, captures, drops),
    )
    return DepthCalibration(**{**vars(result), "remarks": found_remarks})


def _rim_depth_mm(surface: PressSurface, circle: ContactCircle, captures: CaptureSet) -> float:
    band = np.abs(circle.distance_px(captures.grid) / circle.radius_px - 1) < 0.04
    return max(0.0, float(-surface.displacement_mm()[band].mean()))


def _normalised(part: ContactPixels, level: float) -> ContactPixels:
    scaled = part.drop_levels * level / np.maximum(part.background, 1.0)
    return ContactPixels(**{**vars(part), "drop_levels": scaled})


def _figures(
    part: ContactPixels,
    response: DepthResponse,
    captures: CaptureSet,
    circle: ContactCircle,
    sigma_px: float,
    given: bool,
    ball_radius_mm: float,
    rim_mm: float,
) -> PressFigures:
    left = response.depth_of(part.drop_levels) - part.depth_mm
    x = (part.u_px - circle.u_px) / circle.radius_px
    y = (part.v_px - circle.v_px) / circle.radius_px
    plane, *_ = np.linalg.lstsq(np.stack([x, y, np.ones_like(x)], axis=1), left, rcond=None)
    rim = circle.radius_px * captures.grid.mm_per_px_x
    return PressFigures(
        name=captures.presses[part.press].name,
        u_px=circle.u_px,
        v_px=circle.v_px,
        radius_px=circle.radius_px,
        radius_sigma_px=sigma_px,
        given=given,
        rim_depth_mm=rim_mm,
        depth_mm=ball_radius_mm - math.sqrt(ball_radius_mm**2 - rim**2) + rim_mm,
        mae_mm=float(np.abs(left).mean()),
        bias_mm=float(left.mean()),
        plane_mm=float(2 * np.hypot(plane[0], plane[1])),
    )


def _offset_sigma_mm(
    circles: Sequence[ContactCircle],
    sigma_px: Sequence[float],
    radii_mm: Sequence[float],
    captures: CaptureSet,
) -> float:
    """Uncertain radius times the ball's slope at the rim, averaged over the presses."""
    scale = captures.grid.mm_per_px_x
    each = []
    for circle, sigma, ball in zip(circles, sigma_px, radii_mm, strict=True):
        rim = circle.radius_px * scale
        each.append(sigma * scale * rim / math.sqrt(ball**2 - rim**2))
    return float(np.sqrt(np.mean(np.square(each)) / len(each)))


def _light_r2(parts: Sequence[ContactPixels], response: DepthResponse) -> float:
    left = np.concatenate([response.depth_of(p.drop_levels) - p.depth_mm for p in parts])
    level = np.concatenate([p.background for p in parts])
    if level.std() < 1e-9 or left.std() < 1e-12:
        return 0.0
    return float(np.corrcoef(left, level)[0, 1] ** 2)


def _remarks(
    result: DepthCalibration, captures: CaptureSet, drops: Sequence[np.ndarray]
) -> list[Remark]:
    found: list[Remark] = []
    if len(result.presses) < 3:
        found.append(
            Remark(
                Severity.WARNING,
                "few_presses",
                f"{len(result.presses)} press; nothing says how the curve holds elsewhere on the "
                "gel. Give three or more, one in the middle and others near the borders",
            )
        )
    if result.zero == "untouched":
        rims = [press.rim_depth_mm for press in result.presses]
        found.append(
            Remark(
                Severity.INFO,
                "zero_at_no_drop",
                "depths are counted from where the grey is that of untouched gel, "
                f"{-np.mean(rims):.2f} mm below the rim that is seen; counted from the rim they "
                f"would be that much larger, and the rim is known to {result.offset_sigma_mm:.2f} "
                "mm. A press of known travel would settle it",
            )
        )
    if result.zero == "rim":
        found.append(
            Remark(
                Severity.INFO,
                "zero_at_rim",
                "depths are counted from the contact's rim; the rim itself lies deeper than the "
                f"untouched face. The rim is known to {result.offset_sigma_mm:.2f} mm of depth",
            )
        )
    worst = max(result.presses, key=lambda p: p.plane_mm)
    if worst.plane_mm > max(0.15 * worst.depth_mm, 0.05):
        found.append(
            Remark(
                Severity.WARNING,
                "tilted_residual",
                f"{worst.name}: depths by grey tilt against the ball by {worst.plane_mm:.2f} mm "
                "across the contact: its centre is off, or the light is uneven",
            )
        )
    share = np.mean([np.mean(d < -SATURATED_LEVEL) for d in drops])
    if share > 0.05:
        deepest = -min(float(np.percentile(d, 0.5)) for d in drops)
        found.append(
            Remark(
                Severity.INFO,
                "brightens",
                f"{share:.0%} of the pixels brighten, by up to {deepest:.0f} levels, beside the "
                "contacts: the slope of the gel throws light back. Such pixels read as untouched, "
                "and the rim of a contact reads too shallow",
            )
        )
    if result.light_r2 > CLEAR_R2 and result.normalised_mae_mm < 0.9 * result.left_out_mm.mean():
        found.append(
            Remark(
                Severity.WARNING,
                "uneven_light",
                f"the light explains {result.light_r2:.0%} of what the curve leaves over; dividing "
                f"by the background would leave {result.normalised_mae_mm:.3f} mm instead of "
                f"{result.left_out_mm.mean():.3f} mm",
            )
        )
    colors = [
        np.abs(np.ptp(captures.background - p.image().astype(np.float64), axis=-1))[d > d.max() / 2]
        for p, d in zip(captures.presses, drops, strict=True)
    ]
    spread = float(np.mean([c.mean() for c in colors]))
    if spread > COLOR_LEVELS + 0.25 * max(float(d.max()) for d in drops):
        found.append(
            Remark(
                Severity.ERROR,
                "coloured",
                f"the channels differ by {spread:.0f} levels inside the contacts: this looks like "
                "a colour sensor, whose colours tell slopes; use taccel-lab calibrate normals",
            )
        )
    return found
