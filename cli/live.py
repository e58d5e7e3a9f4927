# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab live``: what a sensor feels, frame by frame."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
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
    """Show depth, normals and markers of a camera's frames as they come.

    Reads what the profile's blocks allow: depth and normals with normals (colour sensors) or
    depth_response (grey ones), displacements with markers. Pixels beyond what was calibrated are
    marked, and a depth of which most is beyond is refused. The time of each stage is measured.
    """

    profile: Positional[Path]
    """Profile folder of this sensor."""
    background: Literal["camera", "profile"] = "camera"
    """The untouched gel: taken from the camera's first frames, when nothing may touch it, or that
    of the profile."""
    detail: int | None = None
    """Depth is read from images made smaller by this factor, 1 to 4; the finest that this machine
    reads in 30 ms when left out."""
    frames: int | None = None
    """Stop after so many frames; the page's button or Ctrl-C stop it when left out."""
    paced: bool = True
    """A replay keeps its frames' times; --no-paced shows them as fast as they are read."""
    page: bool = True
    """Show the page in the browser; --no-page reads and measures alone."""
    pictures_hz: float = 15.0
    """How often the page is drawn at most."""
    port: int = PORT
    """Port of the page on this machine; 0 takes any that is free."""
    browser: bool = True
    """Whether the page is opened in the browser of this machine."""
    json: bool = False
    """Print the last reading's figures and the time of each stage as JSON."""

    def run(self) -> None:
        from taccel_lab.calibration.capture.camera import CameraLostError
        from taccel_lab.calibration.live.page import LivePage
        from taccel_lab.calibration.live.reader import LiveReader, require_readable
        from taccel_lab.calibration.live.run import run_live
        from taccel_lab.cli.console import notes
        from taccel_lab.processes.start_warp import start_warp
        from taccel_lab.profile import load_profile
        from taccel_lab.report.live_page import PageOptions, live_page

        start_warp()
        if self.frames is not None and self.frames < 1:
            raise InputError(f"--frames is {self.frames}; at least 1 is allowed")
        if not 0.1 <= self.pictures_hz <= 100:
            raise InputError(f"--pictures-hz is {self.pictures_hz:g}; 0.1 to 100 are allowed")
        profile = load_profile(self.profile)
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
                "profile": str(self.profile),
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
