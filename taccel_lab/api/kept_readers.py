# SPDX-License-Identifier: Apache-2.0
"""The last few readers of a process, by what they were made from, so that a loop of single calls
makes one reader."""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from pathlib import Path
from threading import RLock
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from taccel_lab.profile import SensorProfile
from taccel_lab.sensors.any_sensor import AnySensor, reading_profile_of
from taccel_lab.sensors.profile import profile_folder
from taccel_lab.sensors.starters import is_starter

if TYPE_CHECKING:
    from taccel_lab.reading.reader import Method, Reader

KEPT = 4
"""Readers that are kept; one of a camera of 640x480 px holds some 100 MB."""


Kept = TypeVar("Kept")


class KeptReader:
    """A reader, and what lets it read one image after another."""

    def __init__(self, reader: Reader, profile: SensorProfile) -> None:
        """``profile``: what it was made from, whose identity is part of a key while it lives."""
        self.reader, self.profile, self.lock = reader, profile, RLock()


_readers: OrderedDict[Hashable, KeptReader] = OrderedDict()
_profiles: OrderedDict[Hashable, SensorProfile] = OrderedDict()
_lock = RLock()


def kept_reader(
    sensor: AnySensor,
    background: np.ndarray | Path | None,
    mask: np.ndarray | None,
    method: Method,
    beside: Sequence[Path],
    make: Callable[[SensorProfile], Reader],
) -> KeptReader:
    """The reader that was made from the same sensor, background, mask and method, or a new one.

    Args:
        sensor: As of ``read``: a profile counts by its identity, a folder by the state of its
            files.
        background: Counts by its content.
        mask: Counts by its content.
        method: As of ``read``.
        beside: Images beside which the background of a starter profile is looked for: the state of
            their folders counts then.
        make: Makes a reader of a profile.
    """
    with _lock:
        if isinstance(sensor, (Path, str)):
            named = str(sensor)
            profile = _kept(_profiles, _state(named), lambda: reading_profile_of(named))
            own = None  # Nobody else holds it.
        else:
            profile = reading_profile_of(sensor)
            own = _content(profile.background_rgb)
        finds = background is None and is_starter(profile)
        folders = {path if path.is_dir() else path.parent for path in beside} if finds else ()
        key = (
            id(profile), own, _content(background), _content(mask),
            method, *(_files(folder) for folder in sorted(folders)),
        )  # fmt: skip
        return _kept(_readers, key, lambda: KeptReader(make(profile), profile))


def _kept(kept: OrderedDict[Hashable, Kept], key: Hashable, make: Callable[[], Kept]) -> Kept:
    """What is kept under a key, or what is made; the oldest goes."""
    found = kept[key] if key in kept else make()
    kept[key] = found
    kept.move_to_end(key)
    if len(kept) > KEPT:
        kept.popitem(last=False)
    return found


def _content(value: np.ndarray | Path | None) -> Hashable:
    """Digest of an array, or of a file's bytes."""
    if value is None:
        return None
    if isinstance(value, Path):
        return value, hashlib.sha256(value.read_bytes()).digest() if value.is_file() else None
    array = np.ascontiguousarray(value)
    return array.shape, array.dtype.str, hashlib.sha256(array.tobytes()).digest()


def _state(name: str) -> Hashable:
    """A sensor's name, and the state of the files that it stands for."""
    path = profile_folder(name.partition("@")[0]) or Path(name)
    return name, str(path.absolute()), _files(path)


def _files(path: Path) -> Hashable:
    """Names, sizes and times of a folder's files, or of one file."""
    paths = sorted(path.rglob("*")) if path.is_dir() else [path]
    states = [(str(each), each.stat()) for each in paths if each.is_file()]
    return tuple((name, s.st_ino, s.st_size, s.st_mtime_ns) for name, s in states)
