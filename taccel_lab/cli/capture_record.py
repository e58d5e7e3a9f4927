# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab capture record`` and ``quick``: a camera in, a capture folder out; ``label``: its
circles clicked; and the flags of a camera, for all commands that read one."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tyro.conf import OmitArgPrefixes, Positional

from taccel_lab.errors import InputError, keeping
from taccel_lab.report.live_page import PageOptions

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.calibration.capture.camera.camera import Camera, ControlValues, Framing
    from taccel_lab.calibration.record.folder import RecordFacts
    from taccel_lab.calibration.record.session import SessionStatus


@dataclass(frozen=True, kw_only=True)
class CameraFlags:
    """Flags of a camera, or of files that are replayed in its place."""

    camera: str
    """The camera: its id or serial number, or a part of either that no other has (taccel-lab
    capture devices lists them). The path of a recording (as for taccel-lab read) or of a capture
    folder is replayed instead; that of a data set may go on with the name of its camera:
    demo.hdf5/left_tactile/rgb."""
    size: str | None = None
    """Camera format, WIDTHxHEIGHT. Default: the camera's choice."""
    crop: str | None = None
    """Part of the camera's images to keep: LEFT,TOP,WIDTHxHEIGHT in pixels. Use the same for
    record and live."""
    resize: str | None = None
    """Size to reduce it to, WIDTHxHEIGHT. Use the same for record and live."""
    exposure: float | None = None
    """Exposure to lock, in the camera's units. Default: the present one."""
    gain: float | None = None
    """Gain to lock. Default: the present one."""
    white_balance: float | None = None
    """White balance to lock, usually a temperature in kelvin. Default: the present one."""

    def opener(
        self, paced: bool, unread: Callable[[str], None] | None = None
    ) -> Callable[[], Camera]:
        """Opens the camera; a replay keeps its frames' times when ``paced``, and tells ``unread``
        of frames that cannot be read. Raises InputError for a size that is none."""
        from taccel_lab.calibration.capture.camera.camera import parse_size
        from taccel_lab.calibration.capture.camera.replay import CameraReplay, open_camera

        size = None if self.size is None else parse_size(self.size, "--size")
        return lambda: open_camera(self.camera, size, CameraReplay(paced=paced, unread=unread))

    def framing(self) -> Framing:
        """What is kept of each frame."""
        from taccel_lab.calibration.capture.camera.camera import Framing

        return Framing.parse(self.crop, self.resize)

    def values(self) -> ControlValues:
        """Where the controls are locked."""
        from taccel_lab.calibration.capture.camera.camera import ControlValues

        return ControlValues(self.exposure, self.gain, self.white_balance)


PORT = 8091


