# SPDX-License-Identifier: Apache-2.0
"""A session from the first frame to the last, with whoever watches it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from typing import Literal, Protocol

from taccel_lab.calibration.capture.camera.camera import (
    AGAIN_S,
    Camera,
    ControlValues,
    Framing,
    Gap,
    Shot,
    shots,
)
from taccel_lab.calibration.record.session import Recorder, SessionStatus
from taccel_lab.calibration.record.trigger import Phase

Order = Literal["take", "undo", "finish"]


class Watcher(Protocol):
    """Shows a session and may give orders."""

    def show(self, status: SessionStatus) -> None: ...

    def orders(self) -> list[Order]:
        """What was asked for since the last call."""
        ...


def run_session(
    recorder: Recorder,
    open_: Callable[[], Camera],
    watchers: list[Watcher],
    *,
    values: ControlValues | None = None,
    framing: Framing | None = None,
    ends_by_itself: bool = True,
    again_s: float = AGAIN_S,
) -> SessionStatus:
    """Record until all presses are taken, a watcher ends it, or a replay is over.

    ``ends_by_itself``: when all presses are taken and the ball is lifted. ``again_s`` passes
    between two tries to open a camera that is gone.

    Raises:
        InputError: There is no such camera at first, or its images do not fit the folder.
        CameraLostError: It does not open at first.
    """
    values, framing = values or ControlValues(), framing or Framing()

    def opened(camera: Camera) -> None:
        recorder.opened(camera.info, camera.lock(values))

    with closing(shots(open_, opened, again_s=again_s)) as stream:
        for event in stream:
            if isinstance(event, Gap):
                status = recorder.lost(event)
            else:
                status = recorder.see(Shot(framing.apply(event.image), event.time_s))
            for order in (order for watcher in watchers for order in watcher.orders()):
                {"take": recorder.take_now, "undo": recorder.undo, "finish": recorder.finish}[
                    order
                ]()
                status = recorder.status()
            if ends_by_itself and recorder.complete and status.phase == Phase.WAITING:
                recorder.finish()
                status = recorder.status()
            for watcher in watchers:
                watcher.show(status)
            if recorder.finished:
                return status
    if recorder.complete:
        recorder.finish()
    return recorder.status()
