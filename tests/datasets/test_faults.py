# SPDX-License-Identifier: Apache-2.0
"""Data sets with faulty images: what is wrong with each is told, and everything else stays."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taccel_lab.datasets.channels import FAULT_COLUMNS
from taccel_lab.datasets.check import check_dataset
from taccel_lab.datasets.reading import Dataset
from taccel_lab.errors import InputError
from taccel_lab.signals.frame_faults import KINDS
from taccel_lab.signals.frame_operators import BITS
from taccel_lab.viewer.dataset_page import read_touch
from tests.support.small_data_sets import SIZE, make, parts_of, plan

FAULTS = dict.fromkeys(KINDS, 0.1)
FEW = {"dataset": {"episodes": 3}, "output": {"channels": ["rgb", "markers_px"]}}


@pytest.fixture(scope="module")
def whole_set(profile: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("whole") / "data"
    assert make(profile, root, **FEW).complete
    return root


@pytest.fixture(scope="module")
def faulty_set(profile: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same with faults of all kinds."""
    root = tmp_path_factory.mktemp("faulty") / "data"
    assert make(profile, root, faults=FAULTS, **FEW).complete
    return root


def test_images_alone_differ_and_labels_say_how(whole_set: Path, faulty_set: Path) -> None:
    whole, data = Dataset(whole_set), Dataset(faulty_set)
    assert set(data.channels) - set(whole.channels) == {"faults", "fault_values"}
    every = slice(None)
    for name in sorted(set(whole.channels) - {"rgb"}):
        assert np.array_equal(whole.read(name, every), data.read(name, every), equal_nan=True)
    before, after = whole.read("rgb", every), data.read("rgb", every)
    bits, values = data.read("faults", every), data.read("fault_values", every)
    table = data.steps
    assert (bits[table["step"] == 0] == 0).all() and 2 < (bits > 0).sum() < 8
    differs = (before != after).reshape(len(bits), -1).any(axis=1)
    assert not differs[bits == 0].any() and differs[bits > 0].mean() > 0.9
    names = ["+".join(kind for kind in KINDS if bit & BITS[kind]) for bit in bits.tolist()]
    assert table["faults"].tolist() == names
    assert (np.stack([table[name] for name in FAULT_COLUMNS], axis=1) == values).all()
    assert (bits & BITS["lost_rows"]).any()
    for row in np.flatnonzero(bits & BITS["lost_rows"]):
        first = int(table["lost_from_row"][row])
        level = [table[f"lost_level_{color}"][row] for color in ("red", "green", "blue")]
        assert (after[row, first:] == level).all() and 0 < first < SIZE[1]
    assert not [finding for finding in check_dataset([faulty_set]) if finding.severity == "error"]


def test_a_reader_knows_what_was_asked_for_and_sees_it(faulty_set: Path) -> None:
    """In the recipe, and in the viewer's captions."""
    recipe = json.loads((faulty_set / "dataset.json").read_text())["recipe"]
    assert recipe["spec"]["faults"]["shift"] == 0.1
    assert recipe["spec"]["faults"]["shift_width"] == [0.005, 0.065]
    data = Dataset(faulty_set)
    place = int(data.steps["place"][np.flatnonzero(data.steps["faults"] != "")[0]])
    captions = read_touch(data, place).captions
    said = [name.replace("+", ", ") for name in data.steps["faults"][data.rows_of(place)]]
    assert [caption.partition("mm²")[2].removeprefix(", ") for caption in captions] == said
    assert "mm², " not in captions[0] and any("mm², " in caption for caption in captions)


@pytest.mark.thorough
def test_faults_do_not_depend_on_the_shard_or_on_company(
    profile: Path, faulty_set: Path, tmp_path: Path
) -> None:
    assert make(profile, tmp_path / "a", (2, 2), faults=FAULTS, **FEW).complete
    assert parts_of(tmp_path / "a").items() < parts_of(faulty_set).items()
    alone = {**FEW, "output": {**FEW["output"], "episodes_per_part": 1}}
    assert make(profile, tmp_path / "b", faults=FAULTS, **alone).complete
    one, other = Dataset(faulty_set), Dataset(tmp_path / "b")
    for episode in range(3):
        values, same = (
            data.read("fault_values", np.flatnonzero(data.steps["episode"] == episode))
            for data in (one, other)
        )
        assert (values == same).all()


def test_chances_of_zero_leave_the_bytes(profile: Path, whole_set: Path, tmp_path: Path) -> None:
    none = {"wear": 0, "wear_gain": [0.1, 0.2]}
    assert make(profile, tmp_path / "a", (2, 2), faults=none, **FEW).complete
    kept, same = parts_of(tmp_path / "a"), parts_of(whole_set)
    arrays = [name for name in kept if "/c/" in name or name.endswith("steps.parquet")]
    assert len(arrays) > 10 and all(kept[name] == same[name] for name in arrays)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"faults": {"wear": 2}}, "faults: wear must lie in"),
        ({"faults": {"ware": 0.1}}, r"faults: no fault 'ware' \(did you mean wear"),
        ({"faults": {"wear": "0.1"}}, "faults: wear must be a number, got '0.1'"),
        (
            {"faults": {"wear": 0.1}, "output": {"channels": ["depth_mm"]}},
            r"\[faults\] are of images: put rgb into output.channels",
        ),
        ({"output": {"channels": ["rgb", "faults"]}}, "faults is kept wherever there are"),
    ],
)
def test_faults_that_cannot_be_are_refused(
    profile: Path, changes: dict[str, Any], words: str
) -> None:
    with pytest.raises(InputError, match=words):
        plan(profile, **changes)
