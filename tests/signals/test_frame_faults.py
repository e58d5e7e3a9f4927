# SPDX-License-Identifier: Apache-2.0
"""Faults of frames: each by its closed form, drawn by seed alone, with labels that are true."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.profile import PerturbationBlock
from taccel_lab.signals import frame_operators as operators
from taccel_lab.signals.faulty_frames import FaultyFrames
from taccel_lab.signals.frame_faults import KINDS, FrameFaults, kinds_of
from taccel_lab.signals.frame_operators import BITS
from taccel_lab.signals.perturbation import draw_perturbation
from taccel_lab.signals.perturbed_sensors import PerturbedSensors
from tests.support.sample_blocks import ASSUMED

HEIGHT, WIDTH = 24, 40
IMAGES = np.random.default_rng(0).integers(20, 200, (8, HEIGHT, WIDTH, 3)).astype(np.uint8)
ONE, BEFORE = IMAGES[1], IMAGES[0]
ROWS = np.arange(HEIGHT)[:, None, None]
ACROSS = np.linspace(-1, 1, WIDTH)[None, :, None]
DOWN = np.linspace(-1, 1, HEIGHT)[:, None, None]


def sine(periods: float, phase: float) -> np.ndarray:
    return np.sin(2 * np.pi * (periods * ROWS / HEIGHT + phase))


OPERATORS: dict[str, tuple[np.ndarray, np.ndarray]] = {
    "lost_rows": (operators.lost_rows(ONE, 15), np.where(ROWS < 15, ONE, 128)),
    "green rows": (
        operators.lost_rows(ONE, 15, operators.GREEN), np.where(ROWS < 15, ONE, (0, 135, 0)),
    ),
    "shift": (operators.shift(ONE, -7), np.roll(ONE, -7, axis=1)),
    "torn sideways": (
        operators.torn(ONE, 9, px=5), np.where(ROWS < 9, ONE, np.roll(ONE, 5, axis=1)),
    ),
    "torn": (operators.torn(ONE, 9, before=BEFORE), np.where(ROWS < 9, ONE, BEFORE)),
    "stuck": (operators.stuck(IMAGES, 3, 2), IMAGES[[0, 1, 2, 2, 2, 5, 6, 7]]),
    "delay": (operators.delay(IMAGES, 2), IMAGES[[0, 0, 0, 1, 2, 3, 4, 5]]),
    "drift": (
        operators.drift(ONE, (1.1, 1, 0.9), (3, 0, -2), (4, 0, 0), (0, -6, 0)),
        ONE * [1.1, 1, 0.9] + [3, 0, -2] + ACROSS * [4, 0, 0] + DOWN * [0, -6, 0],
    ),
    "wear": (
        operators.wear(ONE, 0.06, (0.3, -0.2), 0.25),
        ONE * (1 + 0.06 * np.exp(-0.5 * ((ACROSS - 0.3) ** 2 + (DOWN + 0.2) ** 2) / 0.25**2)),
    ),
    "dead_lamp": (operators.dead_lamp(ONE, 0), ONE * [0.08, 1, 1]),
    "bands": (operators.bands(ONE, 0.03, 3.0, 0.21), ONE * (1 + 0.03 * sine(3.0, 0.21))),
}  # fmt: skip


@pytest.mark.parametrize("kind", OPERATORS)
def test_an_operator_does_what_its_formula_says(kind: str) -> None:
    found, expected = OPERATORS[kind]
    assert found.dtype == np.uint8
    # Light is rounded: 0.5, and what FP32 leaves of it.
    exact = kind.split()[0] in ("lost_rows", "green", "shift", "torn", "stuck", "delay")
    assert np.abs(found - expected).max() <= (0 if exact else 0.5001)


def test_levels_that_are_no_bytes_stay_such() -> None:
    levels = ONE.astype(np.float64) + 0.25
    worn = operators.wear(levels, -0.3, (float(ACROSS[0, 20, 0]), float(DOWN[12, 0, 0])))
    assert worn[12, 20] / levels[12, 20] == pytest.approx(0.7, rel=1e-5)
    assert (operators.shift(levels, 3) == np.roll(levels, 3, axis=1)).all()


def cameras(faults: FrameFaults, count: int = 1, **options: Any) -> FaultyFrames:
    return FaultyFrames(faults, (WIDTH, HEIGHT), count, **options)


def ints(values: Any) -> wp.array:
    return wp.array(np.asarray(values), dtype=wp.int32, device="cpu")


def shown(
    frames: FaultyFrames, seeds: list[int], number: int, images: np.ndarray, episode: int = 1
) -> np.ndarray:
    """Frames of cameras that all look at one image each, uint8."""
    frames.draw(ints(seeds), ints([episode] * len(seeds)), ints([number] * len(seeds)))
    lit = frames.lit(wp.array(images.astype(np.float32), device="cpu")).numpy()
    return frames.sent(wp.array(np.rint(lit.clip(0, 255)).astype(np.uint8), device="cpu")).numpy()


ALL = FrameFaults.of(dict.fromkeys(KINDS, 0.4))


def run(faults: FrameFaults, seeds: list[int], episode: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """What the sequence of images becomes, and its labels."""
    frames = cameras(faults, len(seeds))
    found = [
        (shown(frames, seeds, k, IMAGES[k : k + 1].repeat(len(seeds), 0), episode), frames.labels())
        for k in range(len(IMAGES))
    ]
    images, labels = zip(*found, strict=True)
    return np.stack(images, 1), np.stack(labels, 1)


def test_faults_are_those_of_a_seed_whoever_is_beside() -> None:
    many, labels = run(ALL, [5, 11, 12, 13])
    again, _ = run(ALL, [5, 11, 12, 13])
    alone, label = run(ALL, [12])
    assert (many == again).all() and (alone[0] == many[2]).all() and (label[0] == labels[2]).all()
    assert not (many[0] == many[1]).all() and not (run(ALL, [12], 2)[1] == label).all()


def test_a_kind_is_drawn_alike_beside_others() -> None:
    alone = run(FrameFaults(lost_rows=0.4, drift=0.4), list(range(40)))[1]
    beside = run(ALL, list(range(40)))[1]
    fresh = beside["kinds"] & BITS["stuck"] == 0
    assert (alone["lost_from_row"] == beside["lost_from_row"])[fresh].all()
    fresh &= beside["kinds"] & BITS["delay"] == 0
    assert (alone["drift_gain"] == beside["drift_gain"])[fresh].all() and fresh.sum() > 20


@pytest.mark.parametrize("kind", KINDS)
def test_chances_are_kept_and_labels_are_true(kind: str) -> None:
    """An operator by the label's numbers gives the frame; without a label it keeps its bits."""
    seeds = list(range(60))
    images, labels = run(FrameFaults.of({kind: 0.3}), seeds)
    has = labels["kinds"] == BITS[kind]
    assert (has | (labels["kinds"] == 0)).all()
    whole = IMAGES[None].repeat(60, 0)
    assert (images[~has] == whole[~has]).all()
    part = has[:, 4].mean()
    # A stuck one comes again up to 12 times.
    assert 0.12 < part < 0.5 or (kind == "stuck" and 0.4 < part < 0.95)
    for row, k in np.argwhere(has).tolist():
        one = labels[row, k]
        assert np.abs(images[row, k].astype(int) - by_label(kind, one, k)).max() <= 1
        assert kinds_of(int(one["kinds"])) == (kind,)


