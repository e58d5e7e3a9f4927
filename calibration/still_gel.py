# SPDX-License-Identifier: Apache-2.0
"""The untouched gel of a recording, found in frames that stand still.

At rest several frames agree but for their noise. A press that is held stands still, too. Which of
two states is pressed tells the profile, though it is of another unit: read against the untouched
gel, other frames are dents; read against a press, its place stands out. Each state is read both
ways against frames that clearly differ from it, and one is taken only if it is the higher one in
all of these pairs. A recording that never shows the gel at rest may pass for one with its
shallowest press: 5 of 24 made of a Mini's held presses do, and with rests between them all 24 are
read right.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.capture.framing import (
    MIN_CONTACT_LEVELS,
    contact_strength,
    thumb,
)
from taccel_lab.calibration.normals.read_surface import SurfaceReader
from taccel_lab.profile import SensorProfile

MOST_FRAMES = 128
"""Most frames that are compared, evenly picked."""
THUMB_PX = 60
"""Longer side of the small images that are compared."""
NOISE_TIMES, LEAST_LEVELS = 3.0, 2.0
"""Two small images agree up to this multiple of the change of the stillest tenth of the frames, at
least so much [levels], and never where a contact shows (``MIN_CONTACT_LEVELS``)."""
STATES, WITNESSES = 5, 8
"""Still states that are tried, those of most frames first, and frames that each is read against."""
CLEARLY = 0.3
"""Part of the largest change beyond which frames differ clearly."""
AVERAGED = 16
"""Frames that an untouched image is the mean of."""
LEAST_MARGIN, MARGIN_OF_ONE = 0.15, 0.8
"""Least margin, and over how few witnesses: 0.8 of one, 0.4 of two, 0.15 of six and more. The
untouched gel of plain and dotted Minis and of 9DTact is higher than presses by 0.42 to 0.83, 0.19
to 0.70 and 0.20 to 0.36, presses than other presses by -0.47 to 0.62, the least of six by 0.10 at
most."""

Frames = Callable[[], Iterator[tuple[str, np.ndarray]]]
"""Names and RGB levels, shape [height_px, width_px, 3] of the profile; the same each time."""


@dataclass(frozen=True)
class StillGel:
    """The untouched gel of a recording."""

    image: np.ndarray
    """Mean of its frames, RGB levels, float32, shape [height_px, width_px, 3]."""
    names: tuple[str, ...]
    """Names of these frames, in order."""


def find_still_gel(profile: SensorProfile, frames: Frames) -> StillGel | str:
    """The untouched gel, or in words why it is not told."""
    small = _picked(frames)
    if len(small) < 3:
        return f"{len(small)} images of the profile's size"
    numbers = np.array(list(small))
    apart = _distances(list(small.values()))
    states = _states(apart)
    if not states:
        return "no two frames agree but for their noise"
    pairs = [(state, _witnesses(apart, state)) for state in states]
    pairs = [(numbers[state], numbers[others]) for state, others in pairs if len(others)]
    if not pairs:
        return "nothing changes in it"
    images = _read(frames, np.concatenate([np.concatenate(pair) for pair in pairs]))
    best: tuple[float, StillGel] | None = None
    for state, others in pairs:
        own = [images[number] for number in sorted(state)]
        mean = np.asarray(np.mean([image for _, image in own], axis=0, dtype=np.float32))
        margin = _margin(profile, mean, [images[number][1] for number in others])
        if margin > (0.0 if best is None else best[0]):
            best = margin, StillGel(mean, tuple(name for name, _ in own))
    return "what stands still in it may be a press that is held" if best is None else best[1]


def _picked(frames: Frames) -> dict[int, np.ndarray]:
    """Small images by their numbers, evenly picked in one pass, however many there are."""
    step, small = 1, {}
    for number, (_, image) in enumerate(frames()):
        if number % step == 0:
            small[number] = thumb(image, THUMB_PX)
        if len(small) > MOST_FRAMES:
            step *= 2
            small = {n: one for n, one in small.items() if n % step == 0}
    return small


def _read(frames: Frames, wanted: np.ndarray) -> dict[int, tuple[str, np.ndarray]]:
    """Names and whole images of these numbers."""
    left, found = set(wanted.tolist()), {}
    for number, frame in enumerate(frames()):
        if number in left:
            found[number] = frame
            left.remove(number)
        if not left:
            break
    return found


def _distances(small: Sequence[np.ndarray]) -> np.ndarray:
    """Strongest change between two of them [levels], shape [frame, frame]."""
    apart = np.zeros((len(small), len(small)))
    for i, one in enumerate(small):
        for j in range(i):
            apart[i, j] = apart[j, i] = contact_strength(one - small[j])
    return apart


def _states(apart: np.ndarray) -> list[np.ndarray]:
    """Indices of frames that agree with one of them, the state of most frames first."""
    others = apart + np.diag(np.full(len(apart), np.inf))
    noise = float(np.quantile(others.min(axis=1), 0.1))
    near = apart <= min(max(NOISE_TIMES * noise, LEAST_LEVELS), MIN_CONTACT_LEVELS)
    free, states = np.ones(len(apart), dtype=bool), []
    while len(states) < STATES:
        sizes = (near & free).sum(axis=1) * free
        middle = int(np.argmax(sizes))
        if sizes[middle] < 2:
            break
        own = np.flatnonzero(near[middle] & free)
        free[own] = False
        states.append(own[np.argsort(apart[middle, own], kind="stable")][:AVERAGED])
    return states


def _witnesses(apart: np.ndarray, state: np.ndarray) -> np.ndarray:
    """Indices of frames that clearly differ from a state and from one another, weak presses and
    strong ones."""
    away = apart[state].min(axis=0)
    least = max(2 * MIN_CONTACT_LEVELS, CLEARLY * float(away.max()))
    clear = np.flatnonzero(away > least)
    distinct: list[int] = []
    for index in clear[np.argsort(away[clear], kind="stable")]:
        if all(apart[index, other] > least for other in distinct):
            distinct.append(int(index))
    count = min(WITNESSES, len(distinct))
    return np.array(distinct, dtype=int)[np.linspace(0, len(distinct) - 1, count).astype(int)]


def _margin(profile: SensorProfile, rest: np.ndarray, others: Sequence[np.ndarray]) -> float:
    """How clearly ``rest`` is higher than all others: the least of its net rises above one of them
    less that the other way, as a part of all that rises or sinks; 0 where that is not clear."""
    needed, least = max(LEAST_MARGIN, MARGIN_OF_ONE / len(others)), 1.0
    for other in others:
        up, moved_up = _net_rise(profile, other, rest)
        down, moved_down = _net_rise(profile, rest, other)
        least = min(least, (up - down) / max(moved_up + moved_down, 1e-12))
        if least < needed:
            return 0.0
    return least


def _net_rise(
    profile: SensorProfile, background: np.ndarray, image: np.ndarray
) -> tuple[float, float]:
    """Sums over the pixels of the rise of an image above a background, and of its size.

    Both of squares [mm2]: a contact is deep, what surrounds it wide.
    """
    reader = SurfaceReader(profile, background=background)
    lit = reader.lit(image)
    rise_mm = 1e3 * reader.read_lit(lit, uncertainty=False).rise_m
    return float((rise_mm * np.abs(rise_mm)).sum()), float(np.square(rise_mm).sum())
