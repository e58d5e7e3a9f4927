# SPDX-License-Identifier: Apache-2.0
"""Which presses a fit may use: those with a contact; a few without one do not stop the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from taccel_lab.calibration.capture.captures import CaptureSet, ContactCircle
from taccel_lab.calibration.circles.cache import cached_contacts
from taccel_lab.calibration.circles.contact_finder import find_contacts
from taccel_lab.calibration.circles.fusion import choose_circles, fuse_circles
from taccel_lab.calibration.circles.labels import (
    LabelAgreement,
    LabelPlacement,
    compare_with_labels,
)
from taccel_lab.calibration.circles.remarks import PRESSES_LEFT_OUT
from taccel_lab.calibration.circles.result import DetectedContact, Refusal
from taccel_lab.errors import InputError
from taccel_lab.progress import Progress, silent
from taccel_lab.report.remark import Remark
from taccel_lab.signals.depth_response import Channel

LEAST_PRESSES = 6
"""With so many left, presses without a contact do not stop the others."""
MAX_LOST_SHARE = 0.5
"""Part of the presses that may be lost; beyond, something is wrong with the whole set."""


def usable_presses(
    captures: CaptureSet,
    progress: Progress = silent,
    *,
    cache: bool = False,
    grey: Channel | None = None,
) -> tuple[CaptureSet, list[DetectedContact], list[Remark]]:
    """The presses with a contact, their contacts in order, and a remark on those left out.

    With ``cache``, contacts are kept in the user's cache folder, and taken from it; those of a
    ``grey`` sensor (``find_contacts``) are found soon enough without.

    Raises:
        InputError: Too many are lost (``too_many_lost``); with every reason.
    """
    if cache and grey is None:
        found = cached_contacts(captures, progress)
    else:
        found = find_contacts(captures, progress, grey)
    refusals = [found.refusals[i] for i in sorted(found.refusals)]
    contacts = [contact for contact in found.contacts if contact is not None]
    if not refusals:
        return captures, contacts, []
    remark = left_out_remark(len(captures.presses), refusals)
    kept = tuple(
        press
        for press, contact in zip(captures.presses, found.contacts, strict=True)
        if contact is not None
    )
    names = ", ".join(refusal.name for refusal in refusals)
    provenance = {**captures.provenance, "left_out": names}
    return replace(captures, presses=kept, provenance=provenance), contacts, [remark]


def left_out_remark(press_count: int, refusals: Sequence[Refusal]) -> Remark:
    """Says which presses are left out and why; InputError with every reason where too many are."""
    if too_many_lost(press_count, [refusal.cut for refusal in refusals]):
        raise InputError("\n".join(refusal.message for refusal in refusals))
    return PRESSES_LEFT_OUT(
        lost=len(refusals),
        count=press_count,
        names=", ".join(refusal.name for refusal in refusals),
        reasons="; ".join(refusal.message for refusal in refusals),
        advice=" With its circle in captures.toml a press that the border cuts is used by its part "
        "in the image"
        if any(refusal.cut for refusal in refusals)
        else "",
    )


def too_many_lost(press_count: int, cut: Sequence[bool]) -> bool:
    """Whether so many presses without a usable contact speak against the whole set: more than half
    of them, or all but five, as long as one of them is not just cut.

    ``cut`` has an entry for each of them: whether the image's border is what cuts its contact.
    """
    few = press_count - len(cut) < LEAST_PRESSES
    return (few and not all(cut)) or len(cut) > MAX_LOST_SHARE * press_count


@dataclass(frozen=True)
class UsableCircles:
    """Presses that a fit may use, their contacts and circles in order."""

    captures: CaptureSet
    contacts: list[DetectedContact]
    """As found in the images."""
    circles: list[ContactCircle]
    """Those that a fit starts from."""
    sigmas_px: list[tuple[float, float]]
    """What these may be off by: standard deviations of the centre along an axis and of the radius.
    Fused circles are at least as certain as found ones."""
    remarks: list[Remark]
    """On presses left out."""
    agreement: LabelAgreement | None
    """Of found circles with labels; None where nobody gave any."""

    @property
    def labels(self) -> LabelPlacement:
        """How labels lie against these circles."""
        found = [contact.circle for contact in self.contacts]
        return LabelPlacement.of(self.captures.presses, self.circles, found)


def usable_circles(
    captures: CaptureSet,
    which: Literal["fused", "labels", "detected"] = "fused",
    *,
    cache: bool = True,
    progress: Progress = silent,
) -> UsableCircles:
    """Circles of the training presses ``captures``, which are explained together.

    All of them are looked at, whatever circles are taken, so that empty frames are found. With
    ``cache``, contacts that an earlier run or stage found in these images are taken as they are.

    Raises:
        InputError: ``labels`` are wanted, and a press has none; too many presses without a contact.
    """
    unlabelled = sum(press.circle is None for press in captures.presses)
    if which == "labels" and unlabelled:
        raise InputError(
            f"{captures.source}: {unlabelled} presses come without a contact circle; --circles "
            "labels needs all of them, fused or detected does not"
        )
    captures, found, remarks = usable_presses(captures, progress, cache=cache)
    return UsableCircles(
        captures,
        found,
        choose_circles(captures, found, which),
        _sigmas_px(captures, found, which),
        remarks,
        compare_with_labels(captures, found),
    )


def _sigmas_px(
    captures: CaptureSet, found: Sequence[DetectedContact], which: str
) -> list[tuple[float, float]]:
    """Standard deviations of centre and radius of the chosen circles."""
    if which != "labels":
        return [(contact.center_sigma_px, contact.radius_sigma_px) for contact in found]
    given = [press.circle for press in captures.presses if press.circle is not None]
    return [fuse_circles(given, found).label_sigma_px] * len(found)
