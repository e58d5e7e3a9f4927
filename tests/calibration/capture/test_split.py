# SPDX-License-Identifier: Apache-2.0
"""The split into fitted and held-out presses: by names and places, never by pixels."""

from __future__ import annotations

import hashlib
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
    ContactCircle,
    load_capture_folder,
)
from taccel_lab.calibration.capture.split import (
    LARGEST_PLACE,
    SAME_PLACE_RADII,
    PressSplit,
    split_presses,
)
from taccel_lab.errors import InputError
from tests.support.small_captures import write_captures


def unread() -> NoReturn:
    raise AssertionError("a split has looked at an image")


def presses(centers: np.ndarray, labelled: bool = True) -> list[CapturedPress]:
    """Presses p0, p1, ... in circles of 20 px around the places [n, 2]."""
    circles = [ContactCircle(u, v, 20.0) if labelled else None for u, v in centers.tolist()]
    return [CapturedPress(f"p{i}", "p.png", "0" * 64, unread, c) for i, c in enumerate(circles)]


def split_of(some: list[CapturedPress], every: int = 4) -> PressSplit:
    return split_presses(some, every, None, "somewhere")


@given(count=st.integers(1, 40), every=st.integers(-2, 45), labelled=st.booleans())
def test_split_is_a_partition(count: int, every: int, labelled: bool) -> None:
    some = presses(np.random.default_rng(count).uniform(30, 300, (count, 2)), labelled)
    if every < 0 or every == 1 or every > count:
        with pytest.raises(InputError):
            split_of(some, every)
        return
    split = split_of(some, every)
    assert sorted(split.train + split.heldout) == list(range(count))
    if every:
        assert 1 <= len(split.heldout) <= max(1, count // every)
    else:
        assert split.heldout == () and split.by == "nothing"


def test_presses_of_one_place_stay_together() -> None:
    rng = np.random.default_rng(0)
    places = np.array([(u, v) for u in (40.0, 120.0, 200.0) for v in (40.0, 120.0, 200.0)])
    split = split_of(presses(np.repeat(places, 3, axis=0) + rng.uniform(-1, 1, (27, 2))))
    assert split.by == "place" and len(split.heldout) == 6
    assert {i // 3 for i in split.train}.isdisjoint({i // 3 for i in split.heldout})
    alone = split_of(presses(np.full((12, 2), 50.0)))
    assert alone.by == "press" and len(alone.heldout) == 3


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
    split, turned = split_of(presses(centers)), split_of(presses(centers)[::-1])
    assert set(split.heldout) == heldout_by_all_pairs(centers, 20.0, 4)
    assert set(split.heldout_names) == set(turned.heldout_names) and split.sha256 == turned.sha256


@pytest.mark.thorough
def test_memory_goes_with_the_number_of_presses() -> None:
    some = presses(np.random.default_rng(0).uniform(30, 2000, (4000, 2)))
    tracemalloc.start()
    try:
        split_of(some)
        assert tracemalloc.get_traced_memory()[1] < 1000 * len(some)
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(("count", "words"), [
    (1, "holds 1 press, .* --holdout-every 0$"),
    (2, "holds 2 presses, .* --holdout-every 0 or 2$"),
    (3, "--holdout-every 0 or 2 to 3$"),
])  # fmt: skip
def test_too_few_to_hold_out_says_what_is_allowed(count: int, words: str) -> None:
    with pytest.raises(InputError, match=words):
        split_of(presses(np.zeros((count, 2)), labelled=False))


def with_split(folder: Path, text: str) -> Path:
    manifest = write_captures(folder / "captures") / "captures.toml"
    manifest.write_text(manifest.read_text() + f"\n[split]\nheldout = {text}\n")
    return manifest.parent


def test_what_the_manifest_holds_out_is_held_out_and_not_forgotten(tmp_path: Path) -> None:
    folder = with_split(tmp_path, '["p1", "p4"]')
    whole = load_capture_folder(folder)
    split = whole.ball_presses().split(4)
    assert split.heldout == (1, 4) and split.by == "manifest" and split.gone == ()
    assert whole.ball_presses().split(0).heldout == ()
    assert [p.name for p in whole.fitted().presses] == ["p0", "p2", "p3"]
    # Presses of other balls are not missed, those that a person leaves out are.
    other = tuple(replace(p, radius_mm=1.0) if p.name == "p4" else p for p in whole.presses)
    assert replace(whole, presses=other).ball_presses(radius_mm=2.0).split(4).gone == ()
    (folder / "contacts.toml").write_text('[[contact]]\npress = "p4"\nskip = true\n')
    split = load_capture_folder(folder).ball_presses().split(4)
    assert split.heldout_names == ("p1",) and split.gone == ("p4",)


@pytest.mark.parametrize(("text", "words"), [
    ('["p9"]', "holds out p9, but there is no such press"),
    ("[]", r"split\.heldout"),
    ('["p0", "p1", "p2", "p3", "p4"]', "holds out all of the 5 presses"),
])  # fmt: skip
def test_unfit_splits_are_refused(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        load_capture_folder(with_split(tmp_path, text)).split(4)
