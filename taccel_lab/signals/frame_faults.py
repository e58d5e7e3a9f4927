# SPDX-License-Identifier: Apache-2.0
"""``FrameFaults``: how often frames of a camera are faulty, by kind, and by how much.

What a frame judge names on a real unit is drawn here under the same names, for a policy or an
estimator to train on. ``FaultyFrames`` gives such frames, ``frame_operators`` one of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from taccel_lab.errors import InputError
from taccel_lab.guards import require_known, require_range

KINDS = (
    "lost_rows", "shift", "torn", "stuck", "drift", "wear", "dead_lamp", "bands", "delay",
)  # fmt: skip
"""Kinds of faults; bit k of a frame's ``faults`` is the k-th. A frame may have several."""
FRAME_KINDS = ("lost_rows", "shift", "torn", "stuck")
"""Faults of single frames; others are of all frames of an episode."""
LIGHT_KINDS = ("drift", "wear", "dead_lamp", "bands")
"""Faults of the light, which the camera's noise comes on top of; others are of whole frames."""
MOST_FRAMES = {"delay_frames": 16, "stuck_frames": 64, "drift_frames": 100_000}
Ends = tuple[float, float]


@dataclass(frozen=True)
class FrameFaults:
    """Chances of faults, 0 to 1, and ranges that they are drawn evenly from.

    Chances of ``lost_rows``, ``shift``, ``torn`` and ``stuck`` are of a frame; those of the others
    are of an episode, all frames of which have them. Sizes are what was seen of cheap USB cameras
    and worn gels, and parts of the image where they are lengths: none is of a certain unit.
    """

    lost_rows: float = 0.0
    """Rows from one down to the lowest are of a single colour: the transfer ended early."""
    lost_from: Ends = (0.2, 0.95)
    """First of them, as a part of the height."""
    lost_green: float = 0.5
    """Part of them that are green (0, 135, 0), as zeros of YUV are; others are grey (128), as
    blocks that a JPEG lacks are."""
    shift: float = 0.0
    """All rows are moved sideways, and go on at the other side."""
    shift_width: Ends = (0.005, 0.065)
    """Size of that, as a part of the width, at least a pixel: 3 to 40 px of 640."""
    torn: float = 0.0
    """The lower rows are those of the frame before, or moved sideways by ``shift_width``."""
    torn_from: Ends = (0.1, 0.9)
    """First of them, as a part of the height."""
    torn_before: float = 0.5
    """Part of torn frames whose rows are of the frame before."""
    stuck: float = 0.0
    """The frame before comes again, to the bit."""
    stuck_frames: Ends = (1, 12)
    """Number of times that it comes again."""
    drift: float = 0.0
    """Light and exposure change from the first frame on."""
    drift_gain: Ends = (-0.12, 0.25)
    """Change of each channel's gain, as a part of it: white balance and exposure."""
    drift_levels: Ends = (-5.0, 5.0)
    """Change of each channel [levels]."""
    drift_gradient: Ends = (-5.0, 5.0)
    """Change from the middle to the right and to the lower edge, of each channel [levels]."""
    drift_frames: Ends = (1, 60)
    """Frames until it is complete; 1 is a step."""
    wear: float = 0.0
    """A soft patch of the coating is brighter, as its paint is thinner."""
    wear_gain: Ends = (0.02, 0.15)
    """How much brighter in its middle, as a part of the light; below 0: darker."""
    wear_radius: Ends = (0.1, 0.35)
    """Standard deviation of the patch, as a part of half the image."""
    dead_lamp: float = 0.0
    """A channel's lamp is off."""
    lamp_left: Ends = (0.0, 0.1)
    """Part of that channel's light that is left, from other lamps; up to 1 for one that dims."""
    bands: float = 0.0
    """Light of the mains flickers while rows are read one after the other: bands roll down."""
    band_depth: Ends = (0.01, 0.05)
    """Largest change of a row, as a part of its light."""
    band_periods: Ends = (1.5, 4.0)
    """Periods over the height: light flickers at 100 or 120 Hz, rows take 1/60 to 1/30 s."""
    delay: float = 0.0
    """Frames come late."""
    delay_frames: Ends = (1, 3)
    """How late, in frames."""

    def __post_init__(self) -> None:
        for name in (*KINDS, "lost_green", "torn_before"):
            require_range(name, getattr(self, name), 0, 1)
        for name, (low, high, least, most) in self._bounds().items():
            if not least <= low <= high <= most:
                raise InputError(
                    f"{name} is {low:g} to {high:g}; {least:g} to {most:g} is allowed, and the "
                    "lower end first"
                )
            if name in MOST_FRAMES and not (low == int(low) and high == int(high)):
                raise InputError(f"{name} is {low:g} to {high:g}; whole numbers are allowed")

    def _bounds(self) -> dict[str, tuple[float, float, float, float]]:
        """Ranges by name: ends, and what these may be."""
        bounds: dict[str, Ends] = {
            "lost_from": (0, 1), "torn_from": (0, 1), "shift_width": (0, 0.5), "lamp_left": (0, 1),
            "drift_gain": (-0.95, 10), "drift_levels": (-255, 255), "drift_gradient": (-255, 255),
            "wear_gain": (-1, 10), "wear_radius": (0.01, 10),
            "band_depth": (0, 1), "band_periods": (0, 1000),
            **{name: (1, most) for name, most in MOST_FRAMES.items()},
        }  # fmt: skip
        return {name: (*getattr(self, name), *ends) for name, ends in bounds.items()}

    @classmethod
    def of(cls, given: FrameFaults | Mapping[str, Any]) -> FrameFaults:
        """Faults as they are, or those of a table by the names of the fields.

        Raises:
            InputError: Unknown names, and values that are no numbers, pairs of them, or allowed.
        """
        if isinstance(given, cls):
            return given
        if not isinstance(given, Mapping):
            raise InputError(f"faults are a table of chances and ranges, got {given!r}")
        plain = vars(cls())
        checked: dict[str, Any] = {}
        for name, value in given.items():
            require_known("fault", str(name), plain)
            ranged, pair = isinstance(plain[name], tuple), isinstance(value, (list, tuple))
            ends = tuple(value) if pair else (value,)
            if ranged != pair or len(ends) != 1 + ranged or not all(map(_is_number, ends)):
                allowed = "[low, high]" if ranged else "a number"
                raise InputError(f"{name} must be {allowed}, got {value!r}")
            checked[name] = ends if pair else value
        return cls(**checked)

    def __bool__(self) -> bool:
        """Return whether any frame can be faulty."""
        return any(getattr(self, kind) > 0 for kind in KINDS)

    @property
    def of_light(self) -> bool:
        """Whether the light of a frame can be."""
        return any(getattr(self, kind) > 0 for kind in LIGHT_KINDS)

    @property
    def of_wire(self) -> bool:
        """Whether frames can be that come over the wire."""
        return any(getattr(self, kind) > 0 for kind in KINDS if kind not in LIGHT_KINDS)


def _is_number(value: object) -> bool:
    # Whole numbers of TOML may be too large to be a float.
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < 1e9


def kinds_of(faults: int) -> tuple[str, ...]:
    """The kinds of a frame's bits."""
    return tuple(kind for k, kind in enumerate(KINDS) if faults >> k & 1)
