# SPDX-License-Identifier: Apache-2.0
"""Which contacts count: found ones fused with labels, reviewed by a person, usable."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.calibration.capture import CapturedPress, CaptureSet, ContactCircle
from taccel_lab.calibration.circles import contact_finder, usable
from taccel_lab.calibration.circles.labels import (
    LABEL_SHIFT_PX,
    DetectedContact,
    LabelPlacement,
    choose_circles,
    circle_array,
    fuse_circles,
)
from taccel_lab.calibration.circles.usable import (
    cached_contacts,
    too_many_lost,
    usable_circles,
    usable_presses,
)
from taccel_lab.errors import InputError
from taccel_lab.files.file_cache import CACHE_VARIABLE
from tests.calibration.circles.presses import (
    contacts_of,
)
from tests.support.synthetic_presses import GRID as DRAWN_GRID
from tests.support.synthetic_presses import (
    press_image,
    synthetic_captures,
    with_circles,
    with_images,
)


def with_empty_frames(captures: CaptureSet, which: set[int]) -> CaptureSet:
    return with_images(captures, dict.fromkeys(which, captures.background))


def test_sound_presses_stay_as_they_are() -> None:
    captures, _ = synthetic_captures(4)
    kept, contacts, remarks = usable_presses(captures)
    assert kept is captures and len(contacts) == 4 and remarks == []


@pytest.mark.thorough
def test_one_empty_frame_in_ten_is_left_out() -> None:
    captures, _ = synthetic_captures(10)
    kept, contacts, (remark,) = usable_presses(with_empty_frames(captures, {4}))
    assert [press.name for press in kept.presses] == [f"p{i}" for i in range(10) if i != 4]
    for press, contact in zip(kept.presses, contacts, strict=True):
        assert press.circle is not None
        assert abs(contact.circle.u_px - press.circle.u_px) < 1.5
    assert "1 of 10 presses were left out: p4" in remark.message
    assert "no contact found" in remark.message and kept.provenance["left_out"] == "p4"


@pytest.mark.thorough
def test_presses_without_a_contact_are_left_out_while_six_remain() -> None:
    captures, _ = synthetic_captures(10)
    kept, _, (remark,) = usable_presses(with_empty_frames(captures, {2, 7, 8, 9}))
    assert [press.name for press in kept.presses] == ["p0", "p1", "p3", "p4", "p5", "p6"]
    assert "4 of 10 presses were left out" in remark.message
    with pytest.raises(InputError, match=r"memory\[2\].*no contact") as caught:
        usable_presses(with_empty_frames(captures, {1, 2, 7, 8, 9}))
    assert all(f"memory[{i}]" in str(caught.value) for i in (1, 2, 7, 8, 9))


@pytest.mark.thorough
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
    assert not too_many_lost(10, [False] * 4) and too_many_lost(10, [False] * 5)
    assert not too_many_lost(30, [False] * 15) and too_many_lost(30, [False] * 16)


def with_cut_presses(captures: CaptureSet, circles: Mapping[int, ContactCircle]) -> CaptureSet:
    """Some presses in other circles, which the border of the image may cut, labelled there."""
    rng = np.random.default_rng(4)
    images = {i: press_image(circle, rng)[0] for i, circle in circles.items()}
    return with_circles(with_images(captures, images), circles)


CUT = {2: ContactCircle(152.0, 60.0, 15.0), 5: ContactCircle(158.0, 116.0, 14.0)}


@pytest.mark.thorough
def test_labelled_contacts_that_the_border_cuts_are_found_by_their_part_inside() -> None:
    captures = with_cut_presses(synthetic_captures(7)[0], CUT)
    used = usable_circles(captures, cache=False)
    assert len(used.circles) == 7 and used.remarks == []
    for i, circle in CUT.items():
        found, sigma_px = used.contacts[i].circle, used.contacts[i].center_sigma_px
        assert found.center_gap_px(circle, DRAWN_GRID) < 1.0 + 3 * sigma_px
        assert found.radius_px == pytest.approx(circle.radius_px, abs=2.0)
    # Without a label nothing says that what is left of it is a contact's.
    _, _, (remark,) = usable_presses(with_circles(captures, [None] * 7))
    assert "2 of 7 presses were left out: p2, p5" in remark.message


@pytest.mark.thorough
def test_a_contact_that_the_fit_loses_does_not_stop_the_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    captures = with_cut_presses(synthetic_captures(10)[0], CUT)
    monkeypatch.setattr(contact_finder, "MIN_LABELLED_VISIBLE", 0.6)
    kept, _, (remark,) = usable_presses(captures)
    assert "1 of 10 presses were left out: p5" in remark.message
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
    monkeypatch.setattr(usable, "find_contacts", searched)
    again = usable_presses(captures, cache=True)
    assert [asdict(c) for c in again[1]] == [asdict(c) for c in first[1]]
    assert again[2] == first[2] and "p4" in again[2][0].message


def test_nothing_is_kept_unless_asked(captures: CaptureSet, tmp_path: Path) -> None:
    captures = replace(captures, presses=captures.presses[:3])
    usable_presses(captures)
    assert not [*tmp_path.iterdir()]


def test_anything_that_matters_asks_for_a_search(
    captures: CaptureSet, monkeypatch: pytest.MonkeyPatch
) -> None:
    captures = replace(captures, presses=captures.presses[:3])
    cached_contacts(captures)
    monkeypatch.setattr(usable, "find_contacts", searched)
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
    monkeypatch.setattr(usable, "_code_sha256", lambda: "another version")
    with pytest.raises(SearchedAgainError):
        cached_contacts(captures)


@pytest.mark.parametrize("text", ["{", "[]"])
def test_a_damaged_file_is_told_and_made_anew(
    captures: CaptureSet, tmp_path: Path, text: str
) -> None:
    captures = replace(captures, presses=captures.presses[:3])
    found = cached_contacts(captures)
    (kept,) = (path for path in tmp_path.rglob("*") if path.is_file())
    kept.write_text(text)
    with pytest.warns(UserWarning, match="are damaged"):
        again = cached_contacts(captures)
    assert again == found
    assert cached_contacts(captures) == found


def circles(values: np.ndarray) -> list[ContactCircle]:
    return [ContactCircle(*(float(x) for x in row)) for row in values]


def contacts(values: np.ndarray, center: float, radius: float) -> list[DetectedContact]:
    """Detected circles of these stated standard deviations."""
    return [
        DetectedContact(circle, radius, 50.0, center_sigma_px=center) for circle in circles(values)
    ]


def presses(count: int, spread: float, rng: np.random.Generator) -> np.ndarray:
    return np.column_stack([np.full((count, 2), 100.0), rng.normal(60, spread, count)])


@pytest.mark.parametrize("true_spread", [0.0, 1.0, 5.0])
def test_fusion_beats_both(true_spread: float) -> None:
    rng = np.random.default_rng(0)
    truth = presses(400, true_spread, rng)
    label = truth + rng.normal(0, 2.0, truth.shape)
    found = truth + rng.normal(0, 2.0, truth.shape)
    fused = circle_array(fuse_circles(circles(label), contacts(found, 2.0, 2.0))[0])
    error = fused[:, 2] - truth[:, 2]
    # Best possible: the posterior spread of two measurements with noise 2 and prior true_spread.
    best = (1 / (2 / 4.0 + 1 / true_spread**2)) ** 0.5 if true_spread else 0.0
    assert error.std() < best * 1.1 + 0.25
    assert np.std(fused[:, 0] - 100) == pytest.approx(2 / np.sqrt(2), rel=0.1)


def test_a_shift_that_all_labels_share_is_taken_off() -> None:
    """Labels 3 px below and 2 px too wide, as on a set of real presses."""
    rng, shift = np.random.default_rng(1), np.array([0.5, -3.0, 2.0])
    errors = []
    for _ in range(40):
        truth = presses(25, 4.0, rng)
        label = truth + shift + rng.normal(0, 1.5, truth.shape)
        found = truth + rng.normal(0, 0.7, truth.shape)
        fused, label_sigma_px = fuse_circles(circles(label), contacts(found, 0.7, 0.7))
        errors.append(circle_array(fused) - truth)
        assert label_sigma_px == pytest.approx((1.5, 1.5), rel=0.5)
    error = np.array(errors)
    # Less than a twelfth of the shift is left; the plain mean of both left a half.
    assert np.abs(error.mean(axis=(0, 1))).max() < 0.25
    assert np.sqrt((error**2).mean()) < 0.7


def test_a_press_that_its_label_places_is_off_by_what_is_stated() -> None:
    rng, shift, scores = np.random.default_rng(5), np.array([1.0, -2.0, 1.5]), []
    for _ in range(60):
        truth = presses(24, 4.0, rng)
        label = truth + shift + rng.normal(0, 1.5, truth.shape)
        found = truth + rng.normal(0, 0.8, truth.shape)
        placed = fuse_circles(circles(label[4:]), contacts(found[4:], 0.8, 0.8))[0]
        known = [CapturedPress("p", "", "", lambda: np.zeros(0), c) for c in circles(label[4:])]
        labels = LabelPlacement.of(known, placed)
        center, radius = labels.sigma_px((0.8, 0.8))
        held = circle_array([labels.applied(c, 200.0) for c in circles(label[:4])])
        scores.append((held - truth[:4]) / (center, center, radius))
    spread = np.sqrt(np.mean(np.square(scores), axis=(0, 1)))
    assert ((spread > 0.75) & (spread < 1.15)).all()


def test_a_common_error_within_the_stated_one_is_not_blamed_on_the_labels() -> None:
    """Radii that a poor detection finds 6 px too small, and says so: labels are to be believed."""
    rng = np.random.default_rng(2)
    truth = presses(30, 4.0, rng)
    label = truth + rng.normal(0, 1.0, truth.shape)
    found = truth - (0.0, 0.0, 6.0) + rng.normal(0, 0.5, truth.shape)
    fused, _ = fuse_circles(circles(label), contacts(found, 0.5, 6.0))
    off = circle_array(fused)[:, 2] - truth[:, 2]
    # A fifth of it, as 3^2 / (3^2 + 6^2), may still be the labels'.
    assert off.mean() == pytest.approx(-1.2, abs=0.4)


@given(
    st.lists(
        st.tuples(st.floats(20, 200), st.floats(20, 200), st.floats(5, 60), st.floats(5, 60)),
        min_size=1,
        max_size=20,
    ),
    st.floats(-5, 5),
)
def test_labels_that_all_move_take_circles_along_by_their_doubt_alone(
    rows: list[tuple[float, float, float, float]], move: float
) -> None:
    label = np.array([(u, v, a) for u, v, a, _ in rows])
    found = contacts(np.array([(u, v, b) for u, v, _, b in rows]), 0.4, 0.4)
    first = circle_array(fuse_circles(circles(label), found)[0])
    second = circle_array(fuse_circles(circles(label + (move, 0, 0)), found)[0])
    moved = second[:, 0] - first[:, 0]
    assert np.abs(moved).max() <= abs(move) * 2 * 0.4**2 / LABEL_SHIFT_PX**2 + 1e-9


def test_two_presses_lie_where_they_are_found_and_apart_as_both_say() -> None:
    label = [ContactCircle(50, 50, r) for r in (20.0, 30.0)]
    found = contacts(np.array([(52, 50, 24), (52, 50, 28)]), 1.0, 1.0)
    fused = circle_array(fuse_circles(label, found)[0])
    # Both scatters are 1 px, and the mean difference is little beside the shift's 3 px.
    assert fused[1, 2] - fused[0, 2] == pytest.approx((10 + 4) / 2)
    assert fused[:, 2].mean() == pytest.approx(26 - 1.0 * (1 + 0.5) / (9 + 2), abs=0.15)
    assert fused[:, 0] == pytest.approx([52, 52], abs=0.5)


def test_choice_of_circles() -> None:
    captures, _ = synthetic_captures(3)
    object.__setattr__(captures.presses[1], "circle", None)
    found = contacts_of(captures)
    for which in ("fused", "labels", "detected"):
        chosen = choose_circles(captures, found, which)
        assert chosen[1] == found[1].circle
    given = captures.presses[0].circle
    assert given is not None
    assert choose_circles(captures, found, "labels")[0] == given
    assert choose_circles(captures, found, "detected")[0] == found[0].circle
    labels = [press.circle for press in captures.presses if press.circle is not None]
    fused = fuse_circles(labels, [found[0], found[2]])[0]
    assert choose_circles(captures, found, "fused")[::2] == fused


def test_counts_have_to_match() -> None:
    with pytest.raises(InputError, match="1 labels do not match 0"):
        fuse_circles([ContactCircle(5, 5, 5)], [])
    with pytest.raises(InputError, match="at least one"):
        fuse_circles([], [])
