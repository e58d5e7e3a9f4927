# SPDX-License-Identifier: Apache-2.0
"""A capture folder that grows with every press, and that a kill leaves whole; and what a person
states of its session, since no camera sees it.

Every image is written beside its name and renamed, then the manifest in the same way: at any moment
the folder is one that ``load_capture_folder`` reads. A kill between the two leaves an image that
no manifest names, which the next press replaces.
"""

from __future__ import annotations

import fcntl
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import numpy as np

from taccel_lab.calibration.capture.camera.camera import CameraInfo, ControlLock
from taccel_lab.calibration.capture.guide import capture_plan
from taccel_lab.calibration.capture.importers import freeze_split
from taccel_lab.calibration.capture.importers.draft import require_lengths
from taccel_lab.calibration.capture.load import load_capture_folder
from taccel_lab.calibration.capture.schema import (
    MANIFEST_NAME,
    SCHEMA_VERSION,
    manifest_notes,
    manifest_text,
)
from taccel_lab.calibration.capture.sensor_facts import USUAL, catalogue_scale
from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import atomic_file, write_image
from taccel_lab.files.documents import read_toml
from taccel_lab.files.images import read_image
from taccel_lab.files.inner_path import own_place
from taccel_lab.files.output_folder import require_growable
from taccel_lab.sensors.registry import sensor_family

QUICK_PRESSES = 20
QUICK_LEAVES_OUT = (
    "scale: no board, no edge and no ruler was pressed. What is stated or taken from the catalogue "
    "is believed; published figures for one and the same sensor differ by a quarter, and lengths, "
    "heights and forces scale with it",
    "lens: no board was shown, so that distortion stays in the images",
    "force: no load cell was there. The gel's modulus and friction stay those of the catalogue, "
    "and no image is turned into newtons",
    "presses: 20, not the 40 of a full session. Half of the image may have one press or none; "
    "colours and slopes there are less certain, and fewer presses are held out to say how much",
    "markers: no dots were followed, so that nothing tells how they move with the gel",
    "time: a few minutes. Drift over a session, and from one day to the next, is not seen",
)
"""What twenty presses of a ball, without a board and without a load cell, cannot tell."""

ScaleFrom = Literal["stated", "catalogue", "later"]


