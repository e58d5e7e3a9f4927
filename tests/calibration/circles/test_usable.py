# SPDX-License-Identifier: Apache-2.0
"""Which contacts count: found ones fused with labels, reviewed by a person, usable."""

from __future__ import annotations

from collections.abc import Callable
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
from taccel_lab.calibration.circles.usable import cached_contacts, too_many_lost, usable_presses
from taccel_lab.errors import InputError
from taccel_lab.files.file_cache import CACHE_VARIABLE
from tests.support import synthetic_presses as synthetic
from tests.support.synthetic_presses import GRID, circles_of, synthetic_captures, with_circles


def with_empty_frames(captures: CaptureSet, which: set[int]) -> CaptureSet:
    return synthetic.with_images(captures, dict.fromkeys(which, captures.background))


@pytest.mark.thorough
@pytest.mark.parametrize("empty", [{4}, {2, 7, 8, 9}])
def test_presses_without_a_contact_are_left_out_while_six_remain(empty: set[int]) -> None:
    captures, _ = synthetic_captures(10)
    kept, contacts, (remark,) = usable_presses(with_empty_frames(captures, empty))
    assert [press.name for press in kept.presses] == [f"p{i}" for i in range(10) if i not in empty]
    for circle, contact in zip(circles_of(kept), contacts, strict=True):
        assert abs(contact.circle.u_px - circle.u_px) < 1.5
    named = ", ".join(f"p{i}" for i in sorted(empty))
    assert f"{len(empty)} of 10 presses were left out: p{min(empty)}" in remark.message
    assert "no contact found" in remark.message and kept.provenance["left_out"] == named
    with pytest.raises(InputError, match=r"memory\[2\].*no contact") as caught:
        usable_presses(with_empty_frames(captures, {1, 2, 7, 8, 9}))
    assert all(f"memory[{i}]" in str(caught.value) for i in (1, 2, 7, 8, 9))


@pytest.mark.thorough
def test_contacts_that_the_border_cuts_are_left_out() -> None:
    captures, _ = synthetic_captures(10)
    images, circles = {}, circles_of(captures)
    for i in (1, 3, 8):
        cut = replace(circles[i], u_px=0.4 * circles[i].radius_px)
        images[i] = synthetic.press_image(cut, np.random.default_rng(i))[0]
    kept, _, (remark,) = usable_presses(synthetic.with_images(captures, images))
    assert len(kept.presses) == 7 and "out of the image" in remark.message


@pytest.mark.parametrize(("count", "cut", "most"), [(10, True, 5), (10, False, 4), (30, False, 15)])
def test_how_many_may_be_lost(count: int, cut: bool, most: int) -> None:
    assert not too_many_lost(count, [cut] * most) and too_many_lost(count, [cut] * (most + 1))


CUT = {2: ContactCircle(152.0, 60.0, 15.0), 5: ContactCircle(158.0, 116.0, 14.0)}


def with_cut_presses(count: int) -> CaptureSet:
    """Two presses in circles that the border of the image cuts, labelled there."""
    rng = np.random.default_rng(4)
    images = {i: synthetic.press_image(circle, rng)[0] for i, circle in CUT.items()}
    return with_circles(synthetic.with_images(synthetic_captures(count)[0], images), CUT)


@pytest.mark.thorough
def test_labelled_contacts_that_the_border_cuts_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    captures = with_cut_presses(7)
    used = usable.usable_circles(captures, cache=False)
    assert len(used.circles) == 7 and used.remarks == []
    for i, circle in CUT.items():
        found, sigma_px = used.contacts[i].circle, used.contacts[i].center_sigma_px
        assert found.center_gap_px(circle, GRID) < 1.0 + 3 * sigma_px
        assert found.radius_px == pytest.approx(circle.radius_px, abs=2.0)
    # Without a label nothing says that what is left of it is a contact's.
    _, _, (remark,) = usable_presses(with_circles(captures, [None] * 7))
    assert "2 of 7 presses were left out: p2, p5" in remark.message
    # A contact that the fit loses does not stop the others.
    monkeypatch.setattr(contact_finder, "MIN_LABELLED_VISIBLE", 0.6)
    kept, _, (remark,) = usable_presses(with_cut_presses(10))
    assert "1 of 10 presses were left out: p5" in remark.message and len(kept.presses) == 9


class SearchedAgainError(Exception):
    pass


def searched(*_: object) -> None:
    raise SearchedAgainError