def by_label(kind: str, one: Any, k: int) -> np.ndarray:
    """The k-th image with the fault that its label says."""
    image = IMAGES[k]
    if kind == "lost_rows":
        return operators.lost_rows(image, int(one["lost_from_row"]), one["lost_level"])
    if kind == "shift":
        return operators.shift(image, int(one["shift_px"]))
    if kind == "torn":
        px, row = int(one["torn_px"]), int(one["torn_from_row"])
        return operators.torn(image, row, px=px, before=None if px else IMAGES[k - 1])
    if kind in ("stuck", "delay"):
        return IMAGES[k - int(one[f"{kind}_frames"])]
    if kind == "drift":
        light = (one[f"drift_{name}"] for name in ("levels", "right", "down"))
        return operators.drift(image, 1 + one["drift_gain"], *light)
    if kind == "wear":
        middle = (float(one["wear_across"]), float(one["wear_down"]))
        return operators.wear(image, one["wear_gain"], middle, one["wear_radius"])
    if kind == "bands":
        return operators.bands(image, one["band_depth"], one["band_periods"], one["band_phase"])
    channel = int(np.argmin(one["lamp_left"]))
    return operators.dead_lamp(image, channel, one["lamp_left"][channel])


def test_numbers_stay_in_their_ranges() -> None:
    faults = FrameFaults(
        lost_rows=1.0, lost_from=(0.5, 0.6), shift=1.0, shift_width=(0.1, 0.2), drift=1.0,
        drift_gain=(0.1, 0.2), drift_frames=(4, 4), dead_lamp=1.0, lamp_left=(0.5, 0.6),
    )  # fmt: skip
    labels = run(faults, list(range(50)))[1]
    assert set(np.unique(labels["lost_from_row"])) == {12, 13, 14}
    sizes = np.abs(labels["shift_px"])
    assert set(np.unique(sizes)) == {4, 5, 6, 7, 8} and (labels["shift_px"] < 0).any()
    assert labels["drift_gain"][:, 0] * 4 == pytest.approx(labels["drift_gain"][:, 3], rel=1e-5)
    assert 0.1 <= labels["drift_gain"][:, 3:].min() and labels["drift_gain"].max() <= 0.2
    assert (labels["drift_gain"][:, 3] == labels["drift_gain"][:, 7]).all()
    assert set(labels["lamp_left"].argmin(axis=-1).ravel()) == {0, 1, 2}
    assert 0.5 <= labels["lamp_left"].min() <= 0.6 and (labels["lamp_left"] == 1).mean() > 0.6


