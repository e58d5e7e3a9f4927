# SPDX-License-Identifier: Apache-2.0
"""Files that libraries write: an error names the file that finds no room, and nothing stays."""

from __future__ import annotations

import errno
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from taccel_lab.datasets.part import write_table
from taccel_lab.exporters import mesh_files
from taccel_lab.files.atomic_file import atomic_file, write_by, write_image
from taccel_lab.files.output_folder import atomic_directory
from taccel_lab.report.style import new_figure, save_figure
from tests.support.short_files import files_at_most
from tests.support.small_captures import everything_below

NOISE = np.random.default_rng(0).integers(0, 256, (90, 120, 3), dtype=np.uint8)


def figure(path: Path) -> None:
    found, axes = new_figure(3.0, 2.0)
    axes.imshow(NOISE)
    save_figure(found, path)


def solid() -> Any:
    from build123d import Box

    from taccel_lab.cad.parts.part import Part

    return Part("box", Box(5, 4, 3).solid(), ("side",) * 6, (0.5, 0.5, 0.5), "steel")


def step(path: Path) -> None:
    from taccel_lab.cad.export import write_part_step

    write_part_step(solid(), path)


def three_mf(path: Path) -> None:
    from taccel_lab.cad.export import write_3mf

    write_3mf([solid()], path)


def dxf(path: Path) -> None:
    from taccel_lab.cad.export import write_dxf
    from taccel_lab.cad.parts.part import LabelledSolid
    from taccel_lab.geometry import Region

    write_dxf(LabelledSolid(solid().solid, [Region.SIDE] * 6), path)


def sheet(path: Path) -> None:
    from taccel_lab.cad.drawing.sheet import DrawingSheet

    DrawingSheet(60.0, 40.0).save(path)


def vtk(path: Path) -> None:
    points = np.random.default_rng(0).random((900, 3))
    mesh_files.write_vtk(path, mesh_files.tet_grid(points, np.arange(900).reshape(-1, 4)))


WRITERS: dict[str, Callable[[Path], object]] = {
    "a.npy": partial(write_by, write=lambda file: np.save(file, NOISE)),
    "a.npz": partial(write_by, write=partial(np.savez_compressed, noise=NOISE)),
    "a.pth": partial(write_by, write=partial(torch.save, {"noise": torch.from_numpy(NOISE)})),
    "a.png": figure,
    "b.png": partial(write_image, levels=NOISE),
    "a.stl": lambda path: mesh_files.write_stl(path, np.eye(256, 3), NOISE.reshape(-1, 3)),
    "a.vtk": vtk,
    "a.step": step,
    "a.3mf": three_mf,
    "a.dxf": dxf,
    "a.pdf": sheet,
    "a.svg": sheet,
    "a.parquet": partial(write_table, columns={"noise": NOISE.ravel()}),
}


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("part", [0.02, 0.5, 0.99])
def test_a_file_that_finds_no_room_is_told_and_gone(name: str, part: float, tmp_path: Path) -> None:
    """The limit acts at any moment: at the first bytes, in the middle, at what is flushed last."""
    if name == "a.parquet":
        pytest.importorskip("pyarrow")
    (tmp_path / "whole").mkdir()
    WRITERS[name](tmp_path / "whole" / name)
    size = (tmp_path / "whole" / name).stat().st_size
    shutil.rmtree(tmp_path / "whole")
    out = tmp_path / "out"
    with atomic_directory(out) as folder:
        (folder / "earlier.txt").write_text("old")
    before = everything_below(tmp_path)
    with (
        pytest.raises(OSError) as told,
        atomic_directory(out) as folder,
        files_at_most(int(part * size)),
    ):
        WRITERS[name](folder / name)
    assert (told.value.errno, told.value.filename) == (errno.EFBIG, str(out))
    assert everything_below(tmp_path) == before


def test_a_copy_is_told_by_what_is_written(tmp_path: Path) -> None:
    """Not by the file that is read, which Python names first."""
    source = tmp_path / "photo.png"
    source.write_bytes(bytes(9000))
    with pytest.raises(OSError) as told, files_at_most(5000):
        with atomic_directory(tmp_path / "out") as folder:
            shutil.copyfile(source, folder / "photo.png")
    assert (told.value.errno, told.value.filename) == (errno.EFBIG, str(tmp_path / "out"))
    with pytest.raises(FileNotFoundError) as missing:
        with atomic_directory(tmp_path / "out") as folder:
            shutil.copyfile(tmp_path / "none.png", folder / "photo.png")
    assert missing.value.filename == str(tmp_path / "none.png")


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