@dataclass(frozen=True)
class RecordFacts:
    """Facts of one session; what is None was not stated."""

    sensor: str
    radius_mm: float | None = None
    """Radius of the ball [mm]."""
    mm_per_px: tuple[float, float] | None = None
    """Scale along x and y [mm/px]."""
    scale: ScaleFrom = "stated"
    """``catalogue``: that of the sensor's family is taken, and noted as assumed; ``later``: it will
    be measured with an edge or a board, and is left open."""
    unit: str | None = None
    license: str | None = None
    quick: bool = False
    source: str = ""
    camera: CameraInfo | None = None
    locks: tuple[ControlLock, ...] = field(default=())
    framing: str = "whole images"

    def __post_init__(self) -> None:
        sensor_family(self.sensor)
        x, y = self.mm_per_px or (None, None)
        require_lengths(radius_mm=self.radius_mm, mm_per_px_x=x, mm_per_px_y=y)
        if self.mm_per_px is not None and self.scale != "stated":
            raise InputError(
                f"--mm-per-px-x states the scale, --scale {self.scale} leaves it open; give one"
            )

    def require_complete(self) -> None:
        """Name everything that is missing at once."""
        missing = []
        if self.radius_mm is None:
            plan = capture_plan(self.sensor)
            missing.append(
                "the ball's radius: --radius-mm, half of what callipers say (a ball of "
                f"{plan.ball_radius_mm:g} mm radius suits this sensor)"
            )
        if self.mm_per_px is None and self.scale == "stated":
            missing.append(
                "the scale: --mm-per-px-x where you have measured it, --scale catalogue to assume "
                "the usual one of this sensor, or --scale later to press an edge or a board"
            )
        if missing:
            raise InputError("not stated yet:\n" + "\n".join(f"  {line}" for line in missing))

    def require_same(self, manifest: Mapping[str, Any], path: Path) -> None:
        """Refuse to go on with a folder that was begun otherwise, naming all that differs."""
        if "recorded" not in manifest:
            raise InputError(
                f"{path} has a {MANIFEST_NAME} that taccel-lab capture record did not write; name "
                "a new folder"
            )
        begun = {
            "sensor": manifest["sensor"],
            "--radius-mm": manifest.get("indenter", {}).get("radius_mm"),
            "--mm-per-px-x": manifest.get("mm_per_px_x"),
            "--mm-per-px-y": manifest.get("mm_per_px_y"),
            "--unit": manifest.get("unit"),
        }
        x, y = self.mm_per_px or (None, None)
        sensor = sensor_family(self.sensor).name
        now = dict(zip(begun, (sensor, self.radius_mm, x, y, self.unit), strict=True))
        differing = [
            f"{key} was {begun[key]} and is {now[key]}"
            for key in begun
            if now[key] is not None and now[key] != begun[key]
        ]
        if differing:
            raise InputError(
                f"{path} was begun otherwise: {'; '.join(differing)}. Name a new folder, or give "
                "what it was begun with"
            )

    def manifest(self, width_px: int, height_px: int) -> dict[str, Any]:
        """Keys of the manifest for images of this size."""
        assert self.radius_mm is not None
        assert self.camera is not None
        found: dict[str, Any] = {"indenter": {"kind": "sphere", "radius_mm": self.radius_mm}}
        unit = self.unit or self.camera.serial
        if unit is not None:
            found["unit"] = unit
        scale = self.mm_per_px
        if self.scale == "catalogue":
            scale = catalogue_scale(self.sensor, width_px, height_px)
            found["assumed"] = {"mm_per_px": f"{scale[0]:.4g} mm/px, {USUAL.format(self.sensor)}"}
        if scale is not None:
            found["mm_per_px_x"], found["mm_per_px_y"] = scale
        found["source"] = self.source or f"recorded from {self.camera.name}"
        found["license"] = self.license or "unknown"
        found["recorded"] = {
            "camera": self.camera.id,
            "begun": datetime.now(UTC).replace(microsecond=0),
            "controls": {lock.name: lock.text for lock in self.locks},
            "framing": self.framing,
            "left_out": list(QUICK_LEAVES_OUT) if self.quick else [],
        }
        return found

    def notes(self) -> tuple[str, ...]:
        """Comments for the head of the manifest."""
        if not self.quick:
            return ()
        return ("a quick session, which leaves out:", *(f"- {line}" for line in QUICK_LEAVES_OUT))


_PRESS = re.compile(r"press_([0-9]+)\.png")
_LEFT_BEHIND = re.compile(r"\.(press_[0-9]+|untouched_[0-9]+|background|captures)\..+\.(png|toml)")


