# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab live``: what a sensor feels, frame by frame."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

from taccel_lab.cli.camera_options import CameraOptions
from taccel_lab.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from taccel_lab.calibration.live.latency import Latency
    from taccel_lab.calibration.live.reader import ForceTold, LiveReader, LiveReading
    from taccel_lab.calibration.live.run import LiveResult, LiveWatcher
    from taccel_lab.profile import SensorProfile

PORT = 8092


@dataclass(frozen=True, kw_only=True)
class Live(CameraOptions):
    """Show depth, normals and markers of a camera's frames, live.

    Reads what the profile's blocks allow: depth and normals with normals (colour sensors) or
    depth_response (grey ones), displacements with markers. Pixels outside the training range are
    marked. A depth with mostly such pixels is not shown. The time of each stage is measured.
    """

    profile: Positional[str]
    """Profile folder of this sensor, or a sensor of the catalogue with a starter profile."""
    background: Literal["camera", "profile"] = "camera"
    """The untouched gel: from the camera's first frames (do not touch it), or from the profile."""
    detail: int | None = None
    """Reduce images by this factor before reading depth, 1 to 4. Default: the finest that this
    machine reads in 30 ms."""
    frames: int | None = None
    """Stop after this number of frames. Default: stop by the page's button or Ctrl-C."""
    paced: bool = True
    """A replay keeps its frames' times; --no-paced shows them as fast as they are read."""
    page: bool = True
    """Show the page in the browser; --no-page reads and measures alone."""
    pictures_hz: float = 15.0
    """Largest number of page updates a second."""
    port: int = PORT
    """Port of the page on this machine; 0 takes any that is free."""
    browser: bool = True
    """Whether to open the page in this machine's browser."""
    json: bool = False
    """Print the last reading's figures and the time of each stage as JSON."""

    def run(self) -> None:
        from taccel_lab.calibration.capture.camera import CameraLostError
        from taccel_lab.calibration.live.page import LivePage
        from taccel_lab.calibration.live.reader import LiveReader, require_readable
        from taccel_lab.calibration.live.run import run_live
        from taccel_lab.cli.console import notes
        from taccel_lab.processes.start_warp import start_warp
        from taccel_lab.report.live_page import PageOptions, live_page
        from taccel_lab.sensors.profile import stock_sensor

        start_warp()
        if self.frames is not None and self.frames < 1:
            raise InputError(f"--frames is {self.frames}; at least 1 is allowed")
        if not 0.1 <= self.pictures_hz <= 100:
            raise InputError(f"--pictures-hz is {self.pictures_hz:g}; 0.1 to 100 are allowed")
        profile = stock_sensor(self.profile)
        framing, open_ = self.framing(), self.opener(self.paced)
        rest = profile.background_rgb if self.background == "profile" else None
        if self.background == "profile" and rest is None:
            raise InputError(f"{self.profile} has no background; leave --background profile away")
        require_readable(profile)
        console = notes()
        say = partial(console.print, soft_wrap=True)

        def make_reader(background: np.ndarray) -> LiveReader:
            force = None if profile.force is None else _forces(profile, background)
            return LiveReader(profile, background, detail=self.detail, force=force)

        with ExitStack() as stack:
            watchers: list[LiveWatcher] = [_Lines(say)]
            try:
                if self.page:
                    options = PageOptions(port=self.port, browser=self.browser)
                    title = f"Live {profile.sensor.name}"
                    server = stack.enter_context(live_page(title, options, say))
                    watchers.append(LivePage(server, self.pictures_hz))
                result = run_live(
                    make_reader,
                    open_,
                    watchers,
                    background=rest,
                    frames=self.frames,
                    values=self.values(),
                    framing=framing,
                )
            except CameraLostError as error:
                raise InputError(str(error)) from None
        self._report(result)

    def _report(self, result: LiveResult) -> None:
        from taccel_lab.cli.console import print_json, results

        reader = result.reader
        if reader is None or result.last is None:
            ended = f"{self.camera} ended before a frame was read"
            raise InputError(f"{ended}. {result.unseen}" if result.unseen else ended)
        found = result.latency.figures()
        if self.json:
            about = {
                "profile": self.profile,
                "detail": reader.detail,
                "maps_px": [reader.grid.width_px, reader.grid.height_px],
                "locks": {lock.name: lock.told for lock in result.locks},
                "remarks": list(result.remarks),
                "last": {
                    **result.last.figures,
                    "refused": result.last.refused,
                    "forces": dict(result.last.forces),
                },
                "latency": found,
            }
            print_json(about)
            return
        console = results()
        busy, cpu = found["busy_ms"], found["cpu_ms"]
        console.print(
            f"{found['frames']} frames, {found['rate_hz']:.1f} a second; work {busy['median']:.1f} "
            f"ms a frame (95 %: {busy['p95']:.1f} ms), {cpu['median']:.1f} ms of a core",
        )
        for name, ms in found["stages_ms"].items():
            line = f"  {name}: {ms['median']:.1f} ms (95 %: {ms['p95']:.1f} ms)"
            console.print(line)


def _forces(profile: SensorProfile, background: np.ndarray) -> ForceTold:
    """What the profile's force model says of a frame, by the names of the page."""
    from taccel_lab.learning.force.read_force import ForceReader

    reader = ForceReader(profile, background=background)

    def told(image: np.ndarray, _: np.ndarray) -> dict[str, float]:
        try:
            found = reader.read(image, "frame")
        except InputError:  # Too few markers are seen: nothing is told of this frame.
            return {}
        if found.outside:
            return {}
        forces = {}
        for axis, force, sigma in zip("xyz", found.force_n, found.sigma[:3], strict=True):
            forces[f"F{axis} [N]"], forces[f"F{axis} +- [N]"] = float(force), float(sigma)
        return forces | {"contact area [mm2]": float(found.area_mm2)}

    return told


class _Lines:
    """A ``LiveWatcher`` that prints what to do."""

    def __init__(self, say: partial[None]) -> None:
        self._say = say

    def show(self, reading: LiveReading, reader: LiveReader, latency: Latency) -> None: ...

    def tell(self, text: str) -> None:
        if text:
            self._say(text)

    def wants_background(self) -> bool:
        return False

    def stopped(self) -> bool:
        return False