@dataclass(frozen=True, kw_only=True)
class _Session(CameraFlags):
    sensor: Positional[str]
    """Sensor of the catalogue (taccel-lab sensors list), or the folder of a profile; flat_pad for
    any other."""
    out: Path
    """Capture folder to write or to continue."""
    radius_mm: float | None = None
    """Radius of the ball [mm]: half of what callipers say."""
    mm_per_px_x: float | None = None
    """Scale along the image's rows [mm/px], if you measured it."""
    mm_per_px_y: float | None = None
    """Scale along the image's columns [mm/px]. Default: that of the rows."""
    scale: Literal["stated", "catalogue", "later"] = "stated"
    """Source of the scale where none is stated: catalogue uses the sensor's usual one, noted as
    assumed; later leaves it open, for an edge or a board."""
    unit: str | None = None
    """Serial number or nickname of this sensor. Default: the camera's."""
    page: bool = True
    """Show the page in the browser; with --no-page the terminal alone says what to do."""
    port: int = PORT
    """Port of the page on this machine; 0 takes any that is free."""
    browser: bool = True
    """Whether to open the page in this machine's browser."""
    origin: str | None = None
    """Where and by whom, kept as provenance."""
    license: str | None = None
    """Licence of the captures, kept as provenance."""
    json: bool = False
    """Print what was recorded as JSON."""

    def run_as(
        self, presses: int | None, quick: bool, made: Sequence[Mapping[str, Any]] = ()
    ) -> None:
        """Record; ``presses`` None: as many as the sensor's plan has. ``made``: by a stage."""
        from taccel_lab.calibration.capture.camera.camera import CameraLostError
        from taccel_lab.calibration.capture.guide import capture_plan
        from taccel_lab.calibration.record.folder import open_record
        from taccel_lab.calibration.record.page import RecordPage
        from taccel_lab.calibration.record.session import Recorder, Watcher, run_session
        from taccel_lab.cli.console import notes, say
        from taccel_lab.report.live_page import live_page

        if presses is not None and not 1 <= presses <= 1000:
            raise InputError(f"--presses is {presses}; 1 to 1000 are allowed")
        facts, framing, open_ = self._facts(quick), self.framing(), self.opener(self.page)
        wanted = presses or capture_plan(self.sensor).press_count
        console = notes()

        with ExitStack() as stack, open_record(self.out, facts, made) as folder:

            def what() -> str:
                kept = (
                    f"{self.out} stays with {len(folder.presses)} of {wanted} presses, and the "
                    "same command continues it"
                )
                return "" if folder.background is None else kept

            stack.enter_context(keeping(what))
            recorder = Recorder(folder, facts, wanted)
            watchers: list[Watcher] = [_Lines(console)]
            if quick:
                _say_left_out(console)
            try:
                if self.page:
                    options = PageOptions(port=self.port, browser=self.browser)
                    title = f"Recording {self.out.name}"
                    server = stack.enter_context(live_page(title, options, say))
                    watchers.append(RecordPage(server, quick))
                status = run_session(
                    recorder,
                    open_,
                    watchers,
                    values=self.values(),
                    framing=framing,
                    ends_by_itself=not self.page,
                )
            except CameraLostError as error:
                raise InputError(str(error)) from None
        self._report(status, quick, folder.out_of_step)

    def _facts(self, quick: bool) -> RecordFacts:
        from taccel_lab.calibration.record.folder import RecordFacts

        x, y = self.mm_per_px_x, self.mm_per_px_y
        if x is None and y is not None:
            raise InputError("--mm-per-px-y was given without --mm-per-px-x; give both, or x alone")
        scale = self.scale
        if quick and scale == "stated" and x is None:
            scale = "catalogue"
        return RecordFacts(
            self.sensor,
            self.radius_mm,
            None if x is None else (x, x if y is None else y),
            scale,
            self.unit,
            self.license,
            quick,
            self.origin or "",
            framing=str(self.framing()),
        )

    def _report(self, status: SessionStatus, quick: bool, out_of_step: str) -> None:
        from taccel_lab.calibration.capture import load_capture_folder
        from taccel_lab.calibration.record.folder import QUICK_LEAVES_OUT
        from taccel_lab.cli.console import print_json, results

        if status.image is None or not (self.out / "captures.toml").is_file():
            ended = (
                f"{self.camera} ended before the untouched gel was measured; nothing was recorded"
            )
            raise InputError(f"{ended}. {status.unseen}" if status.unseen else ended)
        contents = load_capture_folder(self.out).contents()
        if self.json:
            print_json(
                {
                    "out": str(self.out),
                    "presses": status.taken,
                    "wanted": status.wanted,
                    "finished": status.finished,
                    "contents": contents,
                    "lamps": [
                        {"name": lamp.name, "state": lamp.state, "told": lamp.text}
                        for lamp in status.lamps
                    ],
                    "left_out": list(QUICK_LEAVES_OUT) if quick else [],
                    "out_of_step": out_of_step,
                }
            )
            return
        console = results()
        console.print(f"wrote {self.out}: {status.taken} of {status.wanted} presses")
        for lamp in status.lamps:
            if lamp.state in ("warn", "bad"):
                console.print(f"  {lamp.name}: {lamp.text}")
        if out_of_step:
            console.print(out_of_step, soft_wrap=True)
        out = shlex.quote(str(self.out))
        if status.taken < status.wanted:
            console.print("the same command continues it")
        console.print(f"next: taccel-lab capture check {out}")


