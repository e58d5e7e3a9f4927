# SPDX-License-Identifier: Apache-2.0
"""Which presses a fit may use: those with a contact; a few without one do not stop the others.

Colour and normals look for the same contacts in the same images, and so does every later run. What
is found is kept in the user's cache folder by everything that the search sees: images, background,
mask, scale, balls, corrections by a person, and the text of the modules that search.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import BinaryIO, Literal

import numpy as np

from taccel_lab.calibration.capture.captures import CapturedPress, CaptureSet, ContactCircle
from taccel_lab.calibration.circles.contact_finder import detect_contact, find_contacts
from taccel_lab.calibration.circles.labels import (
    CutContactError,
    DetectedContact,
    LabelPlacement,
    choose_circles,
    fuse_circles,
)
from taccel_lab.calibration.remarks import PRESSES_LEFT_OUT
from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import to_jsonable
from taccel_lab.files.file_cache import CachedFile
from taccel_lab.progress import Progress, silent
from taccel_lab.reading import light, whole_frame
from taccel_lab.report.remark import Remark
from taccel_lab.signals.depth_response import Channel

LEAST_PRESSES = 6
"""Presses that are left: with this number, those without a contact do not stop the others."""
MAX_LOST_SHARE = 0.5
"""Part of the presses that may be lost; beyond, something is wrong with the whole set."""

Found = list[DetectedContact | InputError]


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
        InputError: Too many are lost (``too_many_lost``); with every reason. The cache folder
            cannot be written.
    """
    if cache and grey is None:
        found = cached_contacts(captures, progress)
    else:
        found = find_contacts(captures, progress, grey)
    contacts = [one for one in found if isinstance(one, DetectedContact)]
    lost = [
        (press.name, one)
        for press, one in zip(captures.presses, found, strict=True)
        if isinstance(one, InputError)
    ]
    if not lost:
        return captures, contacts, []
    reasons = [str(error) for _, error in lost]
    cut = [isinstance(error, CutContactError) for _, error in lost]
    if too_many_lost(len(captures.presses), cut):
        raise InputError("\n".join(reasons))
    names = [name for name, _ in lost]
    remark = PRESSES_LEFT_OUT(
        lost=len(lost),
        count=len(captures.presses),
        names=", ".join(names),
        reasons="; ".join(reasons),
        advice=" With its circle in captures.toml a press that the border cuts is used by its part "
        "in the image"
        if any(cut)
        else "",
    )
    kept = tuple(
        press
        for press, one in zip(captures.presses, found, strict=True)
        if isinstance(one, DetectedContact)
    )
    provenance = {**captures.provenance, "left_out": ", ".join(names)}
    return replace(captures, presses=kept, provenance=provenance), contacts, [remark]


def cached_contacts(captures: CaptureSet, progress: Progress = silent) -> Found:
    """Contacts of ``captures`` as ``find_contacts`` gives them, from the cache where they are."""
    count = len(captures.presses)
    kept = CachedFile(
        "contacts",
        {
            "code": _code_sha256(),
            "background": captures.background,
            "mask": captures.mask,
            "grid": asdict(captures.grid),
            "ball_radius_mm": captures.ball_radius_mm,
            "presses": [
                {
                    # Names and places are part of the refusals' messages.
                    "name": press.name,
                    "source": press.source,
                    "sha256": press.sha256,
                    "radius_mm": press.radius_mm,
                    "label": asdict(press.circle) if press.circle else None,
                    "checked": press.checked,
                }
                for press in captures.presses
            ],
        },
        lambda file: _load(file, count),
        _save,
    )
    return kept.read_or_make(lambda: find_contacts(captures, progress))


@cache
def _code_sha256() -> str:
    """Digest of the modules that search, so that contacts of another version are never taken."""
    others = [Path(str(module.__file__)) for module in (light, whole_frame)]
    files = [*sorted(Path(__file__).parent.glob("*.py")), *others]
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()


def _save(file: BinaryIO, found: Found) -> None:
    values = [
        asdict(one)
        if isinstance(one, DetectedContact)
        else {"message": str(one), "cut": isinstance(one, CutContactError)}
        for one in found
    ]
    file.write(json.dumps(to_jsonable(values), allow_nan=False).encode())


def _load(file: BinaryIO, count: int) -> Found:
    values = json.load(file)
    if len(values) != count:
        raise ValueError("it is of another number of presses")
    return [
        DetectedContact(**{**value, "circle": ContactCircle(**value["circle"])})
        if "circle" in value
        else (CutContactError if value["cut"] else InputError)(value["message"])
        for value in values
    ]


def too_many_lost(press_count: int, cut: Sequence[bool]) -> bool:
    """Whether the presses without a usable contact speak against the whole set: more than half
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
    """Contacts that the images show."""
    circles: list[ContactCircle]
    """Circles that a fit starts from."""
    sigmas_px: list[tuple[float, float]]
    """What these may be off by: standard deviations of the centre along an axis and of the radius.
    Fused circles are at least as certain as found ones."""
    remarks: list[Remark]
    """Remarks on presses left out."""

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
    sigmas_px = [(contact.center_sigma_px, contact.radius_sigma_px) for contact in found]
    if which == "labels":
        given = [press.circle for press in captures.presses if press.circle is not None]
        sigmas_px = [fuse_circles(given, found)[1]] * len(found)
    return UsableCircles(
        captures,
        found,
        choose_circles(captures, found, which),
        sigmas_px,
        remarks,
    )


def place_heldout(
    press: CapturedPress, image: np.ndarray, captures: CaptureSet, labels: LabelPlacement
) -> ContactCircle:
    """Where a press is that had no part in a fit: by its label, or found in ``image`` without one.

    ``labels`` says how those of the training presses lie. Raises InputError when there is no label
    and the image shows no contact.
    """
    ball_mm = press.radius_mm or captures.ball_radius_mm
    if press.circle is not None:
        return labels.applied(press.circle, ball_mm / captures.grid.mm_per_px_x)
    return detect_contact(
        image,
        captures.background,
        captures.grid,
        mask=captures.mask,
        name=press.source,
        ball_radius_mm=ball_mm,
    ).circle