def test_late_frames_have_the_light_of_their_time() -> None:
    growing = {"drift": 1.0, "drift_frames": (6, 6), "drift_gain": (0.1, 0.2), "bands": 1.0}
    images, labels = run(FrameFaults.of(growing), [1, 2, 3])
    late = FrameFaults.of({**growing, "delay": 1.0, "delay_frames": (2, 2)})
    seen, told = run(late, [1, 2, 3])
    assert (seen[:, 2:] == images[:, :-2]).all() and (told["delay_frames"][:, 2:] == 2).all()
    for name in ("drift_gain", "band_phase"):
        assert (told[name][:, 2:] == labels[name][:, :-2]).all()
    # Bands roll by the same part of a period from frame to frame.
    roll = np.diff(labels["band_phase"], axis=1) % 1
    assert roll == pytest.approx(roll[:, :1].repeat(7, 1), abs=1e-5) and np.ptp(roll[:, 0]) > 0.01


EARLIER = FrameFaults(delay=1.0, delay_frames=(3, 3), stuck=0.3, torn=0.5, torn_before=1.0)


def test_a_frame_that_is_read_again_is_the_same() -> None:
    frames, once = cameras(EARLIER, 3), run(EARLIER, [1, 2, 3])[0]
    for k in range(8):
        for _ in range(2):
            assert (shown(frames, [1, 2, 3], k, IMAGES[k : k + 1].repeat(3, 0)) == once[:, k]).all()


@pytest.mark.parametrize(("episode", "number"), [(2, 0), (1, 0), (2, 5)])
def test_new_episodes_know_no_frame_of_old_ones(episode: int, number: int) -> None:
    """A new one, or the same from its beginning, or one that is looked at late; also while another
    camera's goes on."""
    frames = cameras(EARLIER, 2)
    for k in range(5):
        shown(frames, [1, 2], k, np.stack([IMAGES[k]] * 2))
    first = np.full_like(ONE, 77)
    frames.draw(ints([1, 2]), ints([episode, 1]), ints([number, 5]))
    both = np.stack([first, IMAGES[5]])
    seen = frames.sent(wp.array(both, device="cpu")).numpy()
    assert (seen[0] == first).all() and frames.labels()["kinds"][0] == 0
    assert (seen[1] == run(EARLIER, [2])[0][0, 5]).all()
    second = shown(frames, [1, 2], 6, np.stack([ONE, IMAGES[6]]), episode)
    assert (second[0] == first).all()  # Late, by all that there are.


def test_frames_before_the_first_stay_whole() -> None:
    frames = cameras(FrameFaults(lost_rows=1.0, wear=1.0, drift=1.0, stuck=1.0), first=1)
    assert (shown(frames, [3], 0, IMAGES[:1])[0] == IMAGES[0]).all()
    assert not frames.kinds.numpy().any()
    assert (shown(frames, [3], 1, IMAGES[1:2])[0] == IMAGES[0]).all()
    assert kinds_of(int(frames.kinds.numpy()[0])) == ("stuck",)


def test_cameras_of_an_environment_differ() -> None:
    frames = cameras(ALL, 1, cameras=2)
    frames.draw(ints([4]), ints([1]), ints([2]))
    one, other = frames.labels()
    assert one != other


def sensors(count: int = 2, **faults: Any) -> PerturbedSensors:
    block = PerturbationBlock(noise_levels=1.0, provenance=ASSUMED)
    given = FrameFaults(**faults)
    drawn = draw_perturbation(block, count, np.random.default_rng(0), frame_faults=given)
    return PerturbedSensors(drawn)


