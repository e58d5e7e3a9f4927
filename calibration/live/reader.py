# SPDX-License-Identifier: Apache-2.0
"""Everything that a profile's blocks allow to be read from a frame, and how long each takes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from taccel_lab.calibration.markers.tracking import MarkerTracker
from taccel_lab.calibration.markers.tracks import TrackStatus
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.guards import require_size
from taccel_lab.profile import SensorProfile
from taccel_lab.reading.dots.marker_picture import find_markers
from taccel_lab.reading.frame_judge import FrameJudge
from taccel_lab.reading.light import fit_light
from taccel_lab.reading.pressure import ContactPressure
from taccel_lab.reading.reader import Reader
from taccel_lab.reading.reading import Reading
from taccel_lab.reading.stage_clock import StageClock
from taccel_lab.reading.thumb import thumb
from taccel_lab.reading.whose import unlike

FRAME = "the frame"
"""Name of a frame in refusals."""

ForceReadings = Callable[[np.ndarray, np.ndarray], Mapping[str, float]]
"""Image and background, RGB uint8, in; forces by name and unit out, such as ``{"Fz [N]": 1.2,
"Fz +- [N]": 0.1}``: what ends in +- is the standard deviation of the one before."""


@dataclass(frozen=True)
class SeenMarkers:
    """Where markers are in one frame."""

    uv_px: np.ndarray
    """Places, shape [marker, 2]."""
    rest_px: np.ndarray
    """Places at rest, likewise."""
    seen: np.ndarray
    """Which of them were found in this frame, bool, shape [marker]."""
    unread: str
    """Why the frame is not read, where it is not what the camera saw; empty otherwise."""


@dataclass(frozen=True)
class LiveReading:
    """What one frame shows."""

    image: np.ndarray
    """RGB uint8, shape [height_px, width_px, 3]."""
    reading: Reading | None
    """Reading of ``Reader.read``; None where it refuses the frame, or the profile has no
    block for it."""
    refused: str
    """Reason of a refusal; empty where the frame is read."""
    markers: SeenMarkers | None
    """None without markers."""
    forces: Mapping[str, float]
    """Forces by name; empty where nothing tells them."""
    stages_s: dict[str, float]
    """Time that each stage took [s]."""

    @property
    def press(self) -> ContactPressure | None:
        """What holds the surface so, where that is known."""
        return None if self.reading is None else self.reading.press

    @property
    def figures(self) -> dict[str, Any]:
        """Figures of the reading, ready for JSON; empty without one."""
        return {} if self.reading is None else self.reading.figures()


def require_readable(profile: SensorProfile) -> None:
    """InputError for a profile without any block that tells something of a frame."""
    blocks = (profile.normals, profile.depth_response, profile.markers, profile.force)
    if all(block is None for block in blocks):
        raise InputError(
            f"the profile of {profile.sensor.name} has no normals, depth_response, markers or "
            "force block, so that nothing can be read from a frame; calibrate one first"
        )


class LiveReader:
    """Reads frames of one sensor, one after another."""

    def __init__(
        self,
        profile: SensorProfile,
        background: np.ndarray,
        *,
        force: ForceReadings | None = None,
        device: str = "cpu",
    ) -> None:
        """
        Args:
            profile: With a ``normals`` or ``depth_response`` block for depth, with ``markers`` for
                markers.
            background: The untouched sensor now, RGB, shape [height_px, width_px, 3].
            force: Tells forces of an image, where there is a model for it.
            device: Of torch, on which colours are read to heights.

        Raises:
            InputError: The profile has none of these blocks, or images of another size, or there is
                no such device.
        """
        self.profile, self.force = profile, force
        self.background = background
        require_readable(profile)
        has_depth = profile.normals is not None or profile.depth_response is not None
        grid = profile.grid()
        require_size(
            "an image of the camera",
            background.shape[1::-1],
            "the profile's",
            (grid.width_px, grid.height_px),
            "give --size, --crop and --resize as they were when the captures were recorded",
        )
        self.remarks = tuple(
            f"{text[:1].upper()}{text[1:]}." for text in profile.sensor.provenance.remarks
        )
        """What the profile says of itself, one sentence each."""
        self.unlike_profile = _unlike_profile(profile, background)
        """Why the untouched gel is not that of the profile, in a sentence; empty where it is."""
        self.reader: Reader | None = None
        if has_depth:
            self.reader = Reader(profile, background=background, device=device)
        self.no_pressure = "" if self.reader is None else self.reader.no_press
        self._clock = StageClock() if self.reader is None else self.reader.clock
        self._judge = FrameJudge(background) if self.reader is None else self.reader.judge
        self.tracker: MarkerTracker | None = None
        self.no_markers = ""
        """Why markers are not followed though the profile has some; empty otherwise."""
        if profile.markers is not None:
            try:
                dots = self._judge.dots
                rest = find_markers(background.astype(np.uint8)) if dots is None else dots.markers
                self.tracker = MarkerTracker(rest)
            except InputError as error:
                self.no_markers = str(error)

    @property
    def grid(self) -> PixelGrid:
        """Grid of the maps."""
        return self.profile.grid() if self.reader is None else self.reader.grid

    @property
    def relaxes(self) -> bool:
        """Whether forces depend on the frames before, and on their times."""
        pressed = self.reader is not None and not self.no_pressure
        return bool(self.profile.material.branches) and pressed

    def read(self, image: np.ndarray, time_s: float | None = None) -> LiveReading:
        """Read the next frame, RGB uint8, of the profile's size.

        ``time_s``: when it was taken, for gels that relax; None where that is not known.
        """
        clock, found, refused = self._clock, None, ""
        clock.restart()
        if self.reader is not None:
            try:
                found = self.reader.read(image, FRAME, time_s)
            except InputError as error:
                refused = str(error)
        if refused or self.reader is None:
            clock.begin("frame")
            frame = self._judge.frame(image)
            broken = frame.lost or frame.torn
            if broken is not None:
                clock.begin()
                refused = refused or f"{FRAME} {broken}"
                return LiveReading(image, None, refused, None, {}, clock.stages_s)
        markers = None
        if self.tracker is not None:
            clock.begin("markers")
            self.tracker.advance(image)
            seen = self.tracker.status == TrackStatus.SEEN
            rest, unread = self.tracker.dots.uv_px, self.tracker.unread
            markers = SeenMarkers(self.tracker.uv.copy(), rest, seen, unread)
        forces: Mapping[str, float] = {}
        if self.force is not None:
            clock.begin("force")
            forces = self.force(image, self.background)
        clock.begin()
        return LiveReading(image, found, refused, markers, forces, clock.stages_s)


def _unlike_profile(profile: SensorProfile, background: np.ndarray) -> str:
    own = profile.background_rgb
    if own is None:
        return ""
    seen, known = thumb(background), thumb(own)
    why = unlike(seen, known, fit_light(seen, known, gradient=False))
    if why is None:
        return ""
    return (
        f"The untouched gel is not as this profile knows it: {why}. What is read may be wrong: is "
        "this the sensor that was calibrated, its gel clean and untouched?"
    )
