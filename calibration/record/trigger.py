# SPDX-License-Identifier: Apache-2.0
"""When to take a picture: the contact has come and stands still.

Everything is measured against the untouched gel of this very camera: how much its frames differ
from their mean, and from one another a moment apart. Limits are multiples of that, so that a dark
sensor, a noisy one and one of another size need no settings. Images are made small and smoothed
first, the light's drift is taken off.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from enum import StrEnum

import cv2
import numpy as np

from taccel_lab.calibration.record.lamps import nothing_seen
from taccel_lab.reading.light import LightDrift, fit_light, without_light
from taccel_lab.reading.thumb import thumb

SMOOTHING_SHARE = 1 / 60
"""Standard deviation of the smoothing, as a part of the small image's shorter side."""
QUANTISATION_LEVELS = 12**-0.5
"""Noise of 8 bits: a replayed still has none."""
CONTACT, RELEASED = 4.0, 2.0
"""Times the largest change of untouched frames from which there is a contact, and below which it
is gone."""
MOVING = 2.0
"""Times the largest motion of untouched frames from which something moves."""
SHARE_MOVING = 0.03
"""Part of a contact's own change that may move meanwhile: gels creep under a ball that is still."""
LAG_S = 0.2
"""Motion is the change since this long ago [s]."""
HOLD_S = 0.4
"""How long a contact stands still before its picture is taken [s]."""
REST_S, REST_FRAMES = 1.5, 12
"""How long, and how many frames, the untouched gel is measured."""
GAP_S = 1.0
"""Frames farther apart say nothing of motion."""
MARK_SHARE, MARK_S = 0.25, 1.5
"""What is left of a contact's change for this long after it went is a mark in the gel."""
FOLLOW_S = 30.0
"""The untouched picture follows slow changes in this time [s]."""
FIT_STEP = 2
"""The light is fitted to every second pixel of the small image."""


class Phase(StrEnum):
    """What is going on."""

    RESTING = "resting"
    """The untouched gel is being measured."""
    WAITING = "waiting"
    """Nothing touches the gel."""
    APPROACHING = "approaching"
    """Something touches it and moves."""
    STEADY = "steady"
    """It stands still, not long enough yet."""
    TAKEN = "taken"
    """Its picture is taken; it has to go."""


@dataclass(frozen=True)
class Seen:
    """What one frame says."""

    phase: Phase
    take: bool
    """Whether this frame is the picture of a steady contact."""
    change: np.ndarray | None
    """Smoothed colour change of the small image [levels], float32, shape [h, w, 3]; None while
    the untouched gel is measured."""
    at_rest: bool = False
    """Whether the frame shows the untouched gel, standing still for as long as a contact has to."""
    renewed: bool = False
    """Whether the untouched picture was just taken anew, because the gel keeps a mark."""
    progress: float = 0.0
    """How much of the measurement or of the hold is done, 0 to 1."""
    unseen: str = ""
    """Why the untouched gel cannot be measured, in a sentence; empty where it can."""


@dataclass(frozen=True)
class UntouchedGel:
    """The untouched gel, small, and how much its frames differ by themselves."""

    image: np.ndarray
    """Mean of the frames [levels], float32, shape [h, w, 3]."""
    change_levels: float
    """Largest smoothed change of any frame from the mean."""
    motion_levels: float
    """Largest smoothed change of any frame from the one ``LAG_S`` earlier."""
    flicker_levels: float = 0.0
    """Half of the range that the light of the frames has, in the channel that has most."""

    def change(self, small: np.ndarray) -> tuple[np.ndarray, LightDrift]:
        """Smoothed colour change [levels], the light's drift taken off, and that light."""
        step = (slice(None, None, FIT_STEP),) * 2
        light = fit_light(small[step], self.image[step], gradient=False)
        return _smooth(without_light(small, self.image, light)), light

    def followed(self, small: np.ndarray, light: LightDrift, seconds: float) -> UntouchedGel:
        """Gel as it looks now, some seconds on: slow changes are no contact."""
        share = np.float32(min(seconds / FOLLOW_S, 1.0))
        image = self.image + share * (light.remove(small).astype(np.float32) - self.image)
        return replace(self, image=image)


