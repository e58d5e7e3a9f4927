# SPDX-License-Identifier: Apache-2.0
"""A few presses without a contact are left out and named; many stop the fit."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from taccel_lab.calibration.capture import CaptureSet
from taccel_lab.calibration.contacts.usable import too_many_lost, usable_presses
from taccel_lab.errors import InputError
from tests.calibration.synthetic import synthetic_captures


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
