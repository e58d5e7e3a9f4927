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
from taccel_lab.datasets.exports import export_lerobot
from taccel_lab.datasets.faults_page import faulty_examples
from taccel_lab.datasets.reading import Dataset
from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import write_image
from taccel_lab.files.inner_path import file_or_example
from taccel_lab.signals.frame_faults import KINDS, FrameFaults
from taccel_lab.signals.frame_operators import BITS
from taccel_lab.viewer.dataset_page import read_touch
from tests.support.commands import done, refusal
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


def test_a_reader_knows_what_was_asked_for_and_sees_it(faulty_set: Path, tmp_path: Path) -> None:
    """In the recipe, the viewer's captions and what LeRobot reads."""
    recipe = json.loads((faulty_set / "dataset.json").read_text())["recipe"]
    assert recipe["spec"]["faults"]["shift"] == 0.1
    assert recipe["spec"]["faults"]["shift_width"] == [0.005, 0.065]
    assert "observation.faults" in export_lerobot([faulty_set], tmp_path / "out")["features"]
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


def test_a_page_shows_every_fault_on_frames_at_hand(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each by the ranges of a file; what is drawn is what the picture is made of."""
    frames = np.random.default_rng(0).integers(20, 200, (2, 24, 32, 3)).astype(np.uint8)
    paths = [tmp_path / f"{name}.png" for name in ("rest", "press")]
    for path, frame in zip(paths, frames, strict=True):
        write_image(path, frame)
    example = file_or_example(Path("mini_touches"), "datasets").read_text()
    stated = example.replace("[faults]", "[faults]\nlost_from = [0.5, 0.5]\nwear = 0.3")
    (tmp_path / "set.toml").write_text(stated)
    words = ("dataset", "faults", *paths, "--spec", tmp_path / "set.toml", "--json")
    code, out, _ = done(capsys, *words, "--out", tmp_path / "page", "--seed", 3)
    drawn = json.loads(out[: out.rindex("}") + 1])
    assert drawn["lost_rows"]["judged"] == "lost_rows: rows 12 to 23"
    assert code == 0 and set(drawn) == set(KINDS) and drawn["lost_rows"]["lost_from_row"] == [12]
    html = (tmp_path / "page" / "report.html").read_text().replace("<wbr>", "")
    assert all(kind in html for kind in KINDS) and "0.3 of an episode" in html
    examples = faulty_examples(frames, FrameFaults(), 3)
    assert (examples["stuck"][0] == frames[0]).all() and (examples["delay"][0] == frames[0]).all()
    assert all((image != frames[1]).any() for image, _ in examples.values())
    said = refusal(capsys, "dataset", "faults", paths[0], "--out", tmp_path / "other")
    assert "give two frames or more" in said and not (tmp_path / "other").exists()
    write_image(paths[0], frames[0][:12])
    said = refusal(capsys, "dataset", "faults", *paths, "--out", tmp_path / "other")
    assert "frame 1 is 32x12 px, the last one 32x24 px" in said
