# SPDX-License-Identifier: Apache-2.0
"""The manifest ``captures.toml`` of a capture folder: what was pressed where, on which sensor.

``docs/captures.md`` explains the format with an example; ``load_captures`` reads it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import takewhile
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, AwareDatetime, Field, model_validator

from taccel_lab.files.inner_path import require_inner_name
from taccel_lab.files.output_folder import CAPTURES
from taccel_lab.files.strict_model import Flag, Number, StrictModel, Whole
from taccel_lab.printable import printable

MANIFEST_NAME = CAPTURES
SCHEMA_VERSION = 2
"""Version 1 held the background and the ball presses alone; it is still read."""

MAX_MM_PER_PX = 1.0
MIN_MM_PER_PX = 1e-4
MAX_RADIUS_MM = 50.0
MIN_RADIUS_MM = 0.05
SAME_BALL = 0.01
"""Share of a ball's diameter that twice its radius may differ from it by, as rounded numbers do."""
MAX_EDGE_MM = 200.0
MIN_EDGE_MM = 0.1

FileName = Annotated[str, Field(min_length=1), AfterValidator(require_inner_name)]
"""A file of the folder, relative to the manifest."""


class SphereIndenter(StrictModel):
    """A ball, the calibration target whose surface normals are known everywhere."""

    kind: Literal["sphere"] = "sphere"
    radius_mm: Number = Field(gt=MIN_RADIUS_MM, le=MAX_RADIUS_MM)
    """Ball radius [mm], 0.05 to 50; half of the diameter where that alone is given."""
    diameter_mm: Number | None = None
    """Diameter [mm], as callipers say it: nobody takes it for a radius then."""

    @model_validator(mode="before")
    @classmethod
    def _by_diameter(cls, given: Any) -> Any:
        if isinstance(given, Mapping) and "radius_mm" not in given:
            diameter = given.get("diameter_mm")
            if isinstance(diameter, (int, float)):
                return {**given, "radius_mm": diameter / 2}
        return given

    @model_validator(mode="after")
    def _check_diameter(self) -> Self:
        if self.diameter_mm is not None and not math.isclose(
            self.diameter_mm, 2 * self.radius_mm, rel_tol=SAME_BALL
        ):
            raise ValueError(
                f"diameter_mm is {self.diameter_mm:g}, twice the radius_mm of "
                f"{self.radius_mm:g} is {2 * self.radius_mm:g}; give one of them, or both of "
                "one ball"
            )
        return self


class CircleEntry(StrictModel):
    """Contact circle in the image; pixel (0, 0) is the centre of the top left pixel."""

    u_px: Number
    """Column of the centre [px]."""
    v_px: Number
    """Row of the centre [px]."""
    radius_px: Number = Field(gt=0.0)
    """Radius of the circle in columns [px]."""


StageMm = Annotated[Number, Field(ge=-1e4, le=1e4)]


class SpherePress(StrictModel):
    """One image of a ball press, with what a stage and a load cell said."""

    image: FileName
    """Image file, relative to the manifest."""
    name: str | None = Field(default=None, min_length=1)
    """Name used in reports; the file's stem when missing."""
    contact: CircleEntry | None = None
    """Contact circle when it is known; found in the image otherwise."""
    radius_mm: Number | None = Field(default=None, gt=MIN_RADIUS_MM, le=MAX_RADIUS_MM)
    """Radius of the ball of this press, where it is not that of ``indenter`` [mm]."""
    depth_mm: Number | None = Field(default=None, ge=0.0, le=50.0)
    """Travel past first touch [mm]."""
    force_n: Number | None = Field(default=None, ge=0.0, le=1e3)
    """Normal force [N], positive into the gel."""
    stage_mm: tuple[StageMm, StageMm] | None = None
    """Where a stage pressed, along any two axes at right angles in the plane of the gel [mm]."""