@dataclass
class Trigger:
    """Frames in; whether a picture is to be taken out."""

    hold_s: float = HOLD_S
    rest: UntouchedGel | None = None
    untouched: np.ndarray | None = None
    """Mean of the frames in which ``rest`` was measured, RGB float32."""
    _phase: Phase = Phase.RESTING
    _recent: deque[tuple[float, np.ndarray]] = field(default_factory=deque)
    _gathered: list[tuple[float, np.ndarray, np.ndarray]] = field(default_factory=list)
    """Time, small picture and image of frames that may show the untouched gel."""
    _still_since: float | None = None
    _taken_levels: float = 0.0

    def see(self, image: np.ndarray, time_s: float) -> Seen:
        """Take the next frame in, RGB uint8, shape [height_px, width_px, 3]."""
        small = thumb(image)
        if self._recent and not 0 <= time_s - self._recent[-1][0] <= GAP_S:
            self._recent.clear()
            self._gathered.clear()
            self._still_since = None
        before = self._recent[-1][0] if self._recent else time_s
        earlier = self._earlier(time_s)
        self._recent.append((time_s, small))
        if self.rest is None:
            return self._measure(small, image, time_s)
        change, light = self.rest.change(small)
        largest = _largest(change)
        motion = 0.0 if earlier is None else _largest(_smooth(small - earlier))
        limit = max(MOVING * self.rest.motion_levels, SHARE_MOVING * largest)
        still = earlier is not None and motion <= limit
        if not still:
            self._still_since = None
        elif self._still_since is None:
            self._still_since = time_s
        held = 0.0 if self._still_since is None else time_s - self._still_since
        take = renewed = False
        noise = self.rest.change_levels
        if self._phase == Phase.TAKEN:
            marked = largest < MARK_SHARE * self._taken_levels and held >= MARK_S
            renewed = marked and largest >= RELEASED * noise
            if renewed:
                self.rest = replace(self.rest, image=small)
            if renewed or largest < RELEASED * noise:
                self._phase = Phase.WAITING
        elif largest < (CONTACT if self._phase == Phase.WAITING else RELEASED) * noise:
            self._phase = Phase.WAITING
            self.rest = self.rest.followed(small, light, time_s - before)
        else:
            self._phase = Phase.STEADY if still else Phase.APPROACHING
            take = held >= self.hold_s
            if take:
                self._phase, self._taken_levels = Phase.TAKEN, largest
        waiting = self._phase == Phase.WAITING
        return Seen(
            self._phase,
            take,
            change,
            at_rest=waiting and held >= self.hold_s and largest < RELEASED * noise,
            renewed=renewed,
            progress=min(held / self.hold_s, 1.0) if self._phase == Phase.STEADY else 0.0,
        )

    def taken(self) -> None:
        """A person took the picture: nothing is taken until this contact is gone."""
        if self.rest is not None and self._recent:
            change, _ = self.rest.change(self._recent[-1][1])
            if _largest(change) >= CONTACT * self.rest.change_levels:
                self._phase, self._taken_levels = Phase.TAKEN, _largest(change)

    def _earlier(self, time_s: float) -> np.ndarray | None:
        """The frame of ``LAG_S`` ago; None where there is none yet."""
        while len(self._recent) > 1 and self._recent[1][0] <= time_s - LAG_S + 1e-6:
            self._recent.popleft()
        if not self._recent or self._recent[0][0] > time_s - LAG_S + 1e-6:
            return None
        return self._recent[0][1]

    def _measure(self, small: np.ndarray, image: np.ndarray, time_s: float) -> Seen:
        unseen = nothing_seen(small)
        if unseen:
            self._gathered.clear()
            return Seen(Phase.RESTING, False, None, unseen=unseen)
        self._gathered.append((time_s, small, image))
        first = self._gathered[0][0]
        done = min((time_s - first) / REST_S, len(self._gathered) / REST_FRAMES)
        if done < 1:
            return Seen(Phase.RESTING, False, None, progress=max(done, 0.0))
        rest = _rest_of([frame[:2] for frame in self._gathered])
        if rest is None:  # Something moved: from the start.
            self._gathered.clear()
            return Seen(Phase.RESTING, False, None)
        self.rest, self._phase = rest, Phase.WAITING
        images = [image for _, _, image in self._gathered]
        self.untouched = np.asarray(np.mean(images, axis=0, dtype=np.float32))
        self._gathered.clear()
        return Seen(Phase.WAITING, False, rest.change(small)[0], at_rest=True)


def _rest_of(frames: list[tuple[float, np.ndarray]]) -> UntouchedGel | None:
    """The untouched gel of frames in which nothing moves; None where something does: the means of
    the two halves, in which noise is small, differ by more than frames ``LAG_S`` apart."""
    images = np.stack([small for _, small in frames])
    half = len(images) // 2
    rest = UntouchedGel(images.mean(axis=0), 0.0, 0.0)
    seen = [rest.change(small) for small in images]
    changes = [_largest(change) for change, _ in seen]
    mean = rest.image.reshape(-1, 3).astype(np.float64).mean(axis=0)
    flicker = 0.5 * float(np.ptp([light.shift(mean) for _, light in seen], axis=0).max())
    times = [time_s for time_s, _ in frames]
    motions = []
    for i, time_s in enumerate(times):
        past = [k for k in range(i) if times[k] <= time_s - LAG_S + 1e-6]
        if past:
            motions.append(_largest(_smooth(images[i] - images[past[-1]])))
    change = max(*changes, QUANTISATION_LEVELS)
    shift, _ = UntouchedGel(images[:half].mean(axis=0), 0.0, 0.0).change(images[half:].mean(axis=0))
    if _largest(shift) > max(float(np.median(motions)), QUANTISATION_LEVELS):
        return None
    return UntouchedGel(rest.image, change, max(*motions, QUANTISATION_LEVELS, 0.0), flicker)


def _smooth(image: np.ndarray) -> np.ndarray:
    sigma = max(min(image.shape[:2]) * SMOOTHING_SHARE, 1.0)
    return cv2.GaussianBlur(image, (0, 0), sigma)


def _largest(change: np.ndarray) -> float:
    return float(np.sqrt(np.square(change).sum(axis=-1).max()))
