# SPDX-License-Identifier: Apache-2.0
"""Findings about contacts: none there, blurred, at one spot, all alike, against their labels"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from taccel_lab.calibration.capture.captures import ContactCircle, check_place, widest_gap_px
from taccel_lab.calibration.capture.coverage import CELLS, coverage_map, empty_cells
from taccel_lab.calibration.check import remarks
from taccel_lab.calibration.check.frames import FrameFigures
from taccel_lab.calibration.circles.labels import DetectedContact, circle_array
from taccel_lab.calibration.circles.usable import too_many_lost
from taccel_lab.calibration.remarks import LABELS_OFF, TOO_FEW, name_some
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.printable import counted
from taccel_lab.report.remark import Remark

LABEL_OFF_SHARE, LABEL_RADIUS_SHARE = 0.18, 0.3
"""A label is off when its centre lies this part of its radius (and ``LABEL_OFF_PX``) from the
contact found, or its radius differs by that part. Careful labels: 0.05 to 0.1 on real sets."""
LABEL_OFF_PX = 6.0
SURE_OF_CONTACT = 0.4
"""Share of a contact that is explained and seen below which it says nothing against a label."""
LABELS_BAD_SHARE = 0.25
OTHER_SIZE = 1.1
MIN_SCALED = 4
"""Labels from which on a common factor between them and the contacts is looked for."""
MIN_SHIFTED = 4
"""Labels from which on a shift that they share stands apart from that of a single label."""
FEW_PRESSES = 10
ONE_SPOT_RADII = 2.0
"""Presses are at one spot when their centres lie within this many contact radii."""
GOOD_COVERAGE = 0.5
SAME_DEPTH = 0.12
BLUR_TEXTURE, BLUR_RIM, BLUR_RIM_WITHOUT_TEXTURE = 0.5, 1.8, 1.3
"""Share of the usual texture, and multiples of the usual width of the rim."""
USEFUL_TEXTURE = 0.25
"""Correlation of fine structure above which a lack of it means blur."""
NO_TEXTURE, SEEN_TEXTURE = 0.15, 0.08
"""Share of the usual texture below which a press is blurred whatever its rim, and correlation that
shows the texture at all. Chosen on three sets, where good presses have 0.3 of it and more and
blurred ones 0.08 at most; the other three are counted with it."""
NEAR_DUPLICATE = 0.1
"""Images are the same press when they differ by less than this part of the contact's contrast."""
MIN_DUPLICATE_LEVELS = 1.5


def check_contacts(frames: Sequence[FrameFigures], grid: PixelGrid) -> list[Remark]:
    """All findings of this module on presses of one ball."""
    return [
        *_check_whole(frames),
        *_check_found(frames),
        *_check_places(frames, grid),
        *_check_labels(frames, grid),
        *_check_spots(frames, grid),
        *_check_count(frames),
        *_check_depths(frames),
        *_check_blur(frames),
        *_check_duplicates(frames),
    ]


def _check_whole(frames: Sequence[FrameFigures]) -> list[Remark]:
    broken = [frame for frame in frames if frame.broken]
    return [remarks.NOT_WHOLE(**_lost(frames, broken))] if broken else []


def _check_found(frames: Sequence[FrameFigures]) -> list[Remark]:
    lost = [frame for frame in frames if frame.contact is None and not frame.broken]
    if not lost:
        return []
    cut = sum(frame.cut for frame in lost)
    border = f" In {cut} of them the border of the image cuts it." if cut else ""
    return [remarks.NO_CONTACT(border=border, **_lost(frames, lost))]


def _lost(frames: Sequence[FrameFigures], lost: Sequence[FrameFigures]) -> dict[str, Any]:
    """Figures of a remark on frames that no fit can use."""
    names = [frame.press.name for frame in lost]
    return {
        "lost": len(lost),
        "count": len(frames),
        "names": name_some(names),
        "first": names[0],
        "reason": lost[0].fault,
        "frames": names,
        "grave": too_many_lost(len(frames), [frame.cut for frame in lost]),
    }


@dataclass(frozen=True)
class LabelGap:
    """How far a label is from the contact that was found [px]."""

    name: str
    center_px: float
    radius_px: float
    """Found less labelled."""
    off: bool
    rejected: bool
    """Off from where the labels' common shift puts it, too: the press alone is labelled wrongly."""


def label_gaps(frames: Sequence[FrameFigures], grid: PixelGrid) -> list[LabelGap]:
    """Gaps of every press that has both a label that can be one and a contact found."""
    wrong = _misplaced(frames, grid)
    pairs = [
        (frame.press.name, frame.contact, frame.press.circle)
        for frame in frames
        if frame.contact is not None
        and frame.press.circle is not None
        and frame.press.name not in wrong
    ]
    if not pairs:
        return []
    found = circle_array([contact.circle for _, contact, _ in pairs])
    apart = found - circle_array([label for *_, label in pairs])
    common = np.median(apart, axis=0) if len(pairs) >= MIN_SHIFTED else np.zeros(3)
    return [
        LabelGap(
            name,
            contact.circle.center_gap_px(label, grid),
            float(gap[2]),
            off := _is_off(gap, contact, label, grid),
            off and _is_off(gap - common, contact, label, grid),
        )
        for (name, contact, label), gap in zip(pairs, apart, strict=True)
    ]