class BoardEntry(StrictModel):
    """Views of one calibration board, or presses of one into the gel."""

    kind: Literal["chessboard", "charuco", "dots", "pins"]
    """``dots`` are printed ones, or the dents of a board of pins or holes that is pressed into the
    gel. Captures of earlier versions call these ``pins``."""
    columns: Whole = Field(ge=2, le=200)
    """Inner corners (chessboard), squares (charuco) or dots along a row."""
    rows: Whole = Field(ge=2, le=200)
    pitch_mm: Number | None = Field(default=None, gt=0.0, le=200.0)
    """Square size or distance of dots [mm]; without it the board gives intrinsics, no scale."""
    marker_mm: Number | None = Field(default=None, gt=0.0, le=200.0)
    """ArUco marker size of a charuco board [mm]."""
    dictionary: str = "DICT_4X4_50"
    """OpenCV's name of the ArUco dictionary."""
    on_gel: Flag = False
    """The board lies on, or is pressed into, the contact face: it gives scale and pose of the gel.
    Otherwise it is shown to the camera from many sides: intrinsics and distortion."""
    images: list[FileName] = Field(min_length=1)
    reference: FileName | None = None
    """Image without contact that a pressed board is compared with; ``background`` if missing."""


class LineEntry(StrictModel):
    """A line in the image, by its middle."""

    u_px: Number
    v_px: Number
    length_px: Number = Field(gt=0.0)
    angle_deg: Number
    """Angle from the image's x axis towards its y axis (clockwise as seen)."""


class EdgeEntry(StrictModel):
    """A press of a straight edge of known length."""

    image: FileName
    length_mm: Number = Field(gt=MIN_EDGE_MM, le=MAX_EDGE_MM)
    """Length of the edge that touches [mm]."""
    dihedral_deg: Number = Field(default=90.0, gt=0.0, lt=180.0)
    """Angle between its faces. Nothing reads it; captures of earlier versions have it."""
    line: LineEntry | None = None
    """Where the edge is in the image, when it is known; found otherwise."""


class VideoEntry(StrictModel):
    """Frames of one motion, in order: a video file, or images."""

    file: FileName | None = None
    frames: list[FileName] = Field(default_factory=list)
    """Images relative to the manifest; a single entry may hold wildcards (``video/*.png``)."""
    fps: Number | None = Field(default=None, gt=0.0, le=1e4)
    motion: Literal["press", "shear", "twist", "free"] = "free"


class MarkersEntry(StrictModel):
    """Dots painted on the gel."""

    rest: FileName | None = None
    """Image at rest; the background if missing, or else frames of the videos in which the gel
    rests."""
    labels: FileName | None = None
    """CSV ``u_px, v_px, du_px, dv_px``: where dots that somebody has measured lie without any load,
    and how far from there they lie in ``labels_image``. For validation."""
    labels_image: FileName | None = None
    """Image of the measured dots; the one at rest if missing."""
    pitch_x_mm: Number | None = Field(default=None, gt=0.0, le=50.0)
    pitch_y_mm: Number | None = Field(default=None, gt=0.0, le=50.0)
    videos: list[VideoEntry] = Field(default_factory=list)


class ToolEntry(StrictModel):
    """What touches the gel in a force record."""

    kind: Literal["sphere", "cylinder", "flat"] = "sphere"
    """``cylinder``: a flat round punch; ``flat``: a plate larger than the gel."""
    radius_mm: Number | None = Field(default=None, gt=0.05, le=500.0)
    center_mm: tuple[Number, Number] = (0.0, 0.0)
    """Where on the gel, gel frame [mm]."""


class RecordEntry(StrictModel):
    """A record of forces: a CSV with a header, columns named with their unit."""

    file: FileName
    kind: Literal["indentation"]
    """Columns ``depth_mm, force_n``; ``sigma_n`` is optional."""
    tool: ToolEntry = ToolEntry()
    force_sigma_n: Number | None = Field(default=None, gt=0.0, le=100.0)
    """Standard deviation of a force reading [N]."""


class SplitEntry(StrictModel):
    """Which presses are held out for the figures, frozen before any image was looked at."""

    heldout: list[str] = Field(min_length=1)
    """Names of presses."""


class RecordedEntry(StrictModel):
    """How ``taccel-lab capture record`` made the folder; it goes on only with one that has this."""

    camera: str = Field(min_length=1)
    """Id by which the camera is found again, or the path of what was replayed."""
    controls: dict[str, str] = Field(default_factory=dict)
    """What was said of exposure, gain and white balance when they were locked."""
    begun: AwareDatetime | None = Field(default=None, strict=True)
    """When the untouched gel was taken, UTC; not known of folders of earlier versions."""
    framing: str = "whole images"
    """What was cut and made smaller before anything was written."""
    left_out: list[str] = Field(default_factory=list)
    """What a short session does without, in words."""


