# SPDX-License-Identifier: Apache-2.0
"""Files and folders that hold nothing, or of which a part does: each is read, or refused in a
sentence."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from taccel_lab.calibration.capture.camera.recording import Recording
from taccel_lab.errors import InputError
from tests.fuzz.guard import remove
from tests.fuzz.mutations.emptied import emptied
from tests.fuzz.reader import Reader, Refused
from tests.fuzz.readers import READERS

NAMES = [name for name, reader in READERS.items() if not reader.counts]
RECORDINGS = {
    "recording-lerobot": "set/data/chunk-000/file-000.parquet",
    "recording-lerobot-3": "set/meta/episodes/chunk-000/file-000.parquet",
}
"""Tables whose rows are the frames of a data set, or its episodes."""


def made(reader: str, folder: Path) -> tuple[Reader, Path, dict[str, bytes]]:
    """A reader, the folder of its sample and what is in that."""
    given = folder / "given"
    given.mkdir()
    READERS[reader].make(given)
    files = {f"{path.relative_to(given)}": path for path in sorted(given.rglob("*"))}
    return READERS[reader], given, {n: p.read_bytes() for n, p in files.items() if p.is_file()}


def cases(reader: Reader, given: Path, sample: dict[str, bytes]) -> Iterator[str]:
    """Leave the folder with a part of its files, or of one of them; words for it."""
    remove(given)
    given.mkdir()
    yield "an empty folder"
    for name in filter(reader.damages, sample):
        for other, content in sample.items():
            (given / other).parent.mkdir(parents=True, exist_ok=True)
            (given / other).write_bytes(content)
        for words, content in emptied(given / name):
            (given / name).write_bytes(content)
            yield f"{words} in {name}"
        (given / name).unlink()
        yield f"no {name}"


@pytest.mark.slow
@pytest.mark.parametrize("reader", NAMES)
def test_nothing_is_read_or_refused_in_a_sentence(
    reader: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    out = tmp_path / "out"
    for words in cases(*made(reader, tmp_path)):
        try:
            READERS[reader].call(tmp_path / "given", out)
        except (InputError, Refused) as error:
            assert str(error) and "Traceback" not in str(error), words
            assert not out.exists(), words
        except OSError as error:  # The command line makes a sentence of these (cli/app.py).
            assert error.filename is not None, words
        remove(out)


@pytest.mark.parametrize("reader", RECORDINGS)
def test_a_recording_without_frames_is_refused(reader: str, tmp_path: Path) -> None:
    _, given, _ = made(reader, tmp_path)
    table = given / RECORDINGS[reader]
    table.write_bytes(dict(emptied(table))["no rows"])
    with pytest.raises(InputError, match=r"set holds no frames of the camera observation\."):
        list(Recording.of(given / "set").frames())


@pytest.mark.parametrize("reader", ["recording-lerobot-2", "recording-lerobot-3"])
def test_a_table_without_rows_tells_no_times(reader: str, tmp_path: Path) -> None:
    _, given, sample = made(reader, tmp_path)
    name = next(name for name in sample if "/data/" in name)
    (given / name).write_bytes(dict(emptied(given / name))["no rows"])
    frames = list(Recording.of(given / "set").frames())
    assert len(frames) == 3 and all(frame.time_s is None for frame in frames)


def test_what_is_not_there_has_no_camera_to_leave_away(tmp_path: Path) -> None:
    """It was called a recording of one camera."""
    (tmp_path / "0.hdf5").touch()
    for name in ("0.hdf5", "gone.hdf5", "gone.mp4"):
        with pytest.raises(InputError, match=f"{name} is none of these: a video"):
            Recording.of(tmp_path / name, "left")
