# SPDX-License-Identifier: Apache-2.0
"""Frames of cameras with the faults that ``FrameFaults`` states: drawn, made and named on the
device.

What a frame has depends on its seed, episode, camera and number alone: neither on the cameras
beside it nor on how often it is read. Frames are given in their order; one that is given again
comes out the same, and one of another episode, or of a lower number, forgets what was before.
"""

# Warp compiles the kernels from their source; its type stubs do not describe vectors' operators.
# pyright: reportArgumentType=false, reportCallIssue=false, reportIndexIssue=false
# pyright: reportOperatorIssue=false, reportAssignmentType=false

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.signals.frame_faults import FrameFaults
from taccel_lab.signals.frame_operators import (
    BANDS,
    DEAD_LAMP,
    DELAY,
    DRIFT,
    GREEN,
    GREY,
    LOST_ROWS,
    SHIFT,
    STUCK,
    TORN,
    WEAR,
    FrameFault,
    frame_light_kernel,
    frame_wire_kernel,
)

wp.set_module_options({"enable_backward": False})

RGB = 3
"""Channels of an image; maps of any other number are of taxels, which have neither light nor
frames."""
_GREY, _GREEN = wp.constant(wp.vec3(*GREY)), wp.constant(wp.vec3(*GREEN))


_FIELDS = {
    **{
        field.name: wp.vec2 if isinstance(field.default, tuple) else wp.float32
        for field in fields(FrameFaults)
    },
    **dict.fromkeys(("height", "width"), wp.int32),
}
_Stated: Any = wp.struct(type("_Stated", (), {"__annotations__": _FIELDS}))
"""``FrameFaults`` on the device, and the size of the frames."""


@wp.struct
class _Key:
    """What a frame's draws depend on."""

    seed: wp.int32
    episode: wp.int32
    camera: wp.int32


@wp.func
def _draws(key: _Key, frame: int, kind: int) -> wp.uint32:
    """The random numbers of one kind: those of others do not depend on it."""
    state = wp.rand_init(key.seed, key.episode)
    state = wp.rand_init(wp.int32(state), key.camera)
    state = wp.rand_init(wp.int32(state), frame)
    return wp.rand_init(wp.int32(state), kind)


@wp.func
def _within(part: float, ends: wp.vec2) -> float:
    return ends[0] + part * (ends[1] - ends[0])


@wp.func
def _whole(part: float, ends: wp.vec2) -> int:
    """One of the whole numbers from end to end."""
    return wp.min(int(ends[0]) + int(part * (ends[1] - ends[0] + 1.0)), int(ends[1]))


@wp.func
def _first_row(part: float, ends: wp.vec2, height: int) -> int:
    return wp.min(int(_within(part, ends) * float(height)), height - 1)


@wp.func
def _sideways(part: float, side: float, ends: wp.vec2, width: int) -> int:
    """A shift of at least a pixel, to either side."""
    size = wp.max(int(_within(part, ends) * float(width) + 0.5), 1)
    if side < 0.5:
        return -size
    return size


@wp.func
def _light(stated: _Stated, key: _Key, age: int) -> FrameFault:
    """Faults that an episode's frames have all alike; ``age``: how many had them already."""
    one = FrameFault()
    state = _draws(key, -1, WEAR)
    if wp.randf(state) < stated.wear:
        one.kinds |= WEAR
        one.wear_gain = _within(wp.randf(state), stated.wear_gain)
        one.wear_across = wp.randf(state, -1.0, 1.0)
        one.wear_down = wp.randf(state, -1.0, 1.0)
        one.wear_radius = _within(wp.randf(state), stated.wear_radius)
    state = _draws(key, -1, DEAD_LAMP)
    if wp.randf(state) < stated.dead_lamp:
        one.kinds |= DEAD_LAMP
        left, channel = _within(wp.randf(state), stated.lamp_left), int(wp.randf(state) * 3.0)
        one.lamp_left = wp.vec3(1.0, 1.0, 1.0)
        one.lamp_left[wp.min(channel, 2)] = left
    state = _draws(key, -1, BANDS)
    if wp.randf(state) < stated.bands:
        one.kinds |= BANDS
        one.band_depth = _within(wp.randf(state), stated.band_depth)
        one.band_periods = _within(wp.randf(state), stated.band_periods)
        turn = wp.randf(state) + float(age) * wp.randf(state)
        one.band_phase = turn - wp.floor(turn)
    state = _draws(key, -1, DRIFT)
    if wp.randf(state) < stated.drift:
        one.kinds |= DRIFT
        frames = _whole(wp.randf(state), stated.drift_frames)
        part = wp.min(float(age + 1) / float(frames), 1.0)
        for c in range(3):
            one.drift_gain[c] = part * _within(wp.randf(state), stated.drift_gain)
            one.drift_levels[c] = part * _within(wp.randf(state), stated.drift_levels)
            one.drift_right[c] = part * _within(wp.randf(state), stated.drift_gradient)
            one.drift_down[c] = part * _within(wp.randf(state), stated.drift_gradient)
    return one