def test_perturbed_sensors_have_faults_of_frames() -> None:
    """Light below the noise, lost rows above it; numpy gives what torch gives."""
    images = np.full((2, HEIGHT, WIDTH, 3), 100.0, dtype=np.float32)
    by_numpy, by_torch = (sensors(lost_rows=1.0, dead_lamp=1.0, lamp_left=(0, 0)) for _ in "ab")
    seen = by_numpy.apply(images, np.random.default_rng(1))
    again = by_torch.apply(torch.from_numpy(images), np.random.default_rng(1))
    assert (again.numpy() == seen).all()
    for image, label in zip(seen, by_numpy.labels(), strict=True):
        first, dead = int(label["lost_from_row"]), int(label["lamp_left"].argmin())
        assert (image[first:] == label["lost_level"]).all()
        assert 0.2 < image[:first, :, dead].std() < 1 and image[:first, :, dead].min() == 0
        assert abs(image[:first, :, dead - 1].mean() - 100) < 0.2


def test_sensors_that_are_reset_forget_their_frames() -> None:
    late = sensors(delay=1.0, delay_frames=(2, 2))
    level = [np.full((2, 4, 5, 3), k, dtype=np.float32) for k in range(40, 46)]
    seen = [late.apply(image)[:, 0, 0, 0].tolist() for image in level[:4]]
    assert seen == [[40, 40], [40, 40], [40, 40], [41, 41]]
    late.reset(np.array([True, False]))
    assert late.apply(level[4])[:, 0, 0, 0].tolist() == [44, 42]
    assert late.labels()["delay_frames"].tolist() == [0, 2]
    growing = sensors(drift=1.0, drift_frames=(4, 4), drift_gain=(0.2, 0.2))
    for image in level[:2]:
        growing.apply(image)
    growing.reset(np.array([True, False]))
    growing.apply(level[2])
    assert growing.labels()["drift_gain"][:, 0] == pytest.approx([0.05, 0.15])


def test_without_chances_bits_stay_and_nothing_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    images = IMAGES[:2].astype(np.float32)
    without = sensors().apply(images, np.random.default_rng(1))
    rare = sensors(lost_rows=1e-9, drift=1e-9, stuck=1e-9).apply(images, np.random.default_rng(1))
    assert (without == rare).all()
    monkeypatch.setattr(FaultyFrames, "draw", None)
    assert (sensors().apply(images, np.random.default_rng(1)) == without).all()
    assert not FrameFaults() and not sensors().labels()["kinds"].any()
    taxels = np.zeros((2, 4, 5, 1))
    assert (sensors(lost_rows=1.0).apply(taxels) == 0).all()


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"lost_row": 0.1}, r"no fault 'lost_row' \(did you mean lost_rows\?\)"),
        ({"shift": 1.5}, r"shift must lie in \[0, 1\], got 1.5"),
        ({"shift": True}, "shift must be a number, got True"),
        ({"wear_gain": 0.1}, r"wear_gain must be \[low, high\], got 0.1"),
        ({"wear_gain": [0.2, "a"]}, r"wear_gain must be \[low, high\]"),
        ({"wear_gain": [0.2, True]}, r"wear_gain must be \[low, high\]"),
        ({"wear_gain": [[1], [1, 2]]}, r"wear_gain must be \[low, high\]"),
        ({"wear": [0.1]}, "wear must be a number"),
        ({"wear": 10**400}, "wear must be a number"),
        ({"wear": float("nan")}, "wear must be a number"),
        ({"wear_gain": [0.2, 0.1]}, "wear_gain is 0.2 to 0.1; -1 to 10 is allowed"),
        ({"delay_frames": [1, 2.5]}, "whole numbers are allowed"),
        ({"delay_frames": [1, 99]}, "delay_frames is 1 to 99; 1 to 16 is allowed"),
        (0.1, "faults are a table of chances and ranges, got 0.1"),
    ],
)
def test_bad_faults_are_refused(given: Any, words: str) -> None:
    with pytest.raises(InputError, match=words):
        FrameFaults.of(given)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: operators.lost_rows(ONE, 24), r"first_row must lie in \[0, 23\], got 24"),
        (lambda: operators.torn(ONE, 3), "torn needs either px, not 0, or the frame before"),
        (lambda: operators.shift(ONE[..., 0], 3), "image must have shape"),
        (lambda: operators.dead_lamp(ONE, 3), "channel must lie in"),
    ],
)
def test_bad_arguments_are_refused(call: Any, words: str) -> None:
    with pytest.raises(InputError, match=words):
        call()
