# SPDX-License-Identifier: Apache-2.0
"""Presses without a contact are left out and named, many stop the fit; what was found is kept."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.calibration.capture import CaptureSet, ContactCircle
from taccel_lab.calibration.contacts import cache, fit
from taccel_lab.calibration.contacts.cache import cached_contacts, kept_contacts
from taccel_lab.calibration.contacts.usable import too_many_lost, usable_circles, usable_presses
from taccel_lab.errors import InputError
from taccel_lab.files.file_cache import CACHE_VARIABLE
from tests.support.synthetic_presses import (
    GRID,
    press_image,
    synthetic_captures,
    with_circles,
    with_images,
)


def with_empty_frames(captures: CaptureSet, which: set[int]) -> CaptureSet:
    return with_images(captures, dict.fromkeys(which, captures.background))


def test_sound_presses_stay_as_they_are() -> None:
    captures, _ = synthetic_captures(10)
    kept, contacts, remarks = usable_presses(captures)
    assert kept is captures and len(contacts) == 10 and remarks == []


def test_one_empty_frame_in_ten_is_left_out() -> None:
    captures, _ = synthetic_captures(10)
    kept, contacts, (remark,) = usable_presses(with_empty_frames(captures, {4}))
    assert [press.name for press in kept.presses] == [f"p{i}" for i in range(10) if i != 4]
    for press, contact in zip(kept.presses, contacts, strict=True):
        assert press.circle is not None
        assert abs(contact.circle.u_px - press.circle.u_px) < 1.5
    assert "1 of 10 presses were left out: p4" in remark.message
    assert "no contact found" in remark.message and kept.provenance["left_out"] == "p4"


def test_many_empty_frames_are_refused_with_every_name() -> None:
    captures, _ = synthetic_captures(10)
    with pytest.raises(InputError, match=r"memory\[2\].*no contact") as caught:
        usable_presses(with_empty_frames(captures, {2, 7}))
    assert "memory[7]" in str(caught.value)


def test_contacts_that_the_border_cuts_are_left_out() -> None:
    captures, _ = synthetic_captures(10)
    images = {}
    for i in (1, 3, 8):
        circle = captures.presses[i].circle
        assert circle is not None
        away = round(circle.u_px - 0.4 * circle.radius_px)
        images[i] = np.roll(captures.presses[i].image(), -away, axis=1)
        images[i][:, -away:] = captures.background[:, -away:]
    kept, _, (remark,) = usable_presses(with_images(captures, images))
    assert len(kept.presses) == 7 and "out of the image" in remark.message
    assert not too_many_lost(10, [True] * 5) and too_many_lost(10, [True] * 6)
    assert not too_many_lost(10, [False]) and too_many_lost(10, [False] * 2)


def with_cut_presses(captures: CaptureSet, circles: Mapping[int, ContactCircle]) -> CaptureSet:
    """Some presses in other circles, which the border of the image may cut, labelled there."""
    rng = np.random.default_rng(4)
    images = {i: press_image(circle, rng)[0] for i, circle in circles.items()}
    return with_circles(with_images(captures, images), circles)


CUT = {2: ContactCircle(152.0, 60.0, 15.0), 7: ContactCircle(158.0, 116.0, 14.0)}


def test_labelled_contacts_that_the_border_cuts_are_found_by_their_part_inside() -> None:
    captures = with_cut_presses(synthetic_captures(10)[0], CUT)
    usable = usable_circles(captures, cache=False)
    assert len(usable.circles) == 10 and usable.remarks == []
    for i, circle in CUT.items():
        found, sigma_px = usable.contacts[i].circle, usable.contacts[i].center_sigma_px
        assert found.center_gap_px(circle, GRID) < 1.0 + 3 * sigma_px
        assert found.radius_px == pytest.approx(circle.radius_px, abs=2.0)
    # Without a label nothing says that what is left of it is a contact's.
    _, _, (remark,) = usable_presses(with_circles(captures, [None] * 10))
    assert "2 of 10 presses were left out: p2, p7" in remark.message


def test_a_contact_that_the_fit_loses_does_not_stop_the_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    captures = with_cut_presses(synthetic_captures(10)[0], CUT)
    monkeypatch.setattr(fit, "MIN_LABELLED_VISIBLE", 0.6)
    kept, _, (remark,) = usable_presses(captures)
    assert "1 of 10 presses were left out: p7" in remark.message
    assert len(kept.presses) == 9


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