class CaptureManifest(StrictModel):
    """Contents of ``captures.toml``, version 2; every part is optional but ``sensor``."""

    schema_version: Literal[1, 2]
    sensor: str = Field(
        min_length=1, max_length=1000, pattern=r"^([a-z0-9_]+|[^\x00-\x1f]*/[^\x00-\x1f]*)$"
    )
    """Sensor family in the catalogue, such as ``gelsight``, or the folder of a profile beside the
    manifest, such as ``../mine/profile``: it has a slash."""
    unit: str | None = Field(default=None, min_length=1)
    """Serial number or nickname of this very sensor."""
    background: FileName | None = None
    """Image of the untouched sensor, relative to the manifest."""
    untouched: list[FileName] = Field(default_factory=list)
    """Further images of the untouched sensor, at other times: noise and drift."""
    mask: FileName | None = None
    """Grey image of the same size; pixels that are 0 are never used (dust, markers, frame)."""
    mm_per_px_x: Number | None = Field(default=None, ge=MIN_MM_PER_PX, le=MAX_MM_PER_PX)
    """Scale along the image's rows [mm/px], where it is known."""
    mm_per_px_y: Number | None = Field(default=None, ge=MIN_MM_PER_PX, le=MAX_MM_PER_PX)
    """Scale along the image's columns [mm/px]."""
    source: str | None = None
    """Where the captures come from, free text kept as provenance."""
    license: str | None = None
    """Licence of the captures, free text kept as provenance."""
    recorded: RecordedEntry | None = None
    """Facts of the recording, of folders that taccel-lab recorded itself."""
    rectified: bool = Field(default=False, strict=True)
    """Whether the images are rectified: one scale holds everywhere."""
    raw_sha256: dict[str, str] = Field(default_factory=dict)
    """SHA-256 of the files that these were made of, by name (taccel-lab capture rectify)."""
    assumed: dict[str, str] = Field(default_factory=dict)
    """What no file stated when the captures were imported, by the name of the value: what was
    taken, and why. A person who has checked a value takes its line out."""
    design: dict[str, Flag | Number | str] = Field(default_factory=dict)
    """Parameters of the catalogue's design that were measured on this unit, such as
    ``thickness_mm``, the gel's."""
    indenter: SphereIndenter | None = None
    presses: list[SpherePress] = Field(default_factory=list)
    split: SplitEntry | None = None
    """Presses that are held out; chosen by names and labels when missing."""
    boards: list[BoardEntry] = Field(default_factory=list)
    edges: list[EdgeEntry] = Field(default_factory=list)
    markers: MarkersEntry | None = None
    records: list[RecordEntry] = Field(default_factory=list)


_FIRST = ("schema_version", "sensor", "unit", "background", "untouched", "mask")
_THEN = ("mm_per_px_x", "mm_per_px_y", "source", "license")
_FREE = ("unit", "source", "license", "assumed", "recorded")
"""Free text, which may quote anything."""


def manifest_text(manifest: Mapping[str, Any], notes: Sequence[str] = ()) -> str:
    """TOML of the keys of ``CaptureManifest``, what is read first at its head, under ``notes`` as
    comments. Free text is made printable."""
    import tomli_w

    keys = [*(key for key in (*_FIRST, *_THEN) if key in manifest)]
    keys += [key for key in manifest if key not in keys]
    # File names stay as they are, since files are found by them.
    values = {key: _printable(manifest[key]) if key in _FREE else manifest[key] for key in keys}
    lines = (line for note in notes for line in note.splitlines())
    return "".join(f"# {printable(line)}\n" for line in lines) + tomli_w.dumps(values)


def manifest_notes(path: Path) -> tuple[str, ...]:
    """The comments at the head of a manifest, as ``manifest_text`` writes them."""
    lines = path.read_text(encoding="utf-8").splitlines()
    head = takewhile(lambda line: line.startswith("#"), lines)
    return tuple(line.removeprefix("# ") for line in head)


def _printable(value: Any) -> Any:
    if isinstance(value, str):
        return printable(value)
    if isinstance(value, Mapping):
        return {key: _printable(inner) for key, inner in value.items()}
    return [_printable(inner) for inner in value] if isinstance(value, list) else value