@wp.func
def _late(stated: _Stated, key: _Key) -> int:
    state = _draws(key, -1, DELAY)
    if wp.randf(state) < stated.delay:
        return _whole(wp.randf(state), stated.delay_frames)
    return 0


@wp.func
def _is_stuck(stated: _Stated, key: _Key, frame: int, first: int) -> bool:
    """Whether this frame or one before it began to come again for long enough."""
    for back in range(int(stated.stuck_frames[1])):
        if frame - back >= first:
            state = _draws(key, frame - back, STUCK)
            if wp.randf(state) < stated.stuck:
                if _whole(wp.randf(state), stated.stuck_frames) > back:
                    return True
    return False


@wp.kernel
def _draw_faults_kernel(
    stated: _Stated,
    first: int,
    seeds: wp.array(dtype=wp.int32),
    episodes: wp.array(dtype=wp.int32),
    frames: wp.array(dtype=wp.int32),
    slots: int,
    keys: wp.array(dtype=_Key),
    numbers: wp.array(dtype=wp.int32),
    counts: wp.array(dtype=wp.int32),
    lights: wp.array2d(dtype=FrameFault),
    labels: wp.array2d(dtype=FrameFault),
    light: wp.array(dtype=FrameFault),
    label: wp.array(dtype=FrameFault),
    kinds: wp.array(dtype=wp.int32),
):
    row = wp.tid()
    cameras = keys.shape[0] // seeds.shape[0]
    env = row // cameras
    frame, old = frames[env], keys[row]
    key = _Key(seeds[env], episodes[env], row % cameras)
    count = int(counts[row])
    if key.seed != old.seed or key.episode != old.episode or frame < numbers[row]:
        count = 0
    elif frame > numbers[row]:
        count += 1
    keys[row] = key
    numbers[row] = frame
    counts[row] = count
    own = FrameFault()
    if frame >= first:
        own = _light(stated, key, frame - first)
    lights[count % slots, row] = own
    light[row] = own
    one = FrameFault()
    if frame >= first:
        late = wp.min(_late(stated, key), count)
        # Of the light in which the frame was taken that comes now.
        one = lights[(count - late) % slots, row]
        if late > 0:
            one.kinds |= DELAY
            one.delay_frames = late
        state = _draws(key, frame, SHIFT)
        if wp.randf(state) < stated.shift:
            one.kinds |= SHIFT
            one.shift_px = _sideways(
                wp.randf(state), wp.randf(state), stated.shift_width, stated.width
            )
        state = _draws(key, frame, TORN)
        if wp.randf(state) < stated.torn:
            start = _first_row(wp.randf(state), stated.torn_from, stated.height)
            if wp.randf(state) >= stated.torn_before:
                one.kinds |= TORN
                one.torn_px = _sideways(
                    wp.randf(state), wp.randf(state), stated.shift_width, stated.width
                )
                one.torn_from_row = start
            elif count > late:
                one.kinds |= TORN
                one.torn_from_row = start
        state = _draws(key, frame, LOST_ROWS)
        if wp.randf(state) < stated.lost_rows:
            one.kinds |= LOST_ROWS
            one.lost_from_row = _first_row(wp.randf(state), stated.lost_from, stated.height)
            one.lost_level = _GREY
            if wp.randf(state) < stated.lost_green:
                one.lost_level = _GREEN
        if count > 0 and _is_stuck(stated, key, frame, wp.max(first, 1)):
            one = labels[(count + 1) % 2, row]
            one.kinds |= STUCK
            one.stuck_frames += 1
    labels[count % 2, row] = one
    label[row] = one
    kinds[row] = one.kinds