def _is_off(
    gap: np.ndarray, contact: DetectedContact, label: ContactCircle, grid: PixelGrid
) -> bool:
    """Whether ``gap``, found less labelled u, v and radius [px], is more than careful labels are
    off by; what the detector itself is unsure of is not held against the label."""
    if contact.explained * contact.visible < SURE_OF_CONTACT:
        return False
    center = float(np.hypot(gap[0], gap[1] * grid.mm_per_px_y / grid.mm_per_px_x))
    limit = max(LABEL_OFF_PX, LABEL_OFF_SHARE * label.radius_px) + 2 * contact.center_sigma_px
    smaller = min(label.radius_px, contact.circle.radius_px)
    widest = LABEL_RADIUS_SHARE * smaller + 2 * contact.radius_sigma_px
    return center > limit or abs(float(gap[2])) > widest


def rejected_labels(frames: Sequence[FrameFigures], grid: PixelGrid) -> frozenset[str]:
    """Presses whose labels their images reject: the contact is elsewhere, or nothing touches. A
    circle that a person has corrected is never among them."""
    off = {gap.name for gap in label_gaps(frames, grid) if gap.rejected}
    return frozenset(
        frame.press.name
        for frame in frames
        if frame.press.circle is not None
        and not frame.press.checked
        and (frame.press.name in off or frame.untouched)
    )


def _misplaced(frames: Sequence[FrameFigures], grid: PixelGrid) -> dict[str, str]:
    """Labels that can be of no press, outside of the image or too small: why, by the press."""
    wrong = {}
    for frame in frames:
        if frame.press.circle is None:
            continue
        try:
            check_place(frame.press.circle, grid, frame.press.name)
        except InputError as error:
            wrong[frame.press.name] = str(error)
    return wrong


def _check_places(frames: Sequence[FrameFigures], grid: PixelGrid) -> list[Remark]:
    wrong = _misplaced(frames, grid)
    if not wrong:
        return []
    count = sum(frame.press.circle is not None for frame in frames)
    figures = {"wrong": len(wrong), "count": count, "advice": "Correct them"}
    how = f"they can be of no press, {next(iter(wrong.values()))}"
    blocks = ("color", "normals", "depth")
    return [
        LABELS_OFF(
            labels="labelled circles", how=how, frames=list(wrong), blocks=blocks, grave=True,
            **figures,
        )
    ]  # fmt: skip


def _check_labels(frames: Sequence[FrameFigures], grid: PixelGrid) -> list[Remark]:
    gaps = label_gaps(frames, grid)
    off = sorted((gap for gap in gaps if gap.off), key=lambda gap: -gap.center_px)
    if not off:
        return []
    centers = np.array([gap.center_px for gap in gaps])
    names = [gap.name for gap in off]
    many = len(off) > LABELS_BAD_SHARE * len(gaps)
    worst_radius = max((gap.radius_px for gap in off), key=abs)
    detected = "Calibrate with the circles found (taccel-lab calibrate color --circles detected)"
    advice = f"{detected}, or take contact out of captures.toml" if many else "Look at them"
    if many and (scale := _label_scale(frames, grid)) is not None:
        width, height = grid.width_px * scale, grid.height_px * scale
        advice = (
            f"They fit when they are divided by {scale:.2f}: were they made in images of "
            f"{width:.0f}x{height:.0f} px? {advice}"
        )
    how = (
        f"centres by up to {centers.max():.0f} px (median {np.median(centers):.1f} px), radii by "
        f"up to {abs(worst_radius):.0f} px; {name_some(names)}"
    )
    return [
        LABELS_OFF(
            wrong=len(off), count=len(gaps), labels="labelled circles", how=how, advice=advice,
            frames=names, blocks=remarks.BY_COLOR, grave=many,
        )
    ]  # fmt: skip


def _label_scale(frames: Sequence[FrameFigures], grid: PixelGrid) -> float | None:
    """Factor by which all labels are larger than the contacts found, as those made in images of
    another size are; None where none brings most of them together."""
    ratios, pairs = [], []
    for frame in frames:
        if frame.contact is None or frame.press.circle is None:
            continue
        label, found = frame.press.circle, frame.contact.circle
        pairs.append((label, found))
        ratios.append(np.hypot(label.u_px, label.v_px) / np.hypot(found.u_px, found.v_px))
    if len(pairs) < MIN_SCALED:
        return None
    scale = float(np.median(ratios))
    scaled = [
        ContactCircle(label.u_px / scale, label.v_px / scale, label.radius_px / scale)
        for label, _ in pairs
    ]
    fit = [
        label.center_gap_px(found, grid) <= max(LABEL_OFF_PX, LABEL_OFF_SHARE * found.radius_px)
        and abs(label.radius_px - found.radius_px) <= LABEL_RADIUS_SHARE * found.radius_px
        for label, (_, found) in zip(scaled, pairs, strict=True)
    ]
    other = abs(np.log(scale)) > np.log(OTHER_SIZE)
    return scale if other and np.mean(fit) > 1.0 - LABELS_BAD_SHARE else None