@dataclass(frozen=True, kw_only=True)
class CaptureRecord(_Session):
    """Record a capture folder from a camera: the untouched gel, then presses of a ball.

    Switches automatic exposure, gain and white balance off, and reports where the camera does not
    hold that. A page in the browser shows the change, the contact, the coverage, what to press
    next, and lamps for saturation, blur and drift. A picture is taken when the contact is still;
    the limits adapt to this camera's noise. Every picture is saved at once. After a crash the same
    command continues. If the camera disconnects, recording resumes when it returns.
    """

    presses: int | None = None
    """Number of presses. Default: that of capture guide."""
    table: Path | None = None
    """Table of the presses that a printer makes meanwhile (printer_presses.csv of capture guide
    --printer): each gets its depth and place."""

    def run(self) -> None:
        from taccel_lab.calibration.capture.printer import read_press_table

        if self.table is None:
            self.run_as(self.presses, quick=False)
            return
        if self.presses is not None:
            raise InputError("--presses and --table both say how many; leave --presses away")
        made = read_press_table(self.table)
        self.run_as(len(made), quick=False, made=made)


@dataclass(frozen=True, kw_only=True)
class CaptureQuick(_Session):
    """Record 20 presses of a ball, without a board and without a load cell.

    The quickest way to depth maps of a sensor. What it leaves out is printed, shown on the page and
    written into the folder. Without --mm-per-px-x the catalogue's usual scale is used and noted as
    assumed. Otherwise as capture record.
    """

    def run(self) -> None:
        from taccel_lab.calibration.record.folder import QUICK_PRESSES

        self.run_as(QUICK_PRESSES, quick=True)


@dataclass(frozen=True)
class CaptureLabel:
    """Correct contact circles by clicks on a page in the browser (needs the extra view).

    Each ball press is shown with its circle: labelled, clicked earlier or found in the image. Three
    clicks on the rim make a circle, more make it better. What is saved goes into contacts.toml of
    the folder, which all commands use; labels of captures.toml and earlier circles stay on record.
    Done, or Ctrl-C, closes the page.
    """

    captures: Positional[Path]
    """Capture folder with captures.toml."""
    where: OmitArgPrefixes[PageOptions] = field(default_factory=PageOptions)
    """Where the page is served and how it looks."""
    json: bool = False
    """Print what was saved as JSON."""

    def run(self) -> None:
        from taccel_lab.calibration.record.label_page import LabelPage
        from taccel_lab.calibration.record.labelling import Labelling
        from taccel_lab.cli.console import print_json, results, say
        from taccel_lab.printable import counted
        from taccel_lab.report.live_page import live_page, serve_until_stopped

        labelling = Labelling.of(self.captures)
        with live_page(f"Labels of {self.captures.name}", self.where, say) as server:
            serve_until_stopped(LabelPage(server, labelling, self.where.dark).done)
        saved = labelling.saved
        if self.json:
            circles = {name: None if c is None else asdict(c) for name, c in saved.items()}
            print_json({"contacts": str(labelling.path), "saved": circles})
            return
        where = f" in {labelling.path}" if saved else ""
        results().print(f"{counted(len(saved), 'press', 'presses')} corrected{where}")
        if saved:
            results().print(f"next: taccel-lab capture check {shlex.quote(str(self.captures))}")


class _Lines:
    """A ``Watcher`` that prints what changes, and what spoils the captures once it does."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._said: tuple[str, ...] = ()
        self._prompt = ""
        self._bad: set[str] = set()

    def show(self, status: SessionStatus) -> None:
        new = []
        for message in status.messages:
            if self._said and message is self._said[0]:
                break
            new.append(message)
        self._said = status.messages
        for message in reversed(new):
            self._console.print(message)
        bad = {lamp.name for lamp in status.lamps if lamp.state == "bad"}
        for lamp in status.lamps:
            if lamp.name in bad - self._bad and lamp.text != status.prompt:
                words = f"{lamp.name}: {lamp.text}"
                self._console.print(words)
        self._bad |= bad
        if status.prompt != self._prompt:
            self._prompt = status.prompt
            words = f"[{status.taken}/{status.wanted}] {status.prompt}"
            self._console.print(words)

    def orders(self) -> list:
        return []


def _say_left_out(console: Console) -> None:
    from taccel_lab.calibration.record.folder import QUICK_LEAVES_OUT

    console.print("A quick session leaves out:")
    for line in QUICK_LEAVES_OUT:
        console.print(f"- {line}")
