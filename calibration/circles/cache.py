# SPDX-License-Identifier: Apache-2.0
"""Contacts that were found, kept in the cache folder by everything that they depend on.

Colour and normals look for the same contacts in the same images, and so does every later run. The
key holds what the search sees: images, background, mask, scale, balls, corrections by a person, and
the text of the modules that search.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import BinaryIO

import taccel_lab.calibration.circles
import taccel_lab.calibration.light
from taccel_lab.calibration.capture.captures import CaptureSet, ContactCircle
from taccel_lab.calibration.circles.contact_finder import find_contacts
from taccel_lab.calibration.circles.result import DetectedContact, FoundContacts, Refusal
from taccel_lab.files.atomic_file import to_jsonable
from taccel_lab.files.file_cache import CachedFile
from taccel_lab.progress import Progress, silent


def cached_contacts(captures: CaptureSet, progress: Progress = silent) -> FoundContacts:
    """Contacts of ``captures`` as ``find_contacts`` gives them, from the cache where they are.

    Raises:
        InputError: The cache folder cannot be written.
    """
    return kept_contacts(captures).read_or_make(lambda: find_contacts(captures, progress))


def kept_contacts(captures: CaptureSet) -> CachedFile[FoundContacts]:
    """The file of the contacts of ``captures``."""
    count = len(captures.presses)
    return CachedFile(
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


@cache
def _code_sha256() -> str:
    """Of the modules that search, so that contacts of another version are never taken."""
    packages = (taccel_lab.calibration.circles, taccel_lab.calibration.light)
    folders = [Path(str(package.__file__)).parent for package in packages]
    files = [path for folder in folders for path in sorted(folder.glob("*.py"))]
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()


def _save(file: BinaryIO, found: FoundContacts) -> None:
    values = {
        "contacts": [None if contact is None else asdict(contact) for contact in found.contacts],
        "refusals": {str(i): asdict(refusal) for i, refusal in found.refusals.items()},
    }
    file.write(json.dumps(to_jsonable(values), allow_nan=False).encode())


def _load(file: BinaryIO, count: int) -> FoundContacts:
    values = json.load(file)
    contacts = [
        None
        if value is None
        else DetectedContact(**{**value, "circle": ContactCircle(**value["circle"])})
        for value in values["contacts"]
    ]
    if len(contacts) != count:
        raise ValueError("it is of another number of presses")
    refusals = {int(i): Refusal(**value) for i, value in values["refusals"].items()}
    return FoundContacts(contacts, refusals)