@pytest.fixture
def captures(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> CaptureSet:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    return replace((whole := synthetic_captures(10)[0]), presses=whole.presses[:3])


def test_cached_contacts_are_those_that_were_found(
    captures: CaptureSet, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    usable_presses(captures)
    assert not [*tmp_path.iterdir()]  # Nothing is kept unless asked.
    captures = with_empty_frames(synthetic_captures(10)[0], {4})
    first = usable_presses(captures, cache=True)
    monkeypatch.setattr(usable, "find_contacts", searched)
    again = usable_presses(captures, cache=True)
    assert [asdict(c) for c in again[1]] == [asdict(c) for c in first[1]]
    assert again[2] == first[2] and "p4" in again[2][0].message


def test_what_asks_for_a_search(captures: CaptureSet, monkeypatch: pytest.MonkeyPatch) -> None:
    cached_contacts(captures)
    monkeypatch.setattr(usable, "find_contacts", searched)
    mask = captures.mask.copy()
    mask[0, 0] = not mask[0, 0]
    first, *others = captures.presses
    (circle, *_) = circles_of(captures)
    # The label says whether a contact that the border cuts is one.
    moved = replace(circle, u_px=circle.u_px + 1)
    of_first = {"sha256": "other"}, {"radius_mm": 2.5}, {"checked": True}, {"circle": moved}
    for changes in (
        {"mask": mask},
        {"background": captures.background[:, ::-1]},
        {"ball_radius_mm": 2.5},
        {"grid": replace(captures.grid, mm_per_px_x=0.11)},
        *({"presses": (replace(first, **change), *others)} for change in of_first),
        {"presses": (*others, first)},
    ):
        with pytest.raises(SearchedAgainError):
            cached_contacts(replace(captures, **changes))
    monkeypatch.setattr(usable, "_code_sha256", lambda: "another version")
    with pytest.raises(SearchedAgainError):
        cached_contacts(captures)


@pytest.mark.parametrize("text", ["{", "[]"])
def test_a_damaged_file_is_made_anew(captures: CaptureSet, tmp_path: Path, text: str) -> None:
    found = cached_contacts(captures)
    (kept,) = (path for path in tmp_path.rglob("*") if path.is_file())
    kept.write_text(text)
    with pytest.warns(UserWarning, match="are damaged"):
        assert cached_contacts(captures) == found
    assert cached_contacts(captures) == found


def circles(values: np.ndarray) -> list[ContactCircle]:
    return [ContactCircle(*(float(x) for x in row)) for row in values]


def fused(
    label: np.ndarray, found: np.ndarray, center: float, radius: float
) -> tuple[np.ndarray, tuple[float, float]]:
    """Fused circles [n, 3] of labels and of detected ones that state these standard deviations,
    and the labels' own."""
    placed, sigma_px = fuse_circles(circles(label), contacts(found, center, radius))
    return circle_array(placed), sigma_px


def contacts(values: np.ndarray, center: float, radius: float) -> list[DetectedContact]:
    return [DetectedContact(c, radius, 50.0, center_sigma_px=center) for c in circles(values)]


def drawn(
    count: int, spread: float, rng: np.random.Generator
) -> tuple[np.ndarray, Callable[[float], np.ndarray]]:
    """True circles [n, 3], and noise of their shape."""
    truth = np.column_stack([np.full((count, 2), 100.0), rng.normal(60, spread, count)])
    return truth, lambda sigma: rng.normal(0, sigma, truth.shape)


@pytest.mark.parametrize("true_spread", [0.0, 1.0, 5.0])
def test_fusion_beats_both(true_spread: float) -> None:
    truth, noise = drawn(400, true_spread, np.random.default_rng(0))
    found, _ = fused(truth + noise(2.0), truth + noise(2.0), 2.0, 2.0)
    # Best possible: the posterior spread of two measurements with noise 2 and prior true_spread.
    best = (1 / (2 / 4.0 + 1 / true_spread**2)) ** 0.5 if true_spread else 0.0
    assert (found - truth)[:, 2].std() < best * 1.1 + 0.25
    assert np.std(found[:, 0] - 100) == pytest.approx(2 / np.sqrt(2), rel=0.1)


def test_a_shift_that_all_labels_share_is_taken_off() -> None:
    """Labels 3 px below and 2 px too wide, as on a set of real presses."""
    rng, shift, errors = np.random.default_rng(1), np.array([0.5, -3.0, 2.0]), []
    for _ in range(40):
        truth, noise = drawn(25, 4.0, rng)
        found, label_sigma_px = fused(truth + shift + noise(1.5), truth + noise(0.7), 0.7, 0.7)
        errors.append(found - truth)
        assert label_sigma_px == pytest.approx((1.5, 1.5), rel=0.5)
    # Less than a twelfth of the shift is left; the plain mean of both left a half.
    assert np.abs(np.mean(errors, axis=(0, 1))).max() < 0.25
    assert np.sqrt(np.mean(np.square(errors))) < 0.7


def test_a_press_that_its_label_places_is_off_by_what_is_stated() -> None:
    rng, shift, scores = np.random.default_rng(5), np.array([1.0, -2.0, 1.5]), []
    for _ in range(60):
        truth, noise = drawn(24, 4.0, rng)
        label, found = truth + shift + noise(1.5), truth + noise(0.8)
        placed = circles(fused(label[4:], found[4:], 0.8, 0.8)[0])
        labels = LabelPlacement.of(labelled(circles(label[4:])), placed)
        center, radius = labels.sigma_px((0.8, 0.8))
        held = circle_array([labels.applied(c, 200.0) for c in circles(label[:4])])
        scores.append((held - truth[:4]) / (center, center, radius))
    spread = np.sqrt(np.mean(np.square(scores), axis=(0, 1)))
    assert ((spread > 0.75) & (spread < 1.15)).all()


def labelled(circles: list[ContactCircle]) -> list[CapturedPress]:
    return [CapturedPress("p", "", "", lambda: np.zeros(0), circle) for circle in circles]


def test_labels_that_all_lie_to_one_side_are_shifted_by_what_training_says() -> None:
    rng, off = np.random.default_rng(3), np.array([2.0, -1.5, 1.0])
    truth = circles_of(synthetic_captures(12)[0])
    labels = circles(circle_array(truth) - off + rng.normal(0, 0.3, (12, 3)))
    shift = LabelPlacement.of(labelled(labels), truth)
    assert shift.mean_px == pytest.approx(off, abs=0.3) and shift.count == 12
    assert (shift.deviation_px < 0.6).all() and (shift.deviation_px > 0.1).all()
    label = labels[0]
    assert shift.applied(label, 20.0).u_px == pytest.approx(label.u_px + shift.mean_px[0])
    assert shift.radius_slope == pytest.approx(1.0, abs=0.15)
    assert shift.applied(replace(label, radius_px=30.0), 20.0).radius_px == pytest.approx(20.6)
    nothing = LabelPlacement.of([replace(p, circle=None) for p in labelled(labels)], truth)
    assert nothing.count == 0 and nothing.applied(label, 20.0) == label


def test_radii_that_labels_scatter_are_drawn_to_their_mean() -> None:
    """Labels of equal contacts that differ by hand alone say nothing of a radius."""
    rng = np.random.default_rng(4)
    truth = np.column_stack([np.full((30, 2), 50.0), rng.normal(20.0, 0.2, 30)])
    label = truth + np.outer(rng.normal(1.0, 2.0, 30), (0, 0, 1))
    shift = LabelPlacement.of(labelled(circles(label)), circles(truth))
    assert 0.0 < shift.radius_slope < 0.2 and shift.deviation_px[2] < 0.5
    placed = shift.applied(ContactCircle(50.0, 50.0, 25.0), 40.0)
    assert placed.radius_px == pytest.approx(20.0, abs=1.0)


def test_a_common_error_within_the_stated_one_is_not_blamed_on_the_labels() -> None:
    """Radii that a poor detection finds 6 px too small, and says so: labels are to be believed."""
    truth, noise = drawn(30, 4.0, np.random.default_rng(2))
    found, _ = fused(truth + noise(1.0), truth - (0.0, 0.0, 6.0) + noise(0.5), 0.5, 6.0)
    # A fifth of it, as 3^2 / (3^2 + 6^2), may still be the labels'.
    assert (found - truth)[:, 2].mean() == pytest.approx(-1.2, abs=0.4)


SIZES = st.tuples(st.floats(20, 200), st.floats(20, 200), st.floats(5, 60), st.floats(5, 60))


@given(st.lists(SIZES, min_size=1, max_size=20), st.floats(-5, 5))
def test_moved_labels(rows: list[tuple[float, float, float, float]], move: float) -> None:
    label, found = np.array(rows)[:, :3], np.array(rows)[:, [0, 1, 3]]
    first, second = (fused(label + (by, 0, 0), found, 0.4, 0.4)[0] for by in (0.0, move))
    most = abs(move) * 2 * 0.4**2 / LABEL_SHIFT_PX**2 + 1e-9
    assert np.abs((second - first)[:, 0]).max() <= most


def test_two_presses_lie_where_they_are_found_and_apart_as_both_say() -> None:
    label, found = np.array([(50, 50, 20), (50, 50, 30)]), np.array([(52, 50, 24), (52, 50, 28)])
    both, _ = fused(label, found, 1.0, 1.0)
    # Both scatters are 1 px, and the mean difference is little beside the shift's 3 px.
    assert both[1, 2] - both[0, 2] == pytest.approx((10 + 4) / 2)
    assert both[:, 2].mean() == pytest.approx(26 - 1.0 * (1 + 0.5) / (9 + 2), abs=0.15)
    assert both[:, 0] == pytest.approx([52, 52], abs=0.5)


def test_choice_of_circles() -> None:
    captures = with_circles(synthetic_captures(3)[0], {1: None})
    kept, found, remarks = usable_presses(captures)
    assert kept is captures and len(found) == 3 and remarks == []  # Sound ones stay as they are.
    labels = circles_of(captures)
    chosen = {w: choose_circles(captures, found, w) for w in ("fused", "labels", "detected")}
    assert all(circles[1] == found[1].circle for circles in chosen.values())
    assert chosen["labels"][0] == labels[0] and chosen["detected"][0] == found[0].circle
    assert chosen["fused"][::2] == fuse_circles(labels, [found[0], found[2]])[0]
    with pytest.raises(InputError, match="1 labels do not match 0"):
        fuse_circles([ContactCircle(5, 5, 5)], [])
    with pytest.raises(InputError, match="at least one"):
        fuse_circles([], [])
