# SPDX-License-Identifier: Apache-2.0
"""Live sessions: the untouched gel first, then frame after frame until somebody stops it, and how
long frames take, stage by stage.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Generator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from taccel_lab.calibration.capture.camera.camera import (
    Camera,
    ControlLock,
    ControlValues,
    Framing,
    Gap,
    Shot,
    shots,
)
from taccel_lab.calibration.live.reader import LiveReader, LiveReading
from taccel_lab.calibration.record.lamps import FrozenWatch, flicker_words
from taccel_lab.calibration.record.trigger import GAP_S, REST_FRAMES, REST_S, Trigger
from taccel_lab.guards import require_size

KEPT = 600
"""Frames that figures are of: the last half minute or so."""


@dataclass
class Latency:
    """Times of the last frames."""

    _frames: deque[dict[str, float]] = field(default_factory=lambda: deque(maxlen=KEPT))
    _ends_s: deque[float] = field(default_factory=lambda: deque(maxlen=KEPT))

    _cpu_s: deque[float] = field(default_factory=lambda: deque(maxlen=KEPT))

    def add(self, stages_s: dict[str, float], cpu_s: float) -> None:
        """A frame is done, whose stages took so long [s], and so long of a core's time."""
        self._frames.append(dict(stages_s))
        self._cpu_s.append(cpu_s)
        self._ends_s.append(time.perf_counter())

    def rate_hz(self) -> float:
        """Frames a second, waiting for the camera among it; 0 before the second one."""
        if len(self._ends_s) < 2:
            return 0.0
        return (len(self._ends_s) - 1) / max(self._ends_s[-1] - self._ends_s[0], 1e-9)

    def figures(self) -> dict[str, Any]:
        """Median and 95th percentile of each stage, of their sum and of a core's time for it [ms],
        which is less where others keep the core busy; the rate [Hz]."""
        names = list(dict.fromkeys(name for frame in self._frames for name in frame))
        stages = {
            name: _spread([frame[name] for frame in self._frames if name in frame])
            for name in names
        }
        busy = [sum(t for name, t in f.items() if name not in NOT_BUSY) for f in self._frames]
        return {
            "frames": len(self._frames),
            "rate_hz": self.rate_hz(),
            "stages_ms": stages,
            "busy_ms": _spread(busy),
            "cpu_ms": _spread(list(self._cpu_s)),
        }


NOT_BUSY = ("wait", "age")
"""Times that are no work: for the camera, and from the moment a frame was taken to its result."""


def _spread(times_s: list[float]) -> dict[str, float]:
    if not times_s:
        return {}
    ms = 1e3 * np.array(times_s)
    return {"median": float(np.median(ms)), "p95": float(np.percentile(ms, 95))}


class LiveWatcher(Protocol):
    """Shows readings and may give orders."""

    def show(self, reading: LiveReading, reader: LiveReader, latency: Latency) -> None: ...

    def tell(self, text: str) -> None:
        """What goes on, such as that nothing may touch the gel; empty: all is well."""
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
    remarks: tuple[str, ...] = ()
    """What is wrong with the profile, or with the untouched gel that was measured, one sentence
    each."""
    unseen: str = ""
    """What it waits for while it could not be measured, in a sentence; empty where it was."""


def run_together(sessions: Sequence[Generator[LiveResult, None, None]]) -> list[LiveResult]:
    """Go on with each session in turn, a frame each, until all are over; returns what they came
    to."""
    going = dict(enumerate(sessions))
    results: dict[int, LiveResult] = {}
    with ExitStack() as stack:
        for session in sessions:
            stack.enter_context(closing(session))
        while going:
            for number, session in list(going.items()):
                found = next(session, None)
                if found is None:
                    del going[number]
                else:
                    results[number] = found
    return [results[number] for number in range(len(sessions))]


