# SPDX-License-Identifier: Apache-2.0
"""The smallest touch that is seen on a sensor, beside what its untouched gel reads: a zero that is
bought by blindness is no zero.

Untouched frames are made of captured presses: the background in the light of one, with its noise
(what is left of it within ``NOISE_PX``), where the press is that of another part of the frame. A
touch adds the change of colours that the profile's own model gives for a ball that is pressed into
a bonded layer by its law, at a random place that captured presses span, before the sum is rounded
to levels. It is seen where the reading states a depth and a force whose 95 % intervals leave out 0.
Colours and law are those of the calibration: what these have wrong at shallow slopes is not in the
figure.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np

from taccel_lab.api.read import Reader
from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import eight_bit
from taccel_lab.networks.normal_settings import NormalModelConfig
from taccel_lab.profile import SensorProfile
from taccel_lab.reading.bonded_layer import BondedLayer, press_layer
from taccel_lab.reading.frame_judge import FrameJudge
from taccel_lab.reading.light import LightDrift
from taccel_lab.reading.reading import Reading
from taccel_lab.signals.height_image import levels_of_heights
from taccel_lab.signals.rest_surface import rest_surface
from taccel_lab.tasks.result import success_interval

BALL_MM = 4.0
SHARE = 0.95
"""Part of the touches that are seen at the stated depth, and of the untouched frames whose force
reads as stated at most."""
NOISE_PX = 5.0
"""Standard deviation of the window that noise is taken within: what is wider is light or gel."""
SEEN_LEVELS = 4.0
"""Change within such a window that is a press, whether it reads as touched or not."""
AROUND_PX = 20
"""Pixels around either whose noise is that of a press, too."""
TOUCHES = 80
"""Touches, and untouched frames: from 73 on the interval of the depth has an upper end."""
DEPTHS_MM = np.geomspace(0.01, 0.64, 64)
"""Depths that are compared: steps of 7 %."""
POINTS = 320
"""Points at most along the grid that balls are pressed on, twice as wide as the view."""
MARGIN_MM = 1.5
"""Least distance of a ball's middle from the border of the view."""


@dataclass(frozen=True)
class UntouchedFrame:
    """A frame that nothing touches."""

    levels: np.ndarray
    """RGB, float, shape [height_px, width_px, 3]."""
    light: LightDrift
    """Its own light, against the background."""

    def touched(self, change: np.ndarray) -> np.ndarray:
        """The same with a change of levels in the background's light, uint8."""
        return eight_bit(self.levels + self.light.gain * change)


