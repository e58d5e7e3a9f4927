# SPDX-License-Identifier: Apache-2.0
"""Files of other projects' layouts hold the same numbers."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import cv2
import h5py
import numpy as np
import pyarrow.parquet as pq
import pytest

from taccel_lab.datasets.lerobot import export_lerobot
from taccel_lab.datasets.lite import make_lite
from taccel_lab.datasets.page import dataset_page
from taccel_lab.datasets.reading import Dataset
from taccel_lab.datasets.univtac import export_univtac
from taccel_lab.errors import InputError
from taccel_lab.report.page import write_page_file
from tests.support.small_data_sets import parts_of
from tests.support.strangers import LURES, REFUSED, lure


def show(folders: list[Path], out: Path) -> None:
    """The page of a data set as a file."""
    write_page_file(dataset_page(Dataset(folders)), out)


def test_lerobot(made: Path, tmp_path: Path) -> None:
    data = Dataset(made)
    info = export_lerobot([made], tmp_path / "lr", fps=5)
    assert info == json.loads((tmp_path / "lr" / "meta" / "info.json").read_text())
    assert (info["total_frames"], info["total_episodes"]) == (len(data), 6)
    path = tmp_path / "lr" / info["data_path"].format(chunk_index=0, file_index=0)
    frames = pq.read_table(path)
    assert set(frames.column_names) == set(info["features"])
    assert frames["index"].to_pylist() == list(range(len(data)))
    assert frames["frame_index"].to_pylist() == data.steps["step"].tolist()
    png = frames["observation.images.tactile"][3].as_py()["bytes"]
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    assert (image == data.read("rgb", [3])[0]).all()
    wrench = np.array(frames["observation.wrench"].to_pylist())
    assert wrench == pytest.approx(data.read("wrench", slice(None)), abs=1e-6)
    state = np.array(frames["observation.state"].to_pylist())
    action = np.array(frames["action"].to_pylist())
    ends = np.flatnonzero(np.diff(frames["episode_index"].to_numpy()))
    inner = np.setdiff1d(np.arange(len(data) - 1), ends)
    assert action[inner] == pytest.approx(state[inner + 1])
    episodes = pq.read_table(tmp_path / "lr" / "meta/episodes/chunk-000/file-000.parquet")
    assert sum(episodes["length"].to_pylist()) == len(data)
    assert episodes["dataset_to_index"].to_pylist()[-1] == len(data)
    stats = json.loads((tmp_path / "lr" / "meta" / "stats.json").read_text())
    assert stats["observation.wrench"]["max"] == pytest.approx(wrench.max(axis=0))
    assert stats["observation.wrench"]["std"] == pytest.approx(wrench.std(axis=0))
    assert np.shape(stats["observation.images.tactile"]["mean"]) == (3, 1, 1)
    tasks = pq.read_table(tmp_path / "lr" / "meta" / "tasks.parquet")
    assert json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["task"]
    told = tasks["task"].to_pylist()[frames["task_index"][0].as_py()]
    row = data.episodes[0]
    assert told == f"{row['motion']} {row['object']} on {row['sensor']}"


def test_univtac(made: Path, tmp_path: Path) -> None:
    data = Dataset(made)
    assert export_univtac([made], tmp_path / "uv") == 6
    rows = data.rows_of(2)
    with h5py.File(tmp_path / "uv" / "hdf5" / "2.hdf5") as file:
        gel = file["tactile/left_tactile"]
        images = [
            cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR) for png in gel["rgb"][()]
        ]
        # Channels in the order in which they were handed to the encoder, as their reader has them.
        assert (np.stack(images) == data.read("rgb", rows)).all()
        optics = data.profile(2).optics
        distance = abs(optics.position_mm[2]) - data.read("depth_mm", rows)
        assert gel["depth"][()] == pytest.approx(distance, abs=1e-5)
        assert gel["marker"].shape[:2] == (len(rows), 2)
        assert file["step"][()].tolist() == list(range(len(rows)))
        assert file["atom/tag"][0] == b"rest"
        assert file["embodiment/ee"].shape == (len(rows), 7)
        assert (file["taccel_lab/wrench"][()] == data.read("wrench", rows)).all()
    assert len(json.loads((tmp_path / "uv" / "metadata.json").read_text())) == 6


def test_what_a_layout_needs_is_asked_for(made: Path, tmp_path: Path) -> None:
    broken = tmp_path / "b"
    broken.mkdir()
    about = json.loads((made / "dataset.json").read_text())
    del about["channels"]["rgb"]
    (broken / "dataset.json").write_text(json.dumps(about))
    for export in (export_lerobot, export_univtac):
        with pytest.raises(InputError, match="has no rgb"):
            export([broken], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_nothing_is_written_into_the_data_set_itself(made: Path) -> None:
    before = parts_of(made)
    inside = made / "parts" / "x"
    for write in (export_lerobot, export_univtac, make_lite):
        with pytest.raises(
            InputError, match=r"lies inside the data set .* name a folder beside it"
        ):
            write([made], inside)
    assert parts_of(made) == before and not inside.exists()


@pytest.mark.parametrize(
    ("place", "kinds"),
    [
        ("parts/000001/data.zarr/rgb/c/0/0/0/0", LURES),
        # What is no folder is no part, and an index that cannot be read is that of the parts.
        ("parts/000001", ["link to a folder"]),
        ("episodes.parquet", ["link out", "link to a folder"]),
    ],
)
def test_what_links_name_is_not_published(
    tmp_path: Path, place: str, kinds: Sequence[str], copied: Path
) -> None:
    for kind in kinds:
        lure(copied / place, kind, tmp_path / "outside")
        for write in (make_lite, export_lerobot, export_univtac, show):
            with pytest.raises(InputError, match=REFUSED):
                write([copied], tmp_path / "out")
            assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("kind", LURES)
@pytest.mark.parametrize("place", ["profiles/0/x", "objects/x", "spec.toml"])
def test_a_small_data_set_has_no_files_from_elsewhere(
    tmp_path: Path, place: str, kind: str, copied: Path
) -> None:
    lure(copied / place, kind, tmp_path / "outside")
    with pytest.raises(InputError, match=REFUSED):
        make_lite([copied], tmp_path / "out")
    assert not (tmp_path / "out").exists()
