# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab live``, what a sensor feels, frame by frame; and ``taccel-lab view``: results,
sensors and live tasks in the browser."""

from __future__ import annotations

import re
from collections.abc import Generator
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import tyro
from tyro.conf import Positional

from taccel_lab.cli.capture_record import CameraFlags
from taccel_lab.errors import InputError
from taccel_lab.report.live_page import PageOptions

if TYPE_CHECKING:
    import numpy as np

    from taccel_lab.calibration.live.page import LiveSheet
    from taccel_lab.calibration.live.reader import ForceReadings, LiveReader, LiveReading
    from taccel_lab.calibration.live.run import Latency, LiveResult, LiveWatcher
    from taccel_lab.profile import SensorProfile

PORT = 8092


@dataclass(frozen=True, kw_only=True)
class Live(CameraFlags):
    """Show depth, normals, markers and the surface in 3D of a camera's frames, live.

    Reads what the profile's blocks allow: depth and normals with normals (colour sensors) or
    depth_response (grey ones), displacements with markers. Pixels outside the training range are
    marked. A depth with mostly such pixels is not shown. The time of each stage is measured.
    """

    profile: Positional[str]
    """Profile folder of this sensor, or a sensor of the catalogue with a starter profile. Several
    sensors at once: left=PROFILE,right=PROFILE, or one for all, with --camera left=ID,right=ID."""
    background: Literal["camera", "profile"] = "camera"
    """The untouched gel: from the camera's first frames (do not touch it), or from the profile.
    What is replayed is read as by taccel-lab read: against the profile's, and with a starter
    profile against what is found."""
    device: str = "cpu"
    """Device of torch on which colours are read to heights: cpu, cuda:0, ..."""
    frames: int | None = None
    """Stop after this number of frames. Default: stop by the page's button or Ctrl-C."""
    paced: bool = True
    """A video keeps its frames' times; --no-paced shows them as fast as they are read."""
    page: bool = True
    """Show the page in the browser; --no-page reads and measures alone."""
    pictures_hz: float = 15.0
    """Largest number of page updates a second."""
    snapshots: Path = Path("snapshots")
    """Folder for the page's snapshots: image, depth, pressure, force."""
    ros: str | None = None
    """Publish image, depth, contact and wrench as ROS 2 topics under this name, such as
    tactile/left. Needs ROS 2 in this environment."""
    port: int = PORT
    """Port of the page on this machine; 0 takes any that is free."""
    browser: bool = True
    """Whether to open the page in this machine's browser."""
    json: bool = False
    """Print the last reading's figures and the time of each stage as JSON."""

    def run(self) -> None:
        from taccel_lab.calibration.capture.camera.camera import CameraLostError
        from taccel_lab.calibration.live.page import LiveSheet
        from taccel_lab.calibration.live.run import run_together
        from taccel_lab.cli.console import print_json, say
        from taccel_lab.processes.start_warp import start_warp
        from taccel_lab.report.live_page import PageOptions, live_page

        start_warp()
        if self.frames is not None and self.frames < 1:
            raise InputError(f"--frames is {self.frames}; at least 1 is allowed")
        if not 0.1 <= self.pictures_hz <= 100:
            raise InputError(f"--pictures-hz is {self.pictures_hz:g}; 0.1 to 100 are allowed")
        cameras, profiles = named(self.camera, "--camera"), named(self.profile, "PROFILE")
        if unknown := profiles.keys() - cameras.keys() - {""}:
            raise InputError(f"PROFILE names {', '.join(sorted(unknown))}, --camera does not")
        if missing := [] if "" in profiles else sorted(cameras.keys() - profiles.keys()):
            raise InputError(f"PROFILE has none for {', '.join(missing)}; add {missing[0]}=PROFILE")
        given = {name: profiles.get(name, profiles.get("", "")) for name in cameras}
        loaded = {name: self._readable(of) for name, of in given.items()}
        with ExitStack() as stack:
            sheet = None
            if self.page:
                options = PageOptions(port=self.port, browser=self.browser)
                title = f"Live {', '.join(profiles.values())}"
                sheet = LiveSheet(stack.enter_context(live_page(title, options, say)))
            try:
                sessions = [
                    self._session(name, camera, loaded[name], sheet, stack)
                    for name, camera in cameras.items()
                ]
                found = dict(zip(cameras, run_together(sessions), strict=True))
            except CameraLostError as error:
                raise InputError(str(error)) from None
        reports = {name: self._report(name, given[name], result) for name, result in found.items()}
        if self.json:
            print_json(reports[""] if list(reports) == [""] else reports)

    def _readable(self, of: str) -> SensorProfile:
        """The profile of a sensor; InputError for one that tells nothing of a frame."""
        from taccel_lab.calibration.live.reader import require_readable
        from taccel_lab.sensors.profile import stock_sensor
        from taccel_lab.sensors.starters import is_starter

        profile = stock_sensor(of)
        if self.background == "profile" and (profile.background_rgb is None or is_starter(profile)):
            has = "the background of another unit" if is_starter(profile) else "no background"
            raise InputError(f"{of} has {has}; leave --background profile away")
        require_readable(profile)
        return profile

    def _untouched(
        self, profile: SensorProfile, camera: str
    ) -> tuple[SensorProfile, np.ndarray | None]:
        """The untouched gel where it is known before the first frame, and the profile that says
        so; a capture folder is replayed from the gel at rest, as a camera shows it."""
        from taccel_lab.calibration.capture.camera.replay import replayed_files
        from taccel_lab.calibration.capture.schema import MANIFEST_NAME
        from taccel_lab.calibration.live.run import measured_rest
        from taccel_lab.calibration.untouched_frame import UntouchedFrame

        files = replayed_files(camera)
        if self.background == "profile":
            return profile, profile.background_rgb
        if files is None or (files[0] / MANIFEST_NAME).is_file():
            return profile, None
        framing = self.framing()
        found = UntouchedFrame.of(
            profile,
            files[:1],
            fit=lambda image, _: framing.apply(image),
            camera=files[1],
            option="background.png beside what is replayed",
        )
        if found.image is not None or profile.background_rgb is not None:
            rest = found.profile.untouched(found.image, found.name)
            return found.profile, rest.astype("float32")
        # By a first pass, so that no frame is taken away.
        return profile, measured_rest(replace(self, camera=camera).opener(False), framing)

    def _session(
        self,
        name: str,
        camera: str,
        profile: SensorProfile,
        sheet: LiveSheet | None,
        stack: ExitStack,
    ) -> Generator[LiveResult, None, None]:
        """The session of one sensor, whose name is empty where there is no other."""
        from taccel_lab.calibration.live.page import LivePage
        from taccel_lab.calibration.live.reader import LiveReader
        from taccel_lab.calibration.live.ros import RosPublisher
        from taccel_lab.calibration.live.run import live_session

        profile, rest = self._untouched(profile, camera)

        def make_reader(background: np.ndarray) -> LiveReader:
            force = None if profile.force is None else _forces(profile, background)
            return LiveReader(profile, background, force=force, device=self.device)

        watchers: list[LiveWatcher] = []
        if self.ros is not None:
            publisher = RosPublisher(f"{self.ros}/{name}" if name else self.ros)
            stack.callback(publisher.close)
            watchers.append(publisher)
        if sheet is not None:
            watchers.append(LivePage(sheet, self.pictures_hz, self.snapshots / name, name))
        own, lines = replace(self, camera=camera), _Lines(name)
        watchers.insert(0, lines)
        return live_session(
            make_reader,
            own.opener(self.paced, lines.tell),
            watchers,
            background=rest,
            frames=self.frames,
            values=self.values(),
            framing=self.framing(),
        )

    def _report(self, name: str, profile: str, result: LiveResult) -> dict[str, Any]:
        """What a session came to, ready for JSON; printed where that is not asked for."""
        from taccel_lab.cli.console import results

        reader = result.reader
        if reader is None or result.last is None:
            ended = f"{name or self.camera} ended before a frame was read"
            raise InputError(f"{ended}. {result.unseen}" if result.unseen else ended)
        found = result.latency.figures()
        if self.json:
            return {
                "profile": profile,
                "maps_px": [reader.grid.width_px, reader.grid.height_px],
                "locks": {lock.name: lock.text for lock in result.locks},
                "remarks": list(result.remarks),
                "last": {
                    **result.last.figures,
                    "refused": result.last.refused,
                    "forces": dict(result.last.forces),
                },
                "latency": found,
            }
        console = results()
        busy, cpu = found["busy_ms"], found["cpu_ms"]
        console.print(
            f"{name}{': ' if name else ''}{found['frames']} frames, {found['rate_hz']:.1f} a "
            f"second; work {busy['median']:.1f} ms a frame (95 %: {busy['p95']:.1f} ms), "
            f"{cpu['median']:.1f} ms of a core",
        )
        for name, ms in found["stages_ms"].items():
            line = f"  {name}: {ms['median']:.1f} ms (95 %: {ms['p95']:.1f} ms)"
            console.print(line)
        return {}


