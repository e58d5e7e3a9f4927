# SPDX-License-Identifier: Apache-2.0
"""A live session: the untouched gel first, then frame after frame until somebody stops it."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from taccel_lab.calibration.capture.camera.camera import (
    Camera,
    ControlLock,
    ControlValues,
    Shot,
)
from taccel_lab.calibration.capture.camera.framing import Framing
from taccel_lab.calibration.capture.camera.shots import AGAIN_S, Gap, shots
from taccel_lab.calibration.live.latency import Latency
from taccel_lab.calibration.live.reader import LiveReader, LiveReading
from taccel_lab.calibration.record.trigger import Trigger


class LiveWatcher(Protocol):
    """Shows readings and may give orders."""

    def show(self, reading: LiveReading, reader: LiveReader, latency: Latency) -> None: ...

    def tell(self, text: str) -> None:
        """What goes on, such as that nothing may touch the gel."""
        ...

    def wants_background(self) -> bool:
        """Whether the untouched gel is to be taken again."""
        ...

    def stopped(self) -> bool:
        """Whether it is over."""
        ...


@dataclass
class LiveResult:
    """What a session came to."""

    reader: LiveReader | None
    """None where no frame was read."""
    latency: Latency
    locks: tuple[ControlLock, ...] = ()
    last: LiveReading | None = None


def run_live(
    make_reader: Callable[[np.ndarray], LiveReader],
    open_: Callable[[], Camera],
    watchers: list[LiveWatcher],
    *,
    background: np.ndarray | None = None,
    frames: int | None = None,
    values: ControlValues | None = None,
    framing: Framing | None = None,
    again_s: float = AGAIN_S,
) -> LiveResult:
    """Read frames until ``frames`` are done, a watcher stops it or a replay is over.

    Args:
        make_reader: Of an untouched image, RGB float32.
        open_: Opens the camera, the same one each time.
        watchers: Are shown every reading.
        background: The untouched gel; measured at first when None: nothing may touch it.
        frames: To read; without end when None.
        values: Where the camera's controls are locked.
        framing: What is kept of each frame.
        again_s: Time between two tries to open a camera that is gone [s].

    Raises:
        InputError: The images do not fit the profile, or there is no such camera.
        CameraLostError: It does not open at first.
    """
    values, framing = values or ControlValues(), framing or Framing()
    result = LiveResult(None if background is None else make_reader(background), Latency())
    untouched = _Untouched()

    def opened(camera: Camera) -> None:
        result.locks = tuple(camera.lock(values))

    def tell(text: str) -> None:
        for watcher in watchers:
            watcher.tell(text)

    if result.reader is None:
        tell("Touch nothing: the untouched gel is being measured.")
    done, waited = 0, time.perf_counter()
    with closing(shots(open_, opened, again_s=again_s)) as stream:
        for event in stream:
            arrived = time.perf_counter()
            if isinstance(event, Gap):
                tell(f"The camera is gone ({event.reason}); plug it in again.")
                continue
            shot = Shot(framing.apply(event.image), event.time_s)
            if result.reader is None:
                found = untouched.add(shot)
                if found is not None:
                    result.reader = make_reader(found)
                    tell("")
                waited = time.perf_counter()
                continue
            start, start_cpu = time.perf_counter(), time.thread_time()
            reading = result.reader.read(shot.image)
            result.last = reading
            stages = {"wait": arrived - waited, "frame": start - arrived, **reading.stages_s}
            drawn = time.perf_counter()
            for watcher in watchers:
                watcher.show(reading, result.reader, result.latency)
            stages["pictures"] = time.perf_counter() - drawn
            age = time.monotonic() - shot.time_s
            if 0 <= age < MOST_AGE_S:
                stages["age"] = age
            result.latency.add(stages, time.thread_time() - start_cpu)
            done += 1
            if done == frames or any(watcher.stopped() for watcher in watchers):
                return result
            if any(watcher.wants_background() for watcher in watchers):
                result.reader, untouched = None, _Untouched()
                tell("Touch nothing: the untouched gel is being measured.")
            waited = time.perf_counter()
    return result


MOST_AGE_S = 5.0
"""A frame is not older: its time is of another clock, as a replay's that is not paced."""


class _Untouched:
    """Mean of frames in which nothing moves."""

    def __init__(self) -> None:
        self._trigger = Trigger()
        self._frames: list[np.ndarray] = []

    def add(self, shot: Shot) -> np.ndarray | None:
        """Take a frame in; the mean, RGB float32, once there are enough."""
        seen = self._trigger.see(shot.image, shot.time_s)
        if seen.progress == 0.0 and self._trigger.rest is None:
            self._frames.clear()  # Something moved, or this is the first one.
        self._frames.append(shot.image)
        if self._trigger.rest is None:
            return None
        return np.asarray(np.mean(self._frames, axis=0, dtype=np.float32))
