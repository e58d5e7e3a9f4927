# SPDX-License-Identifier: Apache-2.0
"""A few presses without a contact are left out and named; many stop the fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from taccel_lab.calibration.capture import CaptureSet, ContactCircle
from taccel_lab.calibration.contacts import fit
from taccel_lab.calibration.contacts.usable import too_many_lost, usable_circles, usable_presses
from taccel_lab.errors import InputError
from tests.support.synthetic_presses import GRID, press_image, synthetic_captures


def with_empty_frames(captures: CaptureSet, which: set[int]) -> CaptureSet:
    presses = tuple(
        replace(press, read=partial(np.copy, captures.background)) if i in which else press
        for i, press in enumerate(captures.presses)
    )
    return replace(captures, presses=presses)


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
    presses = list(captures.presses)
    for i in (1, 3, 8):
        circle = presses[i].circle
        assert circle is not None
        away = round(circle.u_px - 0.4 * circle.radius_px)
        image = np.roll(presses[i].image(), -away, axis=1)
        image[:, -away:] = captures.background[:, -away:]
        presses[i] = replace(presses[i], read=partial(np.copy, image))
    kept, _, (remark,) = usable_presses(replace(captures, presses=tuple(presses)))
    assert len(kept.presses) == 7 and "out of the image" in remark.message
    assert not too_many_lost(10, [True] * 5) and too_many_lost(10, [True] * 6)
    assert not too_many_lost(10, [False]) and too_many_lost(10, [False] * 2)


def with_cut_presses(captures: CaptureSet, circles: Mapping[int, ContactCircle]) -> CaptureSet:
    """Some presses in other circles, which the border of the image may cut, labelled there."""
    presses, rng = list(captures.presses), np.random.default_rng(4)
    for i, circle in circles.items():
        read = partial(np.copy, press_image(circle, rng)[0])
        presses[i] = replace(presses[i], circle=circle, read=read)
    return replace(captures, presses=tuple(presses))


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
    unlabelled = tuple(replace(press, circle=None) for press in captures.presses)
    _, _, (remark,) = usable_presses(replace(captures, presses=unlabelled))
    assert "2 of 10 presses were left out: p2, p7" in remark.message


def test_a_contact_that_the_fit_loses_does_not_stop_the_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    captures = with_cut_presses(synthetic_captures(10)[0], CUT)
    monkeypatch.setattr(fit, "MIN_LABELLED_VISIBLE", 0.6)
    kept, _, (remark,) = usable_presses(captures)
    assert "1 of 10 presses were left out: p7" in remark.message
    assert len(kept.presses) == 9