def found_circles(frames: Sequence[FrameFigures]) -> list[ContactCircle]:
    return [frame.circle for frame in frames if frame.circle is not None]


def _check_spots(frames: Sequence[FrameFigures], grid: PixelGrid) -> list[Remark]:
    circles = found_circles(frames)
    if len(circles) < 3:
        return []
    reach = widest_gap_px(circles)
    radius = float(np.median([c.radius_px for c in circles]))
    covered = float((coverage_map(circles, grid) > 0).mean())
    spread = max(radius, 0.05 * min(grid.width_px, grid.height_px))
    if reach < ONE_SPOT_RADII * spread:
        return [remarks.ONE_SPOT(count=len(circles), reach=reach, covered=covered)]
    cells = empty_cells(circles, grid)
    if covered < GOOD_COVERAGE or len(cells) > 3:
        return [
            remarks.COVERAGE(
                covered=covered,
                empty=len(cells),
                parts=CELLS[0] * CELLS[1],
                names=f" ({name_some(cells)})" if cells else "",
            )
        ]
    return []


def _check_count(frames: Sequence[FrameFigures]) -> list[Remark]:
    if len(frames) >= FEW_PRESSES:
        return []
    wanted = "30 to 50 leave enough to hold some out and still cover the gel"
    found = counted(len(frames), "press", "presses")
    return [TOO_FEW(found=found, wanted=wanted, blocks=remarks.BY_COLOR)]


def _check_depths(frames: Sequence[FrameFigures]) -> list[Remark]:
    radii = np.array([circle.radius_px for circle in found_circles(frames)])
    if len(radii) < 5 or np.ptp(np.percentile(radii, [5, 95])) > SAME_DEPTH * np.median(radii):
        return []
    return [remarks.SAME_DEPTH(smallest=radii.min(), largest=radii.max())]


def _check_blur(frames: Sequence[FrameFigures]) -> list[Remark]:
    if len(frames) < 4:
        return []
    texture = np.array([frame.texture for frame in frames])
    seen = np.isfinite(texture)
    rims = np.array([frame.rim_px for frame in frames])
    known = np.isfinite(rims)
    if known.sum() < 4:
        return []
    wide = rims / np.nanmedian(rims)
    blurred = known & (wide > BLUR_RIM)
    correlation = np.median([frame.texture_correlation for frame in frames])
    if correlation > SEEN_TEXTURE and seen.sum() >= 4:
        blurred |= seen & known & (texture < NO_TEXTURE * np.nanmedian(texture))
    if correlation > USEFUL_TEXTURE and seen.sum() >= 4:
        # A part of it would not do alone: shear under the ball moves it.
        gone = seen & (texture < BLUR_TEXTURE * np.nanmedian(texture))
        blurred |= gone & known & (wide > BLUR_RIM_WITHOUT_TEXTURE)
    if not blurred.any():
        return []
    names = [frame.press.name for frame, bad in zip(frames, blurred, strict=True) if bad]
    return [
        remarks.BLURRED(blurred=len(names), count=len(frames), names=name_some(names), frames=names)
    ]


def _check_duplicates(frames: Sequence[FrameFigures]) -> list[Remark]:
    same: dict[str, list[str]] = {}
    for frame in frames:
        same.setdefault(frame.press.sha256, []).append(frame.press.name)
    groups = [names for names in same.values() if len(names) > 1]
    groups += [list(pair) for pair in _near_duplicates(frames)]
    if not groups:
        return []
    names = sorted({name for group in groups for name in group})
    some = name_some([" = ".join(group) for group in groups])
    return [remarks.DUPLICATES(names=some, frames=names)]


def _near_duplicates(frames: Sequence[FrameFigures]) -> list[tuple[str, str]]:
    """Pairs whose contacts are at one place, of one size and of one colour."""
    pairs = []
    for i, a in enumerate(frames):
        for b in frames[:i]:
            if a.press.sha256 == b.press.sha256 or a.contact is None or b.contact is None:
                continue
            one, two = a.contact.circle, b.contact.circle
            apart = np.hypot(one.u_px - two.u_px, one.v_px - two.v_px)
            if apart > 2.0 or abs(one.radius_px - two.radius_px) > 2.0:
                continue
            change = a.thumb - b.thumb
            change = change - np.median(change, axis=(0, 1))
            strongest = float(np.percentile(np.linalg.norm(change, axis=-1), 99.5))
            if strongest < max(MIN_DUPLICATE_LEVELS, NEAR_DUPLICATE * a.contact.contrast_levels):
                pairs.append((b.press.name, a.press.name))
    return pairs