class Balls:
    """Changes of a sensor's levels by balls pressed into its gel."""

    def __init__(self, profile: SensorProfile) -> None:
        self.profile, self.grid = profile, profile.grid()
        self._rest_m = rest_surface(profile.mesh, self.grid).height_m
        self._untouched = levels_of_heights(profile, self._rest_m)
        self._size_mm = np.array(
            [
                self.grid.width_px * self.grid.mm_per_px_x,
                self.grid.height_px * self.grid.mm_per_px_y,
            ]
        )
        self.rise_mm = lru_cache(maxsize=None)(self._rise_mm)
        """Rise [mm] by a ball of a depth [mm] in the middle of a view of twice the size, [h, w]."""

    def change(self, depth_mm: float, at: Sequence[float] | np.ndarray) -> np.ndarray:
        """Change of levels, float, [height_px, width_px, 3], by a ball whose middle lies ``at``
        parts of the view's width and height, but for a margin."""
        rise_mm = self.rise_mm(depth_mm)
        margin = MARGIN_MM / self._size_mm
        place = np.clip(at, margin, 1 - margin)
        part = []
        for side, along in zip(rise_mm.shape, place[::-1], strict=True):
            first = round((1 - along) * side / 2)
            part.append(slice(first, first + side // 2))
        size = self.grid.width_px, self.grid.height_px
        rise_m = 1e-3 * cv2.resize(rise_mm[tuple(part)], size, interpolation=cv2.INTER_CUBIC)
        return levels_of_heights(self.profile, self._rest_m + rise_m) - self._untouched

    def _rise_mm(self, depth_mm: float) -> np.ndarray:
        gel = self.profile.gel
        layer = BondedLayer(gel.thickness_mm, self.profile.material.poisson_ratio)
        counts = self.grid.width_px, self.grid.height_px
        every = max(1, -(-2 * max(counts) // POINTS))
        columns, rows = (2 * (count // every) for count in counts)
        steps = 2 * self._size_mm / (columns, rows)
        x = (np.arange(columns) + 0.5 - columns / 2) * steps[0]
        y = (np.arange(rows) + 0.5 - rows / 2) * steps[1]
        square = np.minimum(x[None, :] ** 2 + y[:, None] ** 2, 0.9 * BALL_MM**2)
        ball = BALL_MM - np.sqrt(BALL_MM**2 - square)
        return press_layer(ball, depth_mm, (float(steps[0]), float(steps[1])), layer).rise_mm


def untouched_frames(
    background: np.ndarray, images: Sequence[np.ndarray], reader: Reader
) -> list[UntouchedFrame]:
    """Untouched frames in the light and with the noise of presses.

    Args:
        background: The untouched sensor, RGB levels, shape [height_px, width_px, 3].
        images: Presses, likewise; those that are refused are left out.
        reader: Tells where they touch.
    """
    judge, found = FrameJudge(background.astype(np.float32)), []
    size = 2 * AROUND_PX + 1
    for image in images:
        try:
            touched = reader(image).touch.pixels
        except InputError:
            continue
        if not touched.any():
            continue
        light = judge.frame(image).pressed
        shown = light.apply(background.astype(np.float32))
        off = image - shown
        smooth = cv2.GaussianBlur(off, (0, 0), NOISE_PX)
        noise = off - smooth
        touched |= np.abs(smooth).max(axis=-1) > SEEN_LEVELS
        touched = cv2.dilate(touched.astype(np.uint8), np.ones((size, size), np.uint8)) > 0
        moves = itertools.product(*(range(0, side, max(1, side // 8)) for side in touched.shape))
        # The part of the frame that lies over the press once it is moved so.
        best = min(moves, key=lambda move: (touched & np.roll(touched, move, (0, 1))).sum())
        elsewhere = np.roll(noise, best, (0, 1))
        still_pressed = touched & np.roll(touched, best, (0, 1))
        noise = np.where(touched[..., None], elsewhere, noise)
        found.append(UntouchedFrame(shown + np.where(still_pressed[..., None], 0.0, noise), light))
    return found


def excludes_zero(found: Reading) -> bool:
    """Whether the intervals of depth and force leave out 0."""
    if not found.touch.any or found.depth_interval_mm is None or found.depth_interval_mm[0] <= 0:
        return False
    force = None if found.press is None else found.force_interval_n
    return force is None or force[0] > 0


def _places(profile: SensorProfile) -> Iterator[np.ndarray]:
    """Places of the view, as of ``Balls.change``, that captured presses span: elsewhere a profile
    states that it knows little."""
    assert profile.normals is not None
    away = NormalModelConfig.from_dict(profile.normals.architecture).away()
    rng = np.random.default_rng(0)
    while True:
        at = rng.uniform(0, 1, 2)
        row, column = (at[::-1] * away.shape).astype(int)
        if away[row, column] == 0:
            yield at


def touch_figures(
    profile: SensorProfile,
    background: np.ndarray,
    images: Sequence[np.ndarray],
    count: int = TOUCHES,
) -> dict[str, Any]:
    """Figures of a profile that tells colours and depths.

    Args:
        profile: Of the sensor.
        background: It untouched, RGB levels, shape [height_px, width_px, 3].
        images: Presses on it, whose light and noise untouched frames have.
        count: Touches, and untouched frames at most.

    Returns:
        ``smallest_mm``: depth of the ball of which 95 % are seen, with the 95 % interval that so
        many touches leave, and ``untouched``: share of the frames whose interval leaves out 0, with
        the same, and the upper end of force [N] of 95 % of them.
    """
    reader, balls = Reader(profile, background=background), Balls(profile)
    frames = untouched_frames(background, images, reader)
    if not frames:
        raise InputError("no press can be read, of whose light and noise frames are made")
    places = _places(profile)
    still = np.zeros_like(background, dtype=float)
    read = [reader(frame.touched(still)) for frame in frames]
    least = []
    for number in range(count):
        frame, at = frames[number % len(frames)], next(places)
        low, high = -1, len(DEPTHS_MM)
        while high - low > 1:
            middle = (low + high) // 2
            shown = frame.touched(balls.change(float(DEPTHS_MM[middle]), at))
            seen = excludes_zero(reader(shown))
            low, high = (low, middle) if seen else (middle, high)
        least.append(high)
    shares = [success_interval(sum(x <= k for x in least), count) for k in range(len(DEPTHS_MM))]
    by_share, lower, upper = (
        float(DEPTHS_MM[min(int(np.sum(values < SHARE)), len(DEPTHS_MM) - 1)])
        for values in np.transpose(shares)
    )
    wrong = success_interval(sum(map(excludes_zero, read)), len(read))
    most = [one.force_interval_n[1] for one in read if one.press and one.force_interval_n]
    return {
        "smallest_mm": {"value": by_share, "interval": [upper, lower]},
        "untouched": {
            "frames": len(read),
            "share": {"value": wrong[0], "interval": list(wrong[1:])},
            "most_n": float(np.quantile(most, SHARE)) if most else None,
        },
    }