class FaultyFrames:
    """Cameras of environments, some of whose frames are faulty."""

    def __init__(
        self,
        faults: FrameFaults,
        size_px: tuple[int, int],
        env_count: int,
        cameras: int = 1,
        *,
        first: int = 0,
        device: Any = "cpu",
    ) -> None:
        """
        Args:
            faults: What can be wrong.
            size_px: Width and height of the frames.
            env_count: Environments.
            cameras: Cameras of each; rows of frames are [env, camera], one after the other.
            first: Number of the first frame of an episode that may be faulty.
            device: Where frames are.
        """
        self.faults, self._first = faults, first
        count = env_count * cameras
        self.device = wp.get_device(device)
        self._stated = _Stated()
        for name, value in vars(faults).items():
            setattr(self._stated, name, wp.vec2(*value) if isinstance(value, tuple) else value)
        self._stated.width, self._stated.height = size_px
        self.shape = (count, size_px[1], size_px[0], RGB)
        """Shape of frames, [row, height, width, 3]."""
        self._slots = int(faults.delay_frames[1]) + 2
        self._keys = self._of(_Key, count)
        self._numbers = wp.full(count, 2**31 - 1, dtype=wp.int32, device=self.device)
        self._counts = self._of(wp.int32, count)
        self._lights = self._of(FrameFault, (self._slots, count))
        self._labels = self._of(FrameFault, (2, count))
        self._light, self._label = (self._of(FrameFault, count) for _ in range(2))
        self.kinds = self._of(wp.int32, count)
        """Bits of the kinds of each row's frame, int32, [row]; see ``frame_faults.kinds_of``."""
        self._kept: dict[Any, tuple[wp.array, wp.array]] = {}

    def _of(self, dtype: Any, shape: Any) -> wp.array:
        return wp.zeros(shape, dtype=dtype, device=self.device)

    def draw(self, seeds: wp.array, episodes: wp.array, frames: wp.array) -> None:
        """Turn to the frame of each environment: its seed, how many episodes it has begun, and the
        number of the frame in its episode, from 0; int32, [env], on the device."""
        wp.launch(
            _draw_faults_kernel,
            len(self._keys),
            [self._stated, self._first, seeds, episodes, frames, self._slots],
            [
                self._keys, self._numbers, self._counts, self._lights, self._labels,
                self._light, self._label, self.kinds,
            ],
            device=self.device,
        )  # fmt: skip

    def lit(self, images: wp.array) -> wp.array:
        """Frames [row, h, w, 3], float32 levels, in the light of each row; ``images`` themselves
        where no light can be faulty. Not clipped: noise and rounding come after it."""
        if not self.faults.of_light:
            return images
        seen = wp.empty_like(images)
        wp.launch(
            frame_light_kernel, self.shape, [images, self._light], [seen], device=self.device
        )  # fmt: skip
        return seen

    def sent(self, images: wp.array) -> wp.array:
        """Frames, uint8 or float32, as they arrive: late, stuck, torn, shifted, without rows."""
        faults, kept = self.faults, images
        if not faults.of_wire:
            return images
        keeps, keeps_last = faults.delay > 0 or faults.torn > 0, faults.stuck > 0
        if images.dtype not in self._kept and (keeps or keeps_last):
            # One call a row is enough where no earlier one is read.
            slots = (self._slots if keeps else 1, 2 if keeps_last else 1)
            self._kept[images.dtype] = tuple(
                self._of(images.dtype, (many * self.shape[0], *self.shape[1:])) for many in slots
            )
        earlier, last = self._kept.get(images.dtype, (kept, kept))
        seen = wp.empty_like(images)
        wp.launch(
            frame_wire_kernel,
            self.shape,
            [images, self._label, self._counts, self._slots, keeps, earlier, keeps_last, last],
            [seen],
            device=self.device,
        )
        return seen

    def labels(self) -> np.ndarray:
        """What is wrong with each row's frame, a structured array by the fields of ``FrameFault``,
        [row], on memory of its own; waits for the device."""
        return self._label.numpy().copy()