@dataclass
class RecordFolder:
    """A folder that is being recorded into."""

    path: Path
    manifest: dict[str, Any]
    notes: tuple[str, ...] = ()
    made: Sequence[Mapping[str, Any]] = ()
    """What is known of each press that a stage makes, in order; empty without a stage."""

    @property
    def out_of_step(self) -> str:
        """Why the presses are not taken for those of the stage; empty where they are."""
        seen = len(self.presses)
        if not self.made or seen == len(self.made):
            return ""
        return (
            f"{seen} presses were taken and the table has {len(self.made)}: which is which is not "
            "known, so that none gets a depth. Record them again"
        )

    @property
    def presses(self) -> list[str]:
        """File names of the presses, in order."""
        return [entry["image"] for entry in self.manifest.get("presses", [])]

    @property
    def background(self) -> np.ndarray | None:
        """The untouched gel, RGB uint8, shape [height_px, width_px, 3]; None before it is taken."""
        name = self.manifest.get("background")
        return None if name is None else read_image(self.path / name)

    def image(self, name: str) -> np.ndarray:
        """One of its images, RGB uint8, shape [height_px, width_px, 3]."""
        return read_image(self.path / name)

    def set_background(self, image: np.ndarray, facts: RecordFacts) -> None:
        """Begin: the untouched gel, and all that is stated of the session."""
        with self._noted("background.png", image):
            self.manifest |= facts.manifest(image.shape[1], image.shape[0])
            self.manifest["background"] = "background.png"

    def add_untouched(self, image: np.ndarray) -> str:
        """The untouched gel at another time; returns the file's name."""
        name = f"untouched_{len(self.manifest.get('untouched', ())) + 1}.png"
        with self._noted(name, image):
            self.manifest.setdefault("untouched", []).append(name)
        return name

    def add_press(self, image: np.ndarray) -> str:
        """A press; returns the file's name."""
        numbers = [int(found[1]) for name in self.presses if (found := _PRESS.fullmatch(name))]
        name = f"press_{max(numbers, default=-1) + 1:03d}.png"
        with self._noted(name, image):
            self.manifest.setdefault("presses", []).append({"image": name})
        return name

    def undo_press(self) -> str | None:
        """Take the last press out again; returns its name, None where there is none."""
        if not self.presses:
            return None
        name = self.manifest["presses"].pop()["image"]
        self._write_manifest()
        (self.path / name).unlink(missing_ok=True)
        return name

    def finish(self) -> None:
        """Write down which presses are held out, so that later ones change nothing about it, and
        what the stage knows of each where it made as many as were taken."""
        if self.made and not self.out_of_step:
            for entry, known in zip(self.manifest["presses"], self.made, strict=True):
                entry |= known
        with atomic_file(own_place(self.path, MANIFEST_NAME)) as staging:
            staging.write_text(self._text(), encoding="utf-8")
            freeze_split(load_capture_folder(self.path), staging)
        self.manifest = read_toml(self.path / MANIFEST_NAME)

    @contextmanager
    def _noted(self, name: str, image: np.ndarray) -> Iterator[None]:
        """Write an image, and the manifest with what the block notes of it: both, or neither."""
        before, place = deepcopy(self.manifest), own_place(self.path, name)
        write_image(place, image)
        try:
            yield
            self._write_manifest()
        except Exception:
            self.manifest = before
            place.unlink()
            raise

    def _write_manifest(self) -> None:
        with atomic_file(own_place(self.path, MANIFEST_NAME)) as staging:
            staging.write_text(self._text(), encoding="utf-8")

    def _text(self) -> str:
        return manifest_text(self.manifest, self.notes)


@contextmanager
def open_record(
    path: Path, facts: RecordFacts, made: Sequence[Mapping[str, Any]] = ()
) -> Iterator[RecordFolder]:
    """A new folder at ``path``, or the one there, to go on with; nobody else may write into it.
    ``made``: what is known of each press that a stage makes.

    Raises:
        InputError: There is something else, somebody else records into it, or it was begun with
            other facts.
    """
    if path.is_file():
        raise InputError(f"{path} is a file; --out names a folder")
    require_growable(path)
    own_place(path, MANIFEST_NAME)
    fresh = not (path / MANIFEST_NAME).is_file()
    if fresh and path.is_dir():
        others = sorted(p.name for p in path.iterdir() if not _LEFT_BEHIND.fullmatch(p.name))
        if [name for name in others if name != "background.png"]:
            raise InputError(
                f"{path} holds {others[0]} and no {MANIFEST_NAME}; name a new or an empty folder"
            )
    if fresh:
        facts.require_complete()
        manifest: dict[str, Any] = {
            "schema_version": SCHEMA_VERSION,
            "sensor": sensor_family(facts.sensor).name,
        }
        notes = facts.notes()
    else:
        load_capture_folder(path)  # Refuses what is damaged, by name.
        manifest = read_toml(path / MANIFEST_NAME)
        notes = manifest_notes(path / MANIFEST_NAME)
        facts.require_same(manifest, path)
    new = [folder for folder in (path, *path.parents) if not folder.exists()]
    path.mkdir(parents=True, exist_ok=True)
    with _alone(path):
        for left in path.iterdir():
            if _LEFT_BEHIND.fullmatch(left.name):
                left.unlink(missing_ok=True)
        try:
            yield RecordFolder(path, manifest, notes, made)
        finally:
            for folder in new:  # Nothing came of it: no camera, no frame that can be used.
                if any(folder.iterdir()):
                    break
                folder.rmdir()


@contextmanager
def _alone(path: Path) -> Iterator[None]:
    handle = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(f"another taccel-lab records into {path}; end it first") from None
        yield
    finally:
        os.close(handle)
