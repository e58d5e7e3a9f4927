# SPDX-License-Identifier: Apache-2.0
"""Exports of data sets; ``tests/exporters/test_round_trip.py`` reads them back."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from taccel_lab.datasets.exports import export_lerobot, export_univtac
from taccel_lab.datasets.reading import Dataset
from taccel_lab.errors import InputError
from tests.support.small_data_sets import parts_of
from tests.support.strangers import LURES, REFUSED, lure


def test_lerobot(made: Path, tmp_path: Path) -> None:
    data = Dataset(made)
    info = export_lerobot([made], tmp_path / "lr", fps=5)
    assert info == json.loads((tmp_path / "lr" / "meta" / "info.json").read_text())
    assert (info["total_frames"], info["total_episodes"], info["fps"]) == (len(data), 6, 5)
    frames = pq.read_table(tmp_path / "lr" / info["data_path"].format(chunk_index=0, file_index=0))
    assert set(frames.column_names) == set(info["features"])
    assert frames["index"].to_pylist() == list(range(len(data)))
    assert frames["frame_index"].to_pylist() == data.steps["step"].tolist()
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
    for name, values in (("min", wrench.min(0)), ("max", wrench.max(0)), ("std", wrench.std(0))):
        assert stats["observation.wrench"][name] == pytest.approx(values)
    assert stats["observation.wrench"]["mean"] == pytest.approx(wrench.mean(axis=0))
    pixels = data.read("rgb", slice(None)) / 255
    image = stats["observation.images.tactile"]
    assert np.shape(image["mean"]) == (3, 1, 1)
    assert np.ravel(image["mean"]) == pytest.approx(pixels.mean(axis=(0, 1, 2)))
    tasks = pq.read_table(tmp_path / "lr" / "meta" / "tasks.parquet")
    assert json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["task"]
    row = data.episodes[0]
    task = tasks["task"].to_pylist()[frames["task_index"][0].as_py()]
    assert task == f"{row['motion']} {row['object']} on {row['sensor']}"


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
    for write in (export_lerobot, export_univtac):
        with pytest.raises(
            InputError, match=r"lies inside the data set .* name a folder beside it"
        ):
            write([made], inside)
    assert parts_of(made) == before and not inside.exists()


@pytest.mark.thorough(cases=("parts/000001/data.zarr/rgb/c/0/0/0/0-kinds0",))
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
        for write in (export_lerobot, export_univtac):
            with pytest.raises(InputError, match=REFUSED):
                write([copied], tmp_path / "out")
            assert not (tmp_path / "out").exists()
