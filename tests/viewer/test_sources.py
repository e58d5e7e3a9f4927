# SPDX-License-Identifier: Apache-2.0
"""What there is to look at: known by its content, read as it was written, or refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.cli.app import main
from taccel_lab.errors import InputError
from taccel_lab.presses import PHYSICS, Accuracy
from taccel_lab.scene import Element
from taccel_lab.studies.evaluate.design_row import DesignRow
from taccel_lab.studies.evaluate.study_folder import StudyFolder
from taccel_lab.tasks.replay import read_replay
from taccel_lab.viewer.pages import Kind, find_source
from taccel_lab.viewer.press_folder import STATES, read_press
from taccel_lab.viewer.study_page import press_files, read_design_press
from tests.support.small_captures import write_profile


@pytest.mark.parametrize(
    ("files", "kind"),
    [
        (["press.json"], Kind.PRESS),
        (["dataset.json"], Kind.DATASET),
        (["replay.json", "trial.json"], Kind.REPLAY),
        (["profile.toml"], Kind.PROFILE),
        ([".taccel_lab_study"], Kind.STUDY),
        (["designs/1/result.json"], Kind.STUDY),
    ],
)
def test_folders_are_known_by_a_file(tmp_path: Path, files: list[str], kind: Kind) -> None:
    for name in files:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("{}")
    found = find_source(str(tmp_path))
    assert (found.kind, found.path) == (kind, tmp_path)


READ: dict[str, Callable[[Path], object]] = {
    "press.json": read_press,
    "states.npz": read_press,
    "replay.json": read_replay,
    "replay.npz": read_replay,
    "designs/a/result.json": lambda folder: StudyFolder(folder).read("a"),
    "designs/a/press_sphere.npz": lambda folder: press_files(
        folder, DesignRow("a", "flat_pad", {}, "done")
    ),
}


@pytest.mark.parametrize("name", READ)
def test_what_a_link_leads_to_is_not_looked_at(name: str, tmp_path: Path) -> None:
    """Of a press, a replay or a study of somebody else."""
    (tmp_path / "elsewhere").write_text("secret = 1")
    folder = tmp_path / "folder"
    (folder / "designs" / "a").mkdir(parents=True)
    for other in ("press.json", "replay.json"):
        (folder / other).write_text("{}")
    (folder / name).unlink(missing_ok=True)
    (folder / name).symlink_to(tmp_path / "elsewhere")
    with pytest.raises(InputError, match=f"{name} is a link out of") as found:
        READ[name](folder)
    assert "secret" not in str(found.value)


def test_the_profile_of_a_design_is_found_in_it(tmp_path: Path) -> None:
    (tmp_path / "profile").mkdir()
    (tmp_path / "profile" / "profile.toml").write_text("")
    assert find_source(str(tmp_path)).path == tmp_path / "profile"


def test_names_are_sensors_and_tasks() -> None:
    assert find_source("gelsight_mini").kind is Kind.PROFILE
    assert find_source("ball-rolling").kind is Kind.TASK


@pytest.mark.parametrize(
    ("files", "words"),
    [
        ([], "nothing that can be looked at"),
        (["result.json"], "task record TASK` keeps"),
    ],
)
def test_other_folders_are_refused_with_what_is_needed(
    tmp_path: Path, files: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in files:
        (tmp_path / name).write_text("{}")
    assert main(["view", str(tmp_path), "--no-browser"]) == 2
    assert words in capsys.readouterr().err


def test_a_name_of_nothing_lists_sensors_and_tasks() -> None:
    with pytest.raises(InputError, match=r"gelsight_mini.*ball-rolling"):
        find_source("no_such_thing")


def test_files_of_a_folder_are_answered_with_the_folder(tmp_path: Path) -> None:
    path = tmp_path / "press.json"
    path.write_text(json.dumps({}))
    with pytest.raises(InputError, match=f"name the folder .*{tmp_path.name}"):
        find_source(str(path))


# Presses ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("press")
    profile = write_profile(root / "unit")
    fast = replace(PHYSICS[Accuracy.FAST], element=Element.LINEAR)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(PHYSICS, Accuracy.FAST, fast)
        patch.setattr("taccel_lab.presses.press_files.PREDICTED_PX", 64)
        patch.setattr("taccel_lab.presses.press_files.STATES_PX", 64)
        words = ["press", str(profile), "--indenter", "sphere:2", "--depth-mm", "0.2"]
        words += ["--step-mm", "0.1", "--accuracy", "fast", "--friction", "0", "--states"]
        assert main([*words, "--out", str(root / "press")]) == 0
    return root / "press"


@pytest.mark.thorough
def test_every_step_is_there_and_the_last_is_the_end(folder: Path) -> None:
    states = read_press(folder)
    assert states.count == 3 and len(states.captions) == 3
    assert states.captions[0] == "untouched" and "depth 0.20 mm" in states.captions[2]
    assert not states.moved_mm[0].any()
    (folder / STATES).rename(folder / "aside.npz")
    try:
        end = read_press(folder)
    finally:
        (folder / "aside.npz").rename(folder / STATES)
    np.testing.assert_allclose(states.moved_mm[2], end.moved_mm[1], atol=1e-6)
    assert [field.label for field in end.fields] == [field.label for field in states.fields]
    for mine, theirs in zip(states.fields, end.fields, strict=True):
        np.testing.assert_allclose(mine.values[2], theirs.values[1], rtol=1e-4, atol=1e-6)
    assert states.fields[0].values[2].max() > 1 > states.fields[0].values[0].max()


@pytest.mark.thorough
def test_forces_are_those_of_the_tool_on_the_gel_and_the_tool_comes_down(folder: Path) -> None:
    states = read_press(folder)
    force = json.loads((folder / "press.json").read_text())["press"]["wrench"]["force_n"]
    assert states.forces_n is not None and states.tool is not None and states.images is not None
    np.testing.assert_allclose(states.forces_n[2].sum(axis=0), -np.array(force), atol=1e-5)
    z = states.tool.poses[:, 2]
    assert z[0] > z[1] > z[2]
    assert np.linalg.norm(states.tool.vertices_mm, axis=1).max() == pytest.approx(2.0, rel=0.01)
    assert len(states.images.rgb) == 3


def test_states_that_lack_an_array_are_refused_with_the_file(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "press.json").write_text((folder / "press.json").read_text())
    arrays = dict(np.load(folder / STATES))
    del arrays["moved_m"]
    np.savez(tmp_path / STATES, **arrays)
    with pytest.raises(InputError, match=f"{STATES} is not as"):
        read_press(tmp_path)


# Touches, presses of studies, recorded tasks ------------------------------------------------------


def test_presses_of_studies_start_untouched(tmp_path: Path) -> None:
    rest = np.array([[0.0, 0, 0], [1e-3, 0, 0], [0, 1e-3, 0]])
    moved = np.zeros((2, 3, 3))
    moved[1, 0, 2] = -1e-4
    arrays = {
        "depth_mm": np.array([0.1, 0.2]),
        "force_n": np.array([[0, 0, 0.5], [0, 0, 1.5]]),
        "contact_rest_m": rest,
        "contact_moved_m": moved,
        "contact_faces": np.array([[0, 1, 2]]),
    }
    np.savez(tmp_path / "press_sphere.npz", **arrays)
    states = read_design_press(tmp_path / "press_sphere.npz")
    assert states.count == 3 and "force 1.500 N" in states.captions[2]
    np.testing.assert_allclose(states.positions_mm(2, 2.0)[0], [0, 0, -0.2])
    arrays["contact_moved_m"] = moved[:0]
    np.savez(tmp_path / "none.npz", **arrays)
    with pytest.raises(InputError, match="no step"):
        read_design_press(tmp_path / "none.npz")


@pytest.mark.slow
def test_a_recorded_task_is_read_as_it_was(tmp_path: Path) -> None:
    from taccel_lab.learning.gel_colors import default_colors
    from taccel_lab.tasks.catalogue import named
    from taccel_lab.tasks.replay import read_replay, record_seed, write_replay

    recorded, trial = record_seed(named("ball-rolling"), 0, "cpu", colors=default_colors(None))
    write_replay(recorded, tmp_path)
    replay = read_replay(tmp_path)
    assert (replay.task, replay.seed) == ("ball-rolling", 0)
    assert (replay.outcome == "success") == trial.success
    # The ball presses somewhere in between, deepest where it touches, and is seen there.
    pressed = replay.pressure_pa.max(axis=(1, 2)).argmax()
    assert replay.pressure_pa[0].max() == 0 < replay.pressure_pa[pressed].max()
    deepest = np.nanargmax(replay.depth_m[pressed])
    assert replay.pressure_pa[pressed].ravel()[deepest] > 0
    change = np.abs(replay.rgb[pressed].astype(int) - replay.rgb[0]).max(axis=2)
    assert change[replay.pressure_pa[pressed] > 0].mean() > 2 * change.mean()
    # By 0.09 mm as it begins to roll, of which half is left where it presses most.
    moved = np.abs(replay.markers_px - replay.markers_px[0]).max(axis=(1, 2))
    assert moved.max() > 0.4 and moved[pressed] > 0.2
    np.testing.assert_array_equal(replay.times_s, recorded.times_s)
    for body, known in zip(replay.bodies, recorded.bodies, strict=True):
        assert body.kind == known.kind
        np.testing.assert_array_equal(body.vertices_m, known.vertices_m)
        np.testing.assert_array_equal(body.faces, known.faces)
    for name, values in recorded.forces_n.items():
        np.testing.assert_array_equal(replay.forces_n[name], values)
    (tmp_path / "replay.json").write_text('{"task": "x", "bodies": [{}], "forces": []}')
    with pytest.raises(InputError, match="no replay"):
        read_replay(tmp_path)


@pytest.mark.slow
def test_touches_have_the_forces_and_depths_of_their_data_set(tmp_path: Path) -> None:
    pytest.importorskip("zarr")
    from taccel_lab.datasets.reading import Dataset
    from taccel_lab.viewer.dataset_page import read_touch
    from tests.support.small_data_sets import make, saved_profile

    channels = ["rgb", "depth_mm", "patch_forces_n", "markers_px"]
    profile = saved_profile(tmp_path / "profile")
    make(profile, tmp_path / "data", dataset={"episodes": 2}, output={"channels": channels})
    data = Dataset(tmp_path / "data")
    place = next(k for k, row in enumerate(data.episodes) if row["rows"] > 1)
    states, rows = read_touch(data, place), data.rows_of(place)
    assert states.count == len(rows) and states.forces_n is not None
    wrench = data.read("wrench", rows)[:, :3]
    np.testing.assert_allclose(states.forces_n.sum(axis=1), -wrench, atol=1e-5)
    depths = data.read("depth_mm", rows)
    assert np.abs(states.moved_mm[0]).max() < 0.01
    assert -np.nanmax(depths[-1]) <= states.moved_mm[-1, :, 2].min() < -0.05
    assert states.images is not None and len(states.images.rgb) == len(rows)
