# SPDX-License-Identifier: Apache-2.0
"""Frames of a camera in a LeRobotDataset of version 2 or 3 (huggingface/lerobot,
``src/lerobot/datasets``), episode after episode.

Version 2 has a file an episode, ``data/chunk-*/episode_*.parquet`` and
``videos/chunk-*/CAMERA/episode_*.mp4``; version 3 has several episodes in
``data/chunk-*/file-*.parquet`` and ``videos/CAMERA/chunk-*/file-*.mp4``, and
``meta/episodes`` says from when to when each lies. Images of the type ``image`` are encoded in the
Parquet files of both. Only files under these names are read, whatever ``meta/info.json`` calls
them. Times are those of the column ``timestamp``, from the beginning of each episode: its writer
gives multiples of the frame rate, others what their clock said.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.files.apart import read_apart, stream_apart
from taccel_lab.files.declared import require_few, require_held
from taccel_lab.files.documents import read_json
from taccel_lab.files.images import MAX_FILE_BYTES, decoded_bgr
from taccel_lab.files.inner_path import inner_path
from taccel_lab.files.regular_file import (
    LARGEST_BYTES,
    read_regular_file,
    require_regular_file,
    shown,
)
from taccel_lab.files.videos import MAX_FRAMES, RecordedFrame, read_frames

if TYPE_CHECKING:
    from pyarrow.parquet import ParquetFile

INFO = "meta/info.json"
ROWS = 16
"""Rows of a Parquet file that are held at a time: each may have an image."""
TIME = "timestamp"
MAX_ROWS = 1 << 22
"""Most rows of a table: 38 hours at 30 frames a second."""
MAX_EPISODES = 1 << 17
"""Most episodes of a table."""


@dataclass(frozen=True)
class _Episode:
    """Where version 3 keeps the frames of an episode."""

    number: int
    length: int
    file: str
    start_s: float


def is_lerobot(folder: Path) -> bool:
    """Whether a folder is such a data set."""
    return (folder / INFO).is_file()


def lerobot_cameras(folder: Path) -> dict[str, int]:
    """How many frames the data set states, by name of the camera, ``observation.images.touch``.

    Raises InputError for a file that is none, or of another version.
    """
    info = _info(folder)
    return dict.fromkeys(_kinds(info), int(info["total_frames"]))


def lerobot_frames(folder: Path, name: str) -> Iterator[RecordedFrame]:
    """Frames of one of :func:`lerobot_cameras`; InputError for a file that is not there."""
    info = _info(folder)
    if _kinds(info)[name] == "image":
        return _images(folder, name)
    if _version(folder, info) == 2:
        return _videos_of_episodes(folder, name)
    return _shared_videos(folder, name, float(info["fps"]))


def _info(folder: Path) -> dict[str, Any]:
    path = inner_path(folder, INFO)
    info = read_json(path)
    frames, fps, features = (info.get(key) for key in ("total_frames", "fps", "features"))
    if not (isinstance(frames, int) and isinstance(fps, (int, float)) and 0 < fps <= 1e4):
        raise InputError(f"{path} states no total_frames and fps as LeRobot's data sets do")
    if not isinstance(features, dict):
        raise InputError(f"{path} states no features as LeRobot's data sets do")
    _version(folder, info)
    return info


def _version(folder: Path, info: dict[str, Any]) -> int:
    version = str(info.get("codebase_version"))
    if version.startswith(("v2.", "v3.")):
        return int(version[1])
    raise InputError(
        f"{folder / INFO} is of version {shown(version)}; LeRobot's v2.0, v2.1 and v3.0 are read"
    )


def _kinds(info: dict[str, Any]) -> dict[str, str]:
    """``image`` or ``video`` by camera; maps of depth are no pictures of a gel."""
    found = {}
    for name, about in info["features"].items():
        kind = about.get("dtype") if isinstance(about, dict) else None
        facts = about.get("info") or about.get("video_info") or {} if kind else {}
        depth = isinstance(facts, dict) and (
            facts.get("is_depth_map") or facts.get("video.is_depth_map")
        )
        if kind in ("image", "video") and not depth:
            found[name] = kind
    return found


def _files(folder: Path, pattern: str) -> list[Path]:
    """Files of the data set, in order; links that lead out of it are refused."""
    found = [path.relative_to(folder).as_posix() for path in folder.glob(pattern)]
    if not found:
        raise InputError(f"{folder} holds no {pattern}, where its frames should be")
    return [inner_path(folder, name) for name in sorted(found)]


def _images(folder: Path, name: str) -> Iterator[RecordedFrame]:
    for path in _files(folder, "data/chunk-*/*.parquet"):
        yield from stream_apart(
            str(path), _stored, folder, path, name, by="pyarrow", records=lambda: (RecordedFrame,)
        )


def _stored(folder: Path, path: Path, name: str) -> Iterator[RecordedFrame]:
    columns = ["episode_index", "frame_index", name]
    with _parquet(path, columns) as file:
        timed = [*columns, TIME] if _is_timed(file) else columns
        held, read = path.stat().st_size, 0
        for batch in file.iter_batches(batch_size=ROWS, columns=timed):
            read += batch.nbytes
            require_held(path, "rows", read, held)
            for row in batch.to_pylist():
                episode = row["episode_index"]
                place, time_s = _frame_name(episode, row["frame_index"]), row.get(TIME)
                try:
                    image = _decoded(folder, row[name], f"{path}: {place}")
                except InputError as error:
                    image = error
                yield RecordedFrame(place, image, time_s, episode)


def _decoded(folder: Path, content: Any, place: str) -> np.ndarray:
    """The image of a cell: its bytes, or the file of the data set that it names."""
    stored = content if isinstance(content, dict) else {}
    data = stored.get("bytes")
    if data is None:
        file = inner_path(folder, str(stored.get("path")))
        data = read_regular_file(file, MAX_FILE_BYTES, "an image")
    return np.ascontiguousarray(decoded_bgr(data, place)[..., ::-1])


def _videos_of_episodes(folder: Path, name: str) -> Iterator[RecordedFrame]:
    paths = _files(folder, f"videos/chunk-*/{_literal(name)}/episode_*.mp4")
    for episode, path in enumerate(paths):
        number = path.stem.removeprefix("episode_").lstrip("0") or "0"
        table = f"data/{_literal(path.parent.parent.name)}/{_literal(path.stem)}.parquet"
        times = next(iter(_times(folder, table).values()), ())
        try:
            for index, image in enumerate(read_frames(path)):
                yield RecordedFrame(_frame_name(number, index), image, _nth(times, index), episode)
        except InputError as error:
            yield RecordedFrame(f"episode {number}", error, None, episode)


def _shared_videos(folder: Path, name: str, fps: float) -> Iterator[RecordedFrame]:
    episodes = [
        episode
        for path in _files(folder, "meta/episodes/chunk-*/*.parquet")
        for episode in read_apart(
            str(path), _episodes, path, name, by="pyarrow", records=lambda: (_Episode,)
        )
    ]
    episodes.sort(key=lambda episode: (episode.file, episode.start_s))
    times = _times(folder, "data/chunk-*/*.parquet")
    for file, group in groupby(episodes, key=lambda episode: episode.file):
        frames = enumerate(read_frames(inner_path(folder, file)))
        for episode in group:
            first, done = round(episode.start_s * fps), 0
            own, number = times.get(episode.number, ()), episode.number
            why = "the video ends before it"
            try:
                while done < episode.length:
                    index, image = next(frames)
                    if index >= first:
                        place = _frame_name(number, done)
                        yield RecordedFrame(place, image, _nth(own, done), number)
                        done += 1
            except StopIteration:
                pass
            except InputError as error:
                why = str(error)
            for index in range(done, episode.length):
                place = _frame_name(number, index)
                error = InputError(f"{folder / file}: {place}: {why}")
                yield RecordedFrame(place, error, _nth(own, index), number)


def _times(folder: Path, pattern: str) -> dict[int, np.ndarray]:
    """Times of the frames of each episode [s] in the tables of a name; none where a table states
    none, or is not there."""
    found: dict[int, np.ndarray] = {}
    for name in sorted(path.relative_to(folder).as_posix() for path in folder.glob(pattern)):
        path = inner_path(folder, name)
        found |= read_apart(str(path), _timestamps, path, by="pyarrow")
    return found


def _timestamps(path: Path) -> dict[int, np.ndarray]:
    columns = ["episode_index", "frame_index"]
    with _parquet(path, columns) as file:
        if not _is_timed(file):
            return {}
        table = file.read(columns=[*columns, TIME])
        episodes, frames, times = (table[name].to_numpy() for name in (*columns, TIME))
    if not (episodes.dtype.kind in "iu" and frames.dtype.kind in "iu"):
        raise InputError(f"{path}: episode_index and frame_index have to be whole numbers")
    order = np.argsort(episodes, kind="stable")
    numbers, first = np.unique(episodes[order], return_index=True)
    require_few(path, "episodes", len(numbers), MAX_EPISODES)
    found = {}
    for episode, own in zip(numbers, np.split(order, first)[1:], strict=True):
        # Its frames one after another: otherwise nobody knows which time is whose.
        if (frames[own] == np.arange(len(own))).all():
            found[int(episode)] = times[own].astype(float)
    return found


def _is_timed(file: ParquetFile) -> bool:
    """Whether a table has times that are numbers."""
    import pyarrow as pa

    schema = file.schema_arrow
    if TIME not in schema.names:
        return False
    kind = schema.field(TIME).type
    return pa.types.is_floating(kind) or pa.types.is_integer(kind)


def _nth(times: Sequence[float] | np.ndarray, index: int) -> float | None:
    return float(times[index]) if index < len(times) else None


def _episodes(path: Path, name: str) -> list[_Episode]:
    of = f"videos/{name}/"
    wanted = [f"{of}{key}" for key in ("chunk_index", "file_index", "from_timestamp")]
    columns = ["episode_index", "length", *wanted]
    with _parquet(path, columns) as file:
        rows = file.read(columns=columns).to_pylist()
    return [
        _Episode(
            _number(path, row, "episode_index"),
            min(_number(path, row, "length"), MAX_FRAMES),
            f"videos/{name}/chunk-{_number(path, row, wanted[0]):03d}/"
            f"file-{_number(path, row, wanted[1]):03d}.mp4",
            _seconds(path, row, wanted[2]),
        )
        for row in rows
    ]


def _number(path: Path, row: dict[str, Any], name: str) -> int:
    value = row[name]
    if not (isinstance(value, int) and value >= 0):
        raise InputError(f"{path}: {name} is {value!r}; a whole number from 0 is needed")
    return value


def _seconds(path: Path, row: dict[str, Any], name: str) -> float:
    value = row[name]
    if not (isinstance(value, (int, float)) and 0 <= value < 1e6):
        raise InputError(f"{path}: {name} is {value!r}; seconds from 0 are needed")
    return float(value)


@contextmanager
def _parquet(path: Path, columns: list[str]) -> Iterator[ParquetFile]:
    """A file with these columns; what pyarrow raises of a damaged one becomes a sentence."""
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise InputError(
            f"{path} is read by pyarrow, which is not installed: pip install 'taccel-lab[datasets]'"
        ) from None
    pa.set_cpu_count(1)  # Each takes address space, which counts as memory.
    path = require_regular_file(path, LARGEST_BYTES, "a Parquet file")
    try:
        with pq.ParquetFile(path) as file:
            missing = [name for name in columns if name not in file.schema_arrow.names]
            if missing:
                raise InputError(f"{path} has no {', '.join(missing)}, as LeRobot's files do")
            require_few(path, "rows", file.metadata.num_rows, MAX_ROWS)
            yield file
    except InputError:
        raise
    # A name that is no text is a ValueError of Python's, a damaged page any of them.
    except (pa.ArrowException, OSError, ValueError, TypeError, LookupError) as error:
        raise InputError(f"{path} is no Parquet file that can be read: {error}") from None


def _literal(name: str) -> str:
    """A name in which wildcards stand for themselves."""
    return "".join(f"[{letter}]" if letter in "*?[" else letter for letter in name)


def _frame_name(episode: int | str, index: int) -> str:
    return f"episode {episode} frame {index}"