_NAMED = re.compile(r"([A-Za-z]\w*)=(.+)")


def named(text: str, what: str) -> dict[str, str]:
    """``left=A,right=B`` by name; any other text under the empty name.

    Raises InputError for a name that stands twice, and for a part without one.
    """
    parts = [_NAMED.fullmatch(part.strip()) for part in text.split(",")]
    if not any(parts) or Path(text).exists():
        return {"": text}
    if not all(parts):
        raise InputError(f"{what} is {text!r}; several are given as left=A,right=B")
    pairs = [(part[1], part[2]) for part in parts if part is not None]
    if len(dict(pairs)) < len(pairs):
        raise InputError(f"{what} is {text!r}; each name may stand once")
    return dict(pairs)


def _forces(profile: SensorProfile, background: np.ndarray) -> ForceReadings:
    """What the profile's force model says of a frame, by the names of the page."""
    from taccel_lab.learning.force.read_force import ForceReader

    reader = ForceReader(profile, background=background)

    def read(image: np.ndarray, _: np.ndarray) -> dict[str, float]:
        try:
            found = reader.read(image, "frame")
        except InputError:  # Too few markers are seen: nothing is read from this frame.
            return {}
        if found.outside:
            return {}
        forces = {}
        for axis, force, sigma in zip("xyz", found.force_n, found.sigma[:3], strict=True):
            forces[f"F{axis} [N]"], forces[f"F{axis} +- [N]"] = float(force), float(sigma)
        return forces | {"contact area [mm2]": float(found.area_mm2)}

    return read


