# SPDX-License-Identifier: Apache-2.0
"""One recording session, from the first frame to the last: frames in, a growing capture folder and
what to show out, to whoever watches.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field, replace
from typing import Literal, Protocol

import numpy as np

from taccel_lab.calibration.capture.camera.camera import (
    Camera,
    CameraInfo,
    ControlLock,
    ControlValues,
    Framing,
    Gap,
    Shot,
    shots,
)
from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.calibration.capture.coverage import (
    Advice,
    cell_name,
    cell_of,
    contact_radius_mm,
    next_press,
)
from taccel_lab.calibration.capture.guide import capture_plan
from taccel_lab.calibration.capture.load import MIN_SIZE_PX
from taccel_lab.calibration.capture.sensor_facts import catalogue_scale, sensor_facts
from taccel_lab.calibration.circles.contact_finder import detect_contact
from taccel_lab.calibration.record.folder import RecordFacts, RecordFolder
from taccel_lab.calibration.record.lamps import (
    FrozenWatch,
    Lamp,
    blur_lamp,
    controls_lamp,
    drift_lamp,
    flicker_lamp,
    saturation_lamp,
    touched_pixels,
)
from taccel_lab.calibration.record.trigger import CONTACT, Phase, Seen, Trigger
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.guards import require_size
from taccel_lab.reading.light import fit_light
from taccel_lab.reading.thumb import thumb
from taccel_lab.reading.whole_frame import BrokenFrameError

LAMPS_EVERY_S = 0.4
UNTOUCHED_COUNT = 6
"""Pictures of the untouched gel over a session, the background among them."""
MESSAGES = 6


@dataclass(frozen=True)
class SessionStatus:
    """What there is to show after a frame."""

    phase: Phase
    prompt: str
    """What to do now, one or two sentences."""
    taken: int
    wanted: int
    image: np.ndarray | None
    """The last frame, RGB uint8, shape [h, w, 3]."""
    change: np.ndarray | None
    """Its smoothed colour change, small [levels]."""
    noise_levels: float
    circle: ContactCircle | None
    """Contact circle of the press that was taken last, while it is there."""
    circles: tuple[ContactCircle | None, ...]
    """Contact circles of all presses; None where none was found."""
    advice: Advice | None
    lamps: tuple[Lamp, ...]
    messages: tuple[str, ...]
    """What happened, the newest first."""
    finished: bool = False
    unseen: str = ""
    """Why the untouched gel cannot be measured, in a sentence; empty where it can."""


@dataclass
class Recorder:
    """Decides what is taken, and keeps what there is to show."""

    folder: RecordFolder
    facts: RecordFacts
    wanted: int
    trigger: Trigger = field(default_factory=Trigger)
    finished: bool = False
    _circles: list[ContactCircle | None] = field(default_factory=list)
    _background: np.ndarray | None = None
    _shot: Shot | None = None
    _seen: Seen | None = None
    _circle: ContactCircle | None = None
    _lamps: tuple[Lamp, ...] = ()
    _blur: Lamp | None = None
    _lamps_s: float = float("-inf")
    _messages: deque[str] = field(default_factory=lambda: deque(maxlen=MESSAGES))
    _since_untouched: int = 0
    _resumed: bool = False
    _gap: str = ""
    _frozen: FrozenWatch = field(default_factory=FrozenWatch)
    _hangs: str = ""

    def __post_init__(self) -> None:
        self._background = self.folder.background
        facts = sensor_facts(self.facts.sensor)
        self._grey = facts is not None and facts.is_grey
        self._depth_mm = capture_plan(self.facts.sensor).depth_mm
        for name in self.folder.presses:
            self._circles.append(self._find(self.folder.image(name), name)[0])
        self._resumed = self._background is not None
        if self._resumed:
            self._say(f"going on with {self.folder.path}: {len(self._circles)} presses are there")

    def opened(self, info: CameraInfo, locks: list[ControlLock]) -> None:
        """The camera was opened, for the first time or again.

        Raises:
            InputError: The folder was begun with another one.
        """
        self.facts = replace(self.facts, camera=info, locks=tuple(locks))
        self._frozen.replayed = info.replayed
        before = self.folder.manifest.get("recorded", {}).get("camera", "")
        # Other ids name a port, which others take, too.
        if before.startswith("usb-") and not info.replayed and before != info.id:
            raise InputError(
                f"{self.folder.path} was begun with the camera {before}, this is {info.id}; name a "
                "new folder for another sensor"
            )
        for lock in locks:
            self._say(str(lock))
        if self._gap:
            self._say("the camera is back")
            self._gap = ""

    def lost(self, gap: Gap) -> SessionStatus:
        """The camera is gone."""
        if not self._gap:
            self._say(gap.reason)
        self._gap = gap.reason
        return self.status()

    def see(self, shot: Shot) -> SessionStatus:
        """Take a frame in, and its picture where it is time.

        Raises:
            InputError: Its size is not the folder's, or, at the first frame of a new folder, it is
                too small or the catalogue's scale cannot be taken for it.
        """
        if self._shot is None and self._background is None:
            height, width = shot.image.shape[:2]
            if min(width, height) < MIN_SIZE_PX:
                raise InputError(
                    f"the camera gives {width}x{height} px; at least {MIN_SIZE_PX}x{MIN_SIZE_PX} "
                    "px are needed"
                )
            if self.facts.scale == "catalogue":
                catalogue_scale(self.facts.sensor, width, height)  # Refuses what cannot have it.
        self._hangs = self._frozen.see(shot)
        if self._background is not None:
            require_size(
                "an image of the camera",
                shot.image.shape[1::-1],
                f"the folder {self.folder.path} has",
                self._background.shape[1::-1],
                "give --size, --crop and --resize as before, or name a new folder",
            )
        had_rest = self.trigger.rest is not None
        seen = self.trigger.see(shot.image, shot.time_s)
        self._shot, self._seen = shot, seen
        if not had_rest and self.trigger.rest is not None:
            self._untouched(shot.image)
        if seen.renewed:
            self._say("the gel keeps a mark of the last press: its untouched picture was renewed")
        if seen.take:
            self._take(shot.image, by_hand=False)
        elif seen.phase == Phase.WAITING:
            self._circle = None
            every = max(2, self.wanted // UNTOUCHED_COUNT)
            if seen.at_rest and self._since_untouched >= every:
                self._untouched(shot.image)
        if shot.time_s - self._lamps_s >= LAMPS_EVERY_S or shot.time_s < self._lamps_s:
            self._lamps, self._lamps_s = self._watch(shot, seen), shot.time_s
        return self.status()

    def take_now(self) -> None:
        """Take the last frame, steady or not."""
        if self._shot is None or self._background is None:
            self._say("nothing to take yet: the untouched gel comes first")
            return
        self._take(self._shot.image, by_hand=True)
        self.trigger.taken()

    def undo(self) -> None:
        """Take the last press out again."""
        name = self.folder.undo_press()
        if name is None:
            self._say("there is no press to undo")
            return
        self._circles.pop()
        self._circle = None
        self._say(f"took {name} out")

    def finish(self) -> None:
        """End the session."""
        if self.complete:
            self.folder.finish()
        self.finished = True

    @property
    def complete(self) -> bool:
        """Whether as many presses are there as were wanted."""
        return len(self.folder.presses) >= self.wanted

    def status(self) -> SessionStatus:
        """What there is to show."""
        seen = self._seen or Seen(Phase.RESTING, False, None)
        advice = self._advice()
        rest = self.trigger.rest
        return SessionStatus(
            phase=seen.phase,
            prompt=self._prompt(seen, advice),
            taken=len(self.folder.presses),
            wanted=self.wanted,
            image=None if self._shot is None else self._shot.image,
            change=seen.change,
            noise_levels=0.0 if rest is None else rest.change_levels,
            circle=self._circle,
            circles=tuple(self._circles),
            advice=advice,
            lamps=self._lamps,
            messages=tuple(self._messages),
            finished=self.finished,
            unseen=seen.unseen,
        )

    def _untouched(self, image: np.ndarray) -> None:
        """The untouched gel: the background at first, then how it is at other times."""
        if self._background is None:
            self.folder.set_background(image, self.facts)
            self._background = image
            self._say("took the untouched gel as background")
        else:
            self._say(f"took the untouched gel again: {self.folder.add_untouched(image)}")
        self._since_untouched = 0

    def _take(self, image: np.ndarray, *, by_hand: bool) -> None:
        circle, fault = self._find(image, "this frame")
        if isinstance(fault, BrokenFrameError) or (circle is None and not by_hand):
            self._say(f"not kept: {fault}")
            return
        name = self.folder.add_press(image)
        self._circles.append(circle)
        self._circle = circle
        self._since_untouched += 1
        if circle is None:
            self._say(f"took {name} by hand, though no contact was found: {fault}")
            return
        where = cell_name(*cell_of(circle, image.shape[1], image.shape[0]))
        self._say(f"took {name}: {where}, a contact {2 * circle.radius_px:.0f} px wide")

    def _find(self, image: np.ndarray, name: str) -> tuple[ContactCircle | None, str | InputError]:
        """The contact as calibrations will find it, or why they will not."""
        background = self._background
        assert background is not None
        stated = self.folder.manifest
        scale = stated.get("mm_per_px_x", 1.0), stated.get("mm_per_px_y", 1.0)
        grid = PixelGrid(image.shape[1], image.shape[0], *scale)
        try:
            channel = "grey" if self._grey else None
            return detect_contact(image, background, grid, name=name, grey=channel).circle, ""
        except InputError as error:
            return None, type(error)(str(error).removeprefix(f"{name}: "))

    def _advice(self) -> Advice | None:
        if self._background is None:
            return None
        height, width = self._background.shape[:2]
        deepest = None
        radius = self.folder.manifest.get("indenter", {}).get("radius_mm")
        scale = self.folder.manifest.get("mm_per_px_x")
        if radius is not None and scale is not None:
            deepest = contact_radius_mm(radius, self._depth_mm) / scale
        found = [circle for circle in self._circles if circle is not None]
        return next_press(found, (width, height), deepest)

    def _prompt(self, seen: Seen, advice: Advice | None) -> str:
        if self._gap:
            return (
                f"The camera is gone ({self._gap}). Plug it in again: recording resumes, "
                "nothing is lost."
            )
        if self.finished:
            return f"Finished: {len(self.folder.presses)} presses in {self.folder.path}."
        if seen.unseen or self._hangs:
            return seen.unseen or self._hangs
        if seen.phase == Phase.RESTING:
            return "Touch nothing: the untouched gel is being measured."
        if seen.phase == Phase.APPROACHING:
            return "Contact. Press straight down, then hold still."
        if seen.phase == Phase.STEADY:
            return "Hold still ..."
        if seen.phase == Phase.TAKEN:
            done = self._circle is not None
            return "Taken. Lift the ball." if done else "Not kept (see below). Lift the ball."
        if self.complete:
            return "All presses are taken. Press finish, or go on where cells are empty."
        return f"Press next: {advice}."

    def _watch(self, shot: Shot, seen: Seen) -> tuple[Lamp, ...]:
        facts = self.facts
        replayed = facts.camera is not None and facts.camera.replayed
        locks = controls_lamp(facts.locks, replayed, "" if seen.unseen else self._hangs)
        if self._background is None or seen.change is None or self.trigger.rest is None:
            return locks, saturation_lamp(shot.image, None)
        touched = touched_pixels(seen.change, CONTACT * self.trigger.rest.change_levels)
        waiting = seen.phase == Phase.WAITING
        if waiting:  # Under a contact the gel's texture moves, which looks like blur.
            self._blur = blur_lamp(shot.image, self._background)
        small = thumb(self._background)
        light = fit_light(thumb(shot.image), small, gradient=False)
        return (
            locks,
            saturation_lamp(shot.image, None if waiting else touched),
            *(() if self._blur is None else (self._blur,)),
            drift_lamp(light, small),
            flicker_lamp(self.trigger.rest.flicker_levels),
        )

    def _say(self, text: str) -> None:
        self._messages.appendleft(text)


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
    values: ControlValues = ControlValues(),
    framing: Framing = Framing(),
    ends_by_itself: bool = True,
) -> SessionStatus:
    """Record until all presses are taken, a watcher ends it, or a replay is over.

    ``ends_by_itself``: when all presses are taken and the ball is lifted.

    Raises:
        InputError: There is no such camera at first, or its images do not fit the folder.
        CameraLostError: It does not open at first.
    """

    def opened(camera: Camera) -> None:
        recorder.opened(camera.info, camera.lock(values))

    with closing(shots(open_, opened)) as stream:
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