def measured_rest(open_: Callable[[], Camera], framing: Framing = Framing()) -> np.ndarray | None:
    """The untouched gel that a replay shows, RGB float32, [height_px, width_px, 3]; None where it
    shows none for as long as it has to."""
    trigger = Trigger()
    with closing(shots(open_, lambda _: None)) as stream:
        for event in stream:
            if isinstance(event, Shot):
                trigger.see(framing.apply(event.image), event.time_s)
            if trigger.untouched is not None:
                return trigger.untouched
    return None


def live_session(
    make_reader: Callable[[np.ndarray], LiveReader],
    open_: Callable[[], Camera],
    watchers: list[LiveWatcher],
    *,
    background: np.ndarray | None = None,
    frames: int | None = None,
    values: ControlValues = ControlValues(),
    framing: Framing = Framing(),
) -> Generator[LiveResult, None, None]:
    """Read frames until ``frames`` are done, a watcher stops it or a replay is over.

    Gives what it came to so far, always the same object, at first and after each frame.

    ``make_reader`` gets the untouched gel, RGB float32 [height_px, width_px, 3]: ``background``, or
    what is measured at first, when nothing may touch it.

    Raises:
        InputError: The images do not fit the profile or change their size, or there is no such
            camera.
        CameraLostError: It does not open at first.
    """
    result = LiveResult(None if background is None else make_reader(background), Latency())
    if result.reader is not None:
        result.remarks = result.reader.remarks
    untouched, frozen = Trigger(), FrozenWatch()
    shown = ""

    def opened(camera: Camera) -> None:
        result.locks = tuple(camera.lock(values))
        frozen.replayed = camera.info.replayed

    def tell(text: str) -> None:
        nonlocal shown
        if text != shown:
            shown = text
            for watcher in watchers:
                watcher.tell(text)

    if result.reader is None:
        tell(TOUCH_NOTHING)
    yield result
    done, waited = 0, time.perf_counter()
    with closing(shots(open_, opened)) as stream:
        for event in stream:
            arrived = time.perf_counter()
            if isinstance(event, Gap):
                tell(f"The camera is gone ({event.reason}); plug it in again.")
                yield result
                continue
            shot = Shot(framing.apply(event.image), event.time_s)
            hangs = frozen.see(shot)
            if result.reader is None:
                unseen, found = untouched.see(shot.image, shot.time_s).unseen, untouched.untouched
                result.unseen = "" if found is not None else unseen or WAITS
                if found is not None:
                    result.reader = make_reader(found)
                    result.remarks = _remarks(result.reader, untouched)
                tell(unseen or hangs or (TOUCH_NOTHING if found is None else ""))
                waited = time.perf_counter()
                yield result
                continue
            size, first = shot.image.shape[1::-1], result.reader.background.shape[1::-1]
            advice = "set one format with --size"
            require_size("an image of the camera", size, "it began with", first, advice)
            tell(hangs or " ".join(result.remarks))
            start, start_cpu = time.perf_counter(), time.thread_time()
            reading = result.reader.read(shot.image, shot.time_s)
            result.last = reading
            stages = {"wait": arrived - waited, "crop": start - arrived, **reading.stages_s}
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
                return
            if any(watcher.wants_background() for watcher in watchers):
                result.reader, result.remarks, untouched = None, (), Trigger()
                tell(TOUCH_NOTHING)
            waited = time.perf_counter()
            yield result


def _remarks(reader: LiveReader, untouched: Trigger) -> tuple[str, ...]:
    flicker = flicker_words(0.0 if untouched.rest is None else untouched.rest.flicker_levels)
    remarks = *reader.remarks, reader.unlike_profile, f"T{flicker[1:]}." if flicker else ""
    return tuple(remark for remark in remarks if remark)


TOUCH_NOTHING = "Touch nothing: the untouched gel is being measured."
WAITS = (
    f"It waited for the untouched gel: {REST_S:g} s ({REST_FRAMES} frames and more, no two of them "
    f"{GAP_S:g} s apart) in which nothing moves"
)
MOST_AGE_S = 5.0
"""A frame is not older: its time is of another clock, as a replay's that is not paced."""
