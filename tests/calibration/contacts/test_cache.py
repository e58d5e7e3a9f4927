# SPDX-License-Identifier: Apache-2.0
"""Contacts that were found are kept, and taken only for the very same search."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

import pytest

from taccel_lab.calibration.capture import CaptureSet
from taccel_lab.calibration.contacts import cache
from taccel_lab.calibration.contacts.cache import cached_contacts, kept_contacts
from taccel_lab.calibration.contacts.usable import usable_presses
from taccel_lab.errors import InputError
from taccel_lab.file_cache import CACHE_VARIABLE
from tests.calibration.contacts.test_usable import with_empty_frames
from tests.support.synthetic_presses import synthetic_captures


class SearchedAgainError(Exception):
    pass


def searched(*_: object) -> None:
    raise SearchedAgainError


@pytest.fixture
def captures(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> CaptureSet:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    captures, _ = synthetic_captures(10)
    return with_empty_frames(captures, {4})


def test_cached_contacts_are_those_that_were_found(
    captures: CaptureSet, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = usable_presses(captures, cache=True)
    monkeypatch.setattr(cache, "find_contacts", searched)
    again = usable_presses(captures, cache=True)
    assert [asdict(c) for c in again[1]] == [asdict(c) for c in first[1]]
    assert again[2] == first[2] and "p4" in again[2][0].message


def test_nothing_is_kept_unless_asked(captures: CaptureSet) -> None:
    usable_presses(captures)
    assert not kept_contacts(captures).path.exists()


def test_anything_that_matters_asks_for_a_search(
    captures: CaptureSet, monkeypatch: pytest.MonkeyPatch
) -> None:
    captures = replace(captures, presses=captures.presses[:3])
    cached_contacts(captures)
    monkeypatch.setattr(cache, "find_contacts", searched)
    mask = captures.mask.copy()
    mask[0, 0] = not mask[0, 0]
    first, *others = captures.presses
    assert first.circle is not None
    moved = replace(first.circle, u_px=first.circle.u_px + 1)
    for changed in (
        replace(captures, mask=mask),
        replace(captures, background=captures.background[:, ::-1]),
        replace(captures, ball_radius_mm=2.5),
        replace(captures, grid=replace(captures.grid, mm_per_px_x=0.11)),
        replace(captures, presses=(replace(first, sha256="other"), *others)),
        replace(captures, presses=(replace(first, radius_mm=2.5), *others)),
        replace(captures, presses=(replace(first, checked=True), *others)),
        # It says whether a contact that the border cuts is one.
        replace(captures, presses=(replace(first, circle=moved), *others)),
        replace(captures, presses=(*others, first)),
    ):
        with pytest.raises(SearchedAgainError):
            cached_contacts(changed)
    monkeypatch.setattr(cache, "_code_sha256", lambda: "another version")
    with pytest.raises(SearchedAgainError):
        cached_contacts(captures)


@pytest.mark.parametrize("text", ["", "{", '{"contacts": [], "refusals": {}}', "[]"])
def test_a_damaged_file_is_told_and_made_anew(captures: CaptureSet, text: str) -> None:
    captures = replace(captures, presses=captures.presses[:3])
    found = cached_contacts(captures)
    kept_contacts(captures).path.write_text(text)
    with pytest.warns(UserWarning, match="are damaged"):
        again = cached_contacts(captures)
    assert again.contacts == found.contacts
    assert cached_contacts(captures).contacts == found.contacts


def test_a_cache_that_cannot_be_written_is_named(
    captures: CaptureSet, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "file"))
    with pytest.raises(InputError, match=CACHE_VARIABLE):
        cached_contacts(replace(captures, presses=captures.presses[:3]))