class _Lines:
    """A ``LiveWatcher`` that prints what to do."""

    def __init__(self, name: str) -> None:
        self._name = name

    def show(self, reading: LiveReading, reader: LiveReader, latency: Latency) -> None: ...

    def tell(self, text: str) -> None:
        from taccel_lab.cli.console import say

        if text:
            say(f"{self._name}: {text}" if self._name else text)

    def wants_background(self) -> bool:
        return False

    def stopped(self) -> bool:
        return False


@dataclass(frozen=True)
class ViewCommand:
    """Look at a result in the browser, step by step: gel with pressure, stress and displacement,
    sections, force arrows, sensor image with markers.

    The type of SOURCE is detected: a sensor or profile, a press (--states keeps every step), a
    study, a data set, or a recorded task (taccel-lab task record). A task runs live.
    Ctrl-C closes the page. Needs the extra view: pip install 'taccel-lab[view]'.
    Example: taccel-lab view out/press
    """

    source: Positional[str]
    """Folder that a command wrote, sensor of the catalogue, or task."""
    page: tyro.conf.OmitArgPrefixes[PageOptions] = field(default_factory=PageOptions)
    """Where the page is served and how it looks."""
    seed: int = 0
    """Start of a live task."""
    device: str = "cpu"
    """Device of a live task: cpu, cuda:0 or auto."""

    def run(self) -> None:
        from taccel_lab.cli.console import say
        from taccel_lab.guards import require_seed
        from taccel_lab.model.launches import require_device
        from taccel_lab.processes.start_warp import start_warp
        from taccel_lab.report.live_page import viser_module
        from taccel_lab.viewer.pages import find_source, serve_source

        start_warp()
        viser_module()
        require_device(self.device)
        require_seed(self.seed)
        source = find_source(self.source)
        serve_source(source, self.page, say, seed=self.seed, device=self.device)
