# SPDX-License-Identifier: Apache-2.0
"""A disk that is full: said by the file's name, also where a library writes; what stood stays."""

from __future__ import annotations

import errno
import shutil
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from taccel_lab.datasets.part import write_table
from taccel_lab.errors import InputError
from taccel_lab.exporters import mesh_files
from taccel_lab.files.atomic_file import atomic_file, write_by, write_image
from taccel_lab.files.output_folder import atomic_directory, require_growable, require_replaceable
from taccel_lab.processes.cache_place import CACHE_VARIABLE
from taccel_lab.report.style import new_figure, save_figure
from tests.support.short_files import files_at_most
from tests.support.small_captures import everything_below

NOISE = np.random.default_rng(0).integers(0, 256, (90, 120, 3), dtype=np.uint8)


def figure(path: Path) -> None:
    found, axes = new_figure(3.0, 2.0)
    axes.imshow(NOISE)
    save_figure(found, path)


def solid(path: Path) -> None:
    """A box as STEP, 3MF or DXF."""
    from build123d import Box

    from taccel_lab.cad import export
    from taccel_lab.cad.parts.part import LabelledSolid, Part
    from taccel_lab.geometry import Region

    part = Part("box", Box(5, 4, 3).solid(), ("side",) * 6, (0.5, 0.5, 0.5), "steel")
    if path.suffix == ".dxf":
        export.write_dxf(LabelledSolid(part.solid, [Region.SIDE] * 6), path)
    else:
        export.write_3mf([part], path) if path.suffix == ".3mf" else export.write_part_step(
            part, path
        )


def sheet(path: Path) -> None:
    from taccel_lab.cad.drawing.sheet import DrawingSheet

    DrawingSheet(60.0, 40.0).save(path)


def vtk(path: Path) -> None:
    points = np.random.default_rng(0).random((900, 3))
    mesh_files.write_vtk(path, mesh_files.tet_grid(points, np.arange(900).reshape(-1, 4)))


WRITERS: dict[str, Callable[[Path], Any]] = {
    "a.npy": partial(write_by, write=lambda file: np.save(file, NOISE)),
    "a.npz": partial(write_by, write=partial(np.savez_compressed, noise=NOISE)),
    "a.pth": partial(write_by, write=partial(torch.save, {"noise": torch.from_numpy(NOISE)})),
    "a.png": figure,
    "b.png": partial(write_image, levels=NOISE),
    "a.stl": lambda path: mesh_files.write_stl(path, np.eye(256, 3), NOISE.reshape(-1, 3)),
    "a.vtk": vtk,
    **dict.fromkeys(("a.step", "a.3mf", "a.dxf"), solid),
    **dict.fromkeys(("a.pdf", "a.svg"), sheet),
    "a.parquet": partial(write_table, columns={"noise": NOISE.ravel()}),
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_file_that_finds_no_room_is_told_and_gone(name: str, tmp_path: Path) -> None:
    """The limit acts at any moment: at the first bytes, in the middle, at what is flushed last."""
    if name == "a.parquet":
        pytest.importorskip("pyarrow")
    WRITERS[name](tmp_path / name)
    size = (tmp_path / name).stat().st_size
    out = tmp_path / "out"
    with atomic_directory(out) as folder:
        (folder / "earlier.txt").write_text("old")
    before = everything_below(tmp_path)
    for part in (0.02, 0.5, 0.99):
        with (
            pytest.raises(OSError) as told,
            atomic_directory(out) as folder,
            files_at_most(int(part * size)),
        ):
            WRITERS[name](folder / name)
        assert (told.value.errno, told.value.filename) == (errno.EFBIG, str(out))
        assert everything_below(tmp_path) == before


@pytest.mark.parametrize(
    ("cause", "code", "named"), [("room", errno.EFBIG, "out"), ("none", errno.ENOENT, "none.png")]
)
def test_a_copy_is_told_by_what_is_written(
    cause: str, code: int, named: str, tmp_path: Path
) -> None:
    """Not by the file that is read, which Python names first."""
    (tmp_path / "room.png").write_bytes(bytes(9000))
    with pytest.raises(OSError) as told, files_at_most(5000):
        with atomic_directory(tmp_path / "out") as folder:
            shutil.copyfile(tmp_path / f"{cause}.png", folder / "photo.png")
    assert (told.value.errno, told.value.filename) == (code, str(tmp_path / named))


def test_a_file_that_finds_no_room_leaves_no_new_folder(tmp_path: Path) -> None:
    target = tmp_path / "new" / "one" / "a.txt"
    with pytest.raises(OSError) as told, files_at_most(5), atomic_file(target) as staging:
        staging.write_text("too much")
    assert (told.value.errno, told.value.filename) == (errno.EFBIG, str(target))
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_vanishes_meanwhile_is_told_by_its_own_name(tmp_path: Path) -> None:
    target = tmp_path / "new" / "out"
    with pytest.raises(FileNotFoundError, match="removed while") as told:
        with atomic_directory(target) as folder:
            (folder / "a.txt").write_text("first")
            shutil.rmtree(tmp_path / "new")
            write_image(folder / "b.png", NOISE)  # Makes the folder anew, without the first file.
    assert told.value.filename == str(target)
    assert list(tmp_path.iterdir()) == []


def save_zeros(path: Path) -> None:
    """NumPy by itself tells neither the number nor the name."""
    write_by(path, lambda file: np.save(file, np.zeros(1_000_000)))


@pytest.mark.parametrize("write", [lambda path: path.write_bytes(bytes(1_000_000)), save_zeros])
def test_a_full_disk_says_so_and_loses_nothing(
    small_drive: Path, write: Callable[[Path], object]
) -> None:
    target = small_drive / "out"
    with atomic_directory(target) as folder:
        (folder / "a.txt").write_text("old")
    before = everything_below(small_drive)
    with (
        pytest.raises(OSError, match="No space left on device") as raised,
        atomic_directory(target) as folder,
    ):
        write(folder / "a.npy")
    assert (raised.value.errno, raised.value.filename) == (errno.ENOSPC, str(target))
    assert everything_below(small_drive) == before


def test_a_cache_that_is_full_is_not_the_output(
    small_drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Libraries write into it without a word, such as Warp its kernels."""
    cache = small_drive / "cache"
    monkeypatch.setenv(CACHE_VARIABLE, str(cache))
    with pytest.raises(OSError, match="No space left on device") as told:
        with atomic_directory(tmp_path / "out") as folder:
            (folder / "a.txt").write_text("there is room")
            (small_drive / "kernel").write_bytes(bytes(1_000_000))
    assert told.value.filename == str(cache)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("ask", [require_replaceable, require_growable])
def test_a_disk_that_is_full_already_is_refused_before_any_work(
    small_drive: Path, ask: Callable[[Path], None]
) -> None:
    (small_drive / "out").mkdir()
    with suppress(OSError):
        (small_drive / "big").write_bytes(bytes(1_000_000))
    with pytest.raises(InputError, match="out cannot be written: No space left on device"):
        ask(small_drive / "out")
    if ask is require_growable:
        with pytest.raises(InputError, match="drive cannot be written: No space left"):
            ask(small_drive)
