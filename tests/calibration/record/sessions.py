# SPDX-License-Identifier: Apache-2.0
"""Sessions of made-up presses, as a camera would show them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from taccel_lab.calibration.capture.camera.camera import Camera, CameraLostError, Shot
from taccel_lab.calibration.capture.camera.replay import CameraReplay, ReplayCamera, open_replay
from taccel_lab.calibration.record.folder import RecordFacts, open_record
from taccel_lab.calibration.record.session import Order, Recorder, SessionStatus, run_session
from taccel_lab.files.videos import RecordedFrame
from tests.support.capture_sets import BALL_MM, CaptureMaker, spread_circles
from tests.support.synthetic_presses import GRID

NOISY = CameraReplay(noise_levels=1.0, hold_s=0.8, rest_s=1.8)
FACTS = RecordFacts("flat_pad", radius_mm=BALL_MM, mm_per_px=(GRID.mm_per_px_x, GRID.mm_per_px_y))


def source(folder: Path, count: int = 3) -> Path:
    """A capture folder to replay."""
    return CaptureMaker(circles=spread_circles(count)).write(folder)


class Watching:
    """A watcher that keeps what it is shown, and gives orders at some frames."""

    def __init__(self, orders: dict[int, Order] | None = None) -> None:
        self.seen: list[SessionStatus] = []
        self._orders = orders or {}

    def show(self, status: SessionStatus) -> None:
        self.seen.append(status)

    def orders(self) -> list[Order]:
        order = self._orders.get(len(self.seen))
        return [] if order is None else [order]


class SteeredCamera(ReplayCamera):
    """Shows one image, in its own time, until it is given another."""

    def __init__(self, path: Path, image: np.ndarray, noise: float = 0.0) -> None:
        """Of an RGB uint8 image; ``path`` is the camera's name."""
        self.image = image
        self.time_stands = False
        """Whether frames have the time of the last one: what takes its time does not end."""
        self._time_s = 0.0

        def frames() -> Iterator[RecordedFrame]:
            while True:
                yield RecordedFrame("", self.image)

        # As few frames a second as tell a rest: each is looked at, sent and drawn by a browser.
        super().__init__(path, frames, CameraReplay(fps=12.0, paced=True, noise_levels=noise))

    def read(self) -> Shot | None:
        shot = super().read()
        assert shot is not None, "there is no end of frames"
        if not self.time_stands:
            self._time_s = shot.time_s
        return replace(shot, time_s=self._time_s)


class UnpluggedCamera:
    """A replay that drops every seventh frame and is lost at some: it opens at the third try."""

    def __init__(self, path: Path, lost_at: tuple[int, ...]) -> None:
        self._camera: Camera = open_replay(path, NOISY)
        self._lost_at = lost_at
        self._count = self._refuse = self.opened = 0
        self.info, self.lock = self._camera.info, self._camera.lock

    def open(self) -> Camera:
        """As ``open_camera``."""
        if self._refuse:
            self._refuse -= 1
            raise CameraLostError("no such camera")
        self.opened += 1
        return self

    def read(self) -> Shot | None:
        self._count += 1
        if self._count in self._lost_at:
            self._refuse = 2
            raise CameraLostError("the camera gives no frames any more")
        if self._count % 7 == 0:
            self._camera.read()
        return self._camera.read()

    def close(self) -> None: ...


def record(
    camera: Path | Callable[[], Camera],
    out: Path,
    wanted: int = 3,
    facts: RecordFacts = FACTS,
    watching: Watching | None = None,
) -> list[SessionStatus]:
    """What a session shows of a camera, or of the replay of a folder."""
    watching = watching or Watching()
    opened = (lambda: open_replay(camera, NOISY)) if isinstance(camera, Path) else camera
    with open_record(out, facts) as folder:
        run_session(Recorder(folder, facts, wanted), opened, [watching])
    return watching.seen
