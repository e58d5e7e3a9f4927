# SPDX-License-Identifier: Apache-2.0
"""Everything in a capture folder, in memory; images are read on demand.

``CaptureSet`` is the part that colour calibration needs; ``CaptureFolder.ball_presses`` gives it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.calibration.capture.captures import CapturedPress, CaptureSet, Frame, Once
from taccel_lab.calibration.capture.schema import (
    BoardEntry,
    EdgeEntry,
    RecordedEntry,
    RecordEntry,
    VideoEntry,
)
from taccel_lab.calibration.capture.split import HOLDOUT_EVERY, PressSplit, split_presses
from taccel_lab.calibration.result import Estimate
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.printable import counted


@dataclass(frozen=True)
class BoardCaptures:
    """Views of one board."""

    entry: BoardEntry
    frames: tuple[Frame, ...]
    reference: Frame | None


@dataclass(frozen=True)
class EdgeCapture:
    """A press of a straight edge."""

    entry: EdgeEntry
    frame: Frame


@dataclass(frozen=True)
class Video:
    """Frames of one motion, in order."""

    entry: VideoEntry
    source: str
    sha256: str
    """Hash of the file, or of the frames' hashes in order."""
    frame_count: int
    """Count of the frames that decode."""
    frames: Callable[[], Iterator[np.ndarray]]
    """Reads them, RGB uint8, one after another."""
    stated_count: int = 0
    """Frames that the file says it has; 0 when it does not say."""


@dataclass(frozen=True)
class MarkerCaptures:
    """Dots at rest, and in motion."""

    rest: Frame | None
    """Frame at rest as stated, or the background; without it the videos are asked
    (``find_rest``)."""
    pitch_x_mm: float | None
    pitch_y_mm: float | None
    videos: tuple[Video, ...]
    labels: dict[str, np.ndarray] = field(default_factory=dict)
    """Columns of measured dots (``u_px, v_px, du_px, dv_px``), each of shape [dot]: places without
    load, and the way from there to where they are in ``labels_frame``."""
    labels_frame: Frame | None = None
    """Image of the measured dots, where it is not the one at rest."""
    once: Once = field(default_factory=Once, init=False, repr=False, compare=False)


@dataclass(frozen=True)
class ForceRecord:
    """A checked record of forces."""

    entry: RecordEntry
    source: str
    sha256: str
    columns: dict[str, np.ndarray]
    """Columns by name, each of shape [row]."""
    zero: Estimate | None = None
    """What the load cell read in air [N], which is taken off; None where no rows tell it."""

    @property
    def name(self) -> str:
        """Name of the file without its folder."""
        return self.source.replace("\\", "/").rsplit("/", 1)[-1]

    def sigma_n(self) -> np.ndarray | None:
        """Standard deviation of each force [N], shape [row]; None where the record does not say."""
        if "sigma_n" in self.columns:
            return self.columns["sigma_n"]
        if self.entry.force_sigma_n is None:
            return None
        return np.full(len(next(iter(self.columns.values()))), self.entry.force_sigma_n)


def in_words(assumed: Mapping[str, str]) -> str:
    """Assumptions as one sentence, for provenance."""
    return "; ".join(f"{name}: {text}" for name, text in assumed.items())


def source_of(provenance: Mapping[str, str], otherwise: str) -> str:
    """Where captures come from, as their manifest states it, and what was assumed of them.

    ``otherwise``: their own path, where the manifest says nothing.
    """
    source = provenance.get("source", otherwise)
    assumed = provenance.get("assumed")
    return source if assumed is None else f"{source}; assumed: {assumed}"


