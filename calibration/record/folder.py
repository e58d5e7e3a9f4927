# SPDX-License-Identifier: Apache-2.0
"""A capture folder that grows with every press, and that a kill leaves whole.

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
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.calibration.capture.importers import freeze_split
from taccel_lab.calibration.capture.load import load_capture_folder
from taccel_lab.calibration.capture.schema import MANIFEST_NAME, SCHEMA_VERSION, manifest_text
from taccel_lab.calibration.record.facts import RecordFacts
from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import atomic_file, write_image
from taccel_lab.files.documents import read_toml
from taccel_lab.files.images import read_image
from taccel_lab.files.output_folder import require_growable
from taccel_lab.sensors.registry import sensor_family

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
        write_image(self.path / "background.png", image)
        self.manifest |= facts.manifest(image.shape[1], image.shape[0])
        self.manifest["background"] = "background.png"
        self._write_manifest()

    def add_untouched(self, image: np.ndarray) -> str:
        """The untouched gel at another time; returns the file's name."""
        names = self.manifest.setdefault("untouched", [])
        name = f"untouched_{len(names) + 1}.png"
        write_image(self.path / name, image)
        names.append(name)
        self._write_manifest()
        return name

    def add_press(self, image: np.ndarray) -> str:
        """A press; returns the file's name."""
        numbers = [int(found[1]) for name in self.presses if (found := _PRESS.fullmatch(name))]
        name = f"press_{max(numbers, default=-1) + 1:03d}.png"
        write_image(self.path / name, image)
        self.manifest.setdefault("presses", []).append({"image": name})
        self._write_manifest()
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
        with atomic_file(self.path / MANIFEST_NAME) as staging:
            staging.write_text(self._text(), encoding="utf-8")
            freeze_split(load_capture_folder(self.path), staging)
        self.manifest = _read(self.path)

    def _write_manifest(self) -> None:
        with atomic_file(self.path / MANIFEST_NAME) as staging:
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
        manifest, notes = _read(path), _notes(path)
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


def _read(path: Path) -> dict[str, Any]:
    return read_toml(path / MANIFEST_NAME)


def _notes(path: Path) -> tuple[str, ...]:
    """Comments at the head, which stay."""
    notes = []
    for line in (path / MANIFEST_NAME).read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            break
        notes.append(line.lstrip("# "))
    return tuple(notes)


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
