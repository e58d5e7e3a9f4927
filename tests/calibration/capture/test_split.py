# SPDX-License-Identifier: Apache-2.0
"""The split into fitted and held-out presses: by names and places, never by pixels."""

from __future__ import annotations

import hashlib
import re
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import NoReturn

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse.csgraph import connected_components

from taccel_lab.calibration.capture import (
    CapturedPress,
    CaptureSet,
    ContactCircle,
    ImportOptions,
    import_captures,
    load_capture_folder,
)
from taccel_lab.calibration.capture.captures import LARGEST_PLACE, SAME_PLACE_RADII, split_presses
from taccel_lab.errors import InputError
from tests.calibration.capture.made_up_layouts import picture
from tests.support.small_captures import write_captures


def unread() -> NoReturn:
    raise AssertionError("a split has looked at an image")


def press(name: str, circle: ContactCircle | None = None) -> CapturedPress:
    return CapturedPress(name, f"{name}.png", "0" * 64, unread, circle)


def presses(centers: np.ndarray, radius_px: float = 20.0) -> list[CapturedPress]:
    return [
        press(f"p{i}", ContactCircle(float(u), float(v), radius_px))
        for i, (u, v) in enumerate(centers)
    ]


@given(count=st.integers(1, 40), every=st.integers(-2, 45), labelled=st.booleans())
def test_split_is_a_partition(count: int, every: int, labelled: bool) -> None:
    centers = np.random.default_rng(count).uniform(30, 300, (count, 2))
    some = presses(centers) if labelled else [press(f"p{i}") for i in range(count)]
    if every < 0 or every == 1 or every > count:
        with pytest.raises(InputError):
            split_presses(some, every, None, "somewhere")
        return
    split = split_presses(some, every, None, "somewhere")
    assert sorted(split.train + split.heldout) == list(range(count))
    if every:
        assert 1 <= len(split.heldout) <= max(1, count // every)
    else:
        assert split.heldout == () and split.by == "nothing"


def test_presses_of_one_place_stay_together() -> None:
    rng = np.random.default_rng(0)
    places = np.array([(u, v) for u in (40.0, 120.0, 200.0) for v in (40.0, 120.0, 200.0)])
    some = presses(np.repeat(places, 3, axis=0) + rng.uniform(-1, 1, (27, 2)))
    split = split_presses(some, 4, None, "somewhere")
    assert split.by == "place" and len(split.heldout) == 6
    assert {i // 3 for i in split.train}.isdisjoint({i // 3 for i in split.heldout})


def heldout_by_all_pairs(centers: np.ndarray, radius_px: float, every: int) -> set[int]:
    """The rule by the matrix of all distances, as published scores were made with."""
    apart = np.linalg.norm(centers[:, None] - centers[None], axis=-1)
    count, place_of = connected_components(apart < SAME_PLACE_RADII * radius_px, directed=False)
    places = [np.flatnonzero(place_of == k).tolist() for k in range(count)]
    if max(map(len, places)) > LARGEST_PLACE * len(centers):
        places = [[i] for i in range(len(centers))]

    def lot(place: list[int]) -> str:
        return hashlib.sha256("\n".join(sorted(f"p{i}" for i in place)).encode()).hexdigest()

    places.sort(key=lot)
    held: list[int] = []
    for place in places:
        held += place if len(held) + len(place) <= len(centers) // every else []
    return set(held or min(places, key=len))


@given(seed=st.integers(0, 10**6), count=st.integers(8, 60), spread=st.sampled_from([1, 8, 30, 90]))
def test_the_split_is_that_of_all_pairs(seed: int, count: int, spread: int) -> None:
    # Whole steps, so that many distances are equal, and some are the limit itself.
    centers = np.random.default_rng(seed).integers(0, spread, (count, 2)) + 50.0
    split = split_presses(presses(centers), 4, None, "somewhere")
    assert set(split.heldout) == heldout_by_all_pairs(centers, 20.0, 4)


@pytest.mark.thorough
def test_memory_goes_with_the_number_of_presses() -> None:
    some = presses(np.random.default_rng(0).uniform(30, 2000, (4000, 2)))
    tracemalloc.start()
    try:
        split_presses(some, 4, None, "somewhere")
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 1000 * len(some)


def test_the_order_of_the_presses_has_no_say() -> None:
    some = presses(np.random.default_rng(1).uniform(0, 300, (20, 2)))
    split = split_presses(some, 4, None, "somewhere")
    turned = split_presses(some[::-1], 4, None, "somewhere")
    assert set(split.heldout_names) == set(turned.heldout_names) and split.sha256 == turned.sha256


def test_one_place_alone_is_split_by_press() -> None:
    some = presses(np.full((12, 2), 50.0))
    split = split_presses(some, 4, None, "somewhere")
    assert split.by == "press" and len(split.heldout) == 3


@pytest.mark.parametrize(
    ("count", "words"),
    [
        (1, "holds 1 press, .* holdout_every of 0$"),
        (2, "holds 2 presses, .* holdout_every of 0 or 2$"),
        (3, "holdout_every of 0 or 2 to 3$"),
    ],
)
def test_too_few_to_hold_out_says_what_is_allowed(count: int, words: str) -> None:
    with pytest.raises(InputError, match=words):
        split_presses([press(f"p{i}") for i in range(count)], 4, None, "somewhere")


def with_split(folder: Path, text: str) -> Path:
    manifest = folder / "captures.toml"
    manifest.write_text(manifest.read_text() + f"\n[split]\nheldout = {text}\n")
    return folder


def test_what_the_manifest_holds_out_is_held_out(tmp_path: Path) -> None:
    folder = with_split(write_captures(tmp_path / "captures"), '["p1", "p4"]')
    captures = load_capture_folder(folder).ball_presses()
    split = captures.split(4)
    assert split.heldout == (1, 4) and split.by == "manifest" and split.gone == ()
    assert captures.split(0).heldout == ()
    assert [p.name for p in load_capture_folder(folder).fitted().presses] == ["p0", "p2", "p3"]


def test_a_held_out_press_that_is_left_out_later_is_not_forgotten(tmp_path: Path) -> None:
    folder = with_split(write_captures(tmp_path / "captures"), '["p1", "p4"]')
    (folder / "contacts.toml").write_text('[[contact]]\npress = "p4"\nskip = true\n')
    split = load_capture_folder(folder).ball_presses().split(4)
    assert split.heldout_names == ("p1",) and split.gone == ("p4",)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('["p9"]', "holds out p9, but there is no such press"),
        ("[]", re.escape("split.heldout")),
        ('["p0", "p1", "p2", "p3", "p4"]', "holds out all of the 5 presses"),
    ],
)
def test_unfit_splits_are_refused(tmp_path: Path, text: str, words: str) -> None:
    folder = with_split(write_captures(tmp_path / "captures"), text)
    with pytest.raises(InputError, match=words):
        load_capture_folder(folder).split(4)


def test_presses_of_other_balls_are_not_missed(tmp_path: Path) -> None:
    folder = with_split(write_captures(tmp_path / "captures"), '["p1", "p4"]')
    whole = load_capture_folder(folder)
    other = tuple(replace(p, radius_mm=1.0) if p.name == "p4" else p for p in whole.presses)
    captures: CaptureSet = replace(whole, presses=other).ball_presses(radius_mm=2.0)
    assert captures.split(4).gone == ()


def test_importing_freezes_the_split(tmp_path: Path) -> None:
    source = tmp_path / "source"
    source.mkdir()
    for i in range(8):
        picture(source / f"press_{i}.png", level=80 + i)
    picture(source / "background.png")
    options = ImportOptions(sensor="gelsight_mini", radius_mm=2.0, mm_per_px_x=0.05)
    (folder,) = import_captures(source, tmp_path / "captures", options=options)
    captures = load_capture_folder(folder)
    assert captures.heldout is not None and len(captures.heldout) == 2
    assert captures.split().by == "manifest"
    fewer = replace(captures, heldout=None).split()
    assert fewer.heldout_names == captures.heldout