@dataclass(frozen=True)
class CaptureFolder:
    """Everything that was captured of one sensor."""

    source: str
    root: Path
    sensor: str
    unit: str | None
    background: Frame | None
    untouched: tuple[Frame, ...]
    mask: np.ndarray | None
    """Pixels that may be used, bool, shape [height_px, width_px]; None: all."""
    mm_per_px: tuple[float, float] | None
    """Scale in x and y where the manifest states it [mm/px]."""
    ball_radius_mm: float | None
    presses: tuple[CapturedPress, ...]
    boards: tuple[BoardCaptures, ...] = ()
    edges: tuple[EdgeCapture, ...] = ()
    markers: MarkerCaptures | None = None
    records: tuple[ForceRecord, ...] = ()
    provenance: dict[str, str] = field(default_factory=dict)
    heldout: tuple[str, ...] | None = None
    """Names of the presses that the manifest holds out; None where it leaves that to the rule."""
    rectified: bool = False
    """Whether the images are rectified."""
    design: dict[str, Any] = field(default_factory=dict)
    """Parameters of the catalogue's design that were measured on this unit."""
    by_diameter: bool = False
    """True where the manifest states the ball's diameter: no radius can be taken for one."""
    assumed: dict[str, str] = field(default_factory=dict)
    """What no file states, by the name of the value: what was taken, and why."""
    recorded: RecordedEntry | None = None
    """How it was recorded, where taccel-lab did that."""
    once: Once = field(default_factory=Once, init=False, repr=False, compare=False)

    def split(self, holdout_every: int = HOLDOUT_EVERY) -> PressSplit:
        """Presses to fit and to hold out, by names and labels alone (``split_presses``)."""
        return split_presses(self.presses, holdout_every, self.heldout, self.source)

    def fitted(self, holdout_every: int = HOLDOUT_EVERY) -> CaptureFolder:
        """The folder without its held-out presses, for stages that only fit: with too few presses
        to hold one out, it is the whole."""
        if len(self.presses) < holdout_every:
            return self
        train = self.split(holdout_every).train
        return replace(self, presses=tuple(self.presses[i] for i in train))

    def contents(self) -> dict[str, int]:
        """How many there are of each kind of capture."""
        return {
            "background": int(self.background is not None),
            "untouched": len(self.untouched),
            "ball_presses": len(self.presses),
            "labelled_presses": sum(press.circle is not None for press in self.presses),
            "boards": len(self.boards),
            "board_views": sum(len(board.frames) for board in self.boards),
            "edges": len(self.edges),
            "marker_images": int(self.markers is not None),
            "marker_videos": 0 if self.markers is None else len(self.markers.videos),
            "force_records": len(self.records),
        }

    def grid(self, mm_per_px: tuple[float, float] | None = None) -> PixelGrid:
        """Pixel grid at the given scale, or at the stated one; InputError without either."""
        scale = mm_per_px or self.mm_per_px
        if scale is None:
            raise InputError(
                f"{self.source}: no scale; give mm_per_px_x and mm_per_px_y, or calibrate the "
                "scale first (taccel-lab calibrate scale)"
            )
        height, width = self.require_background().image().shape[:2]
        return PixelGrid(width, height, *scale)

    def require_background(self) -> Frame:
        """The background; InputError without one."""
        if self.background is None:
            raise InputError(
                f"{self.source}: no background; give an image of the untouched sensor as "
                'background = "..."'
            )
        return self.background

    def ball_radii_mm(self) -> dict[float, int]:
        """Radii of the balls that were used [mm], with how many presses each made."""
        radii = [press.radius_mm or self.ball_radius_mm for press in self.presses]
        counts = Counter(radius for radius in radii if radius is not None)
        return dict(counts.most_common())

    def ball_presses(
        self, mm_per_px: tuple[float, float] | None = None, radius_mm: float | None = None
    ) -> CaptureSet:
        """The presses of one ball for scale, contacts and colour; InputError says what is missing.

        Without ``radius_mm`` it is the ball of ``[indenter]``, or the one that most presses were
        made with. Presses of other balls are left out, which the provenance says.
        """
        background = self.require_background()
        if not self.presses:
            raise InputError(f"{self.source} holds no presses; at least one image is needed")
        radius = radius_mm or self.ball_radius_mm or next(iter(self.ball_radii_mm()), None)
        if radius is None:
            raise InputError(
                f"{self.source}: the radius of the ball is missing; give [indenter] radius_mm"
            )
        presses = tuple(
            press
            for press in self.presses
            if (press.radius_mm or self.ball_radius_mm or radius) == radius
        )
        if not presses:
            raise InputError(
                f"{self.source} holds no press of a ball of {radius:g} mm; the balls are of "
                f"{', '.join(f'{r:g}' for r in self.ball_radii_mm())} mm"
            )
        stated = self.heldout
        of_others = {press.name for press in self.presses} - {press.name for press in presses}
        provenance = dict(self.provenance)
        if len(presses) < len(self.presses):
            provenance["left_out"] = (
                f"{counted(len(self.presses) - len(presses), 'press', 'presses')} of other balls"
            )
        image = background.image()
        mask = np.ones(image.shape[:2], dtype=bool) if self.mask is None else self.mask
        return CaptureSet(
            source=self.source,
            sensor=self.sensor,
            background=image,
            background_sha256=background.sha256,
            mask=mask,
            ball_radius_mm=radius,
            grid=self.grid(mm_per_px),
            presses=presses,
            provenance=provenance,
            heldout=None if stated is None else tuple(n for n in stated if n not in of_others),
        )


def contents_in_words(contents: Mapping[str, int]) -> str:
    """What ``CaptureFolder.contents`` counts, such as ``1 board, 3 edges``; empty for none."""
    parts = []
    for key, count in contents.items():
        many = key.replace("_", " ")
        one = many.removesuffix("es") if many.endswith("presses") else many.removesuffix("s")
        if count:
            parts.append(counted(count, one, many))
    return ", ".join(parts)
