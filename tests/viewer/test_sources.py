# SPDX-License-Identifier: Apache-2.0
"""What there is to look at: known by its content, read as it was written, or refused in words."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from taccel_lab.cli.app import main
from taccel_lab.datasets.folder import DatasetFolder
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.geometry.block import block_mesh
from taccel_lab.geometry.vtu import write_mesh_vtu
from taccel_lab.presses import PHYSICS, Accuracy
from taccel_lab.scene import Element
from taccel_lab.studies.evaluate.design_row import DesignRow
from taccel_lab.studies.evaluate.study_folder import StudyFolder
from taccel_lab.tasks.replay import read_replay
from taccel_lab.viewer.pages import Kind, find_source
from taccel_lab.viewer.press_folder import PRESS, STATES, read_press
from taccel_lab.viewer.study_page import press_files, read_design_press
from tests.support.commands import done, refusal
from tests.support.small_captures import write_profile
from tests.support.small_data_sets import make, saved_profile
from tests.viewer.sample_sources import ABOUT, REPLAYED, press_arrays, sound_replay, write_press


@pytest.mark.parametrize(
    ("files", "kind", "at"),
    [
        (["press.json"], Kind.PRESS, ""),
        (["dataset.json"], Kind.DATASET, ""),
        (["replay.json", "trial.json"], Kind.REPLAY, ""),
        (["profile.toml"], Kind.PROFILE, ""),
        (["profile/profile.toml"], Kind.PROFILE, "profile"),
        ([".taccel_lab_study"], Kind.STUDY, ""),
        (["designs/1/result.json"], Kind.STUDY, ""),
    ],
)
def test_folders_are_known_by_a_file(files, kind, at, tmp_path):
    for name in files:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("{}")
    found = find_source(str(tmp_path))
    assert (found.kind, found.path) == (kind, tmp_path / at)


def test_names_are_sensors_and_tasks(tmp_path):
    assert find_source("gelsight_mini").kind is Kind.PROFILE
    assert find_source("ball-rolling").kind is Kind.TASK
    for name, says in {
        "xyz": "sensors list and .* task list",
        "rolling": "mean ball-rolling",
    }.items():
        with pytest.raises(InputError, match=says):
            find_source(name)
    (tmp_path / "press.json").write_text("{}")
    with pytest.raises(InputError, match=f"name the folder .*{tmp_path.name}"):
        find_source(str(tmp_path / "press.json"))


@pytest.mark.parametrize(
    ("files", "words"),
    [([], "cannot be shown: it has neither"), (["result.json"], "task record TASK` keeps")],
)
def test_other_folders_are_refused_with_what_is_needed(files, words, tmp_path, capsys):
    for name in files:
        (tmp_path / name).write_text("{}")
    assert words in refusal(capsys, "view", tmp_path, "--no-browser")


READ = {
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
def test_what_a_link_leads_to_is_not_looked_at(name, tmp_path):
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


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    root = tmp_path_factory.mktemp("press")
    profile = write_profile(root / "unit")
    fast = replace(PHYSICS[Accuracy.FAST], element=Element.LINEAR)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(PHYSICS, Accuracy.FAST, fast)
        patch.setattr("taccel_lab.presses.files.PREDICTED_PX", 64)
        patch.setattr("taccel_lab.presses.files.STATES_PX", 64)
        words = "--indenter sphere:2 --depth-mm 0.2 --step-mm 0.1 --accuracy fast --friction 0"
        out = ["--states", "--out", str(root / "press")]
        assert main(["press", str(profile), *words.split(), *out]) == 0
    return root / "press"


@pytest.mark.thorough
def test_every_step_of_a_press_is_there_and_the_last_is_the_end(folder):
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
    # Forces are the tool's on the gel; the tool, a ball of 2 mm, comes down.
    force = json.loads((folder / PRESS).read_text())["press"]["wrench"]["force_n"]
    np.testing.assert_allclose(states.forces_n[2].sum(axis=0), -np.array(force), atol=1e-5)
    assert (np.diff(states.tool.poses[:, 2]) < 0).all()
    assert np.linalg.norm(states.tool.vertices_mm, axis=1).max() == pytest.approx(2.0, rel=0.01)
    assert len(states.images.rgb) == 3


def test_states_that_lack_an_array_are_refused_with_the_file(folder, tmp_path):
    shutil.copy(folder / PRESS, tmp_path)
    arrays = dict(np.load(folder / STATES))
    del arrays["moved_m"]
    np.savez(tmp_path / STATES, **arrays)
    with pytest.raises(InputError, match=f"{STATES} is not as"):
        read_press(tmp_path)


def test_dots_lie_in_a_picture_that_was_kept_smaller_where_they_lay_in_the_whole_one(tmp_path):
    """Places of pixel centres, of 15 x 8 px shown in 6 x 4."""
    whole, kept = PixelGrid(15, 8, 0.05, 0.08), PixelGrid(6, 4, 0.125, 0.16)
    places = np.array([[0.0, 0.0], [7.0, 3.5], [14.0, 7.0], [2.25, 6.5]])
    dots = {"markers_px": np.tile(places, (3, 1, 1)), "image_px": np.array([15, 8])}
    write_press(tmp_path, press_arrays() | dots, ABOUT)
    found = read_press(tmp_path).images
    wanted = kept.pixel_from_gel(whole.gel_from_pixel(places))
    np.testing.assert_allclose(found.markers_px[2], wanted, atol=1e-9)


def test_forces_sideways_and_stresses_of_steps_are_in_their_units(tmp_path):
    arrays = press_arrays()
    arrays["force_n"][2] = [3.0, 4.0, 1.0]
    arrays["von_mises_pa"][2, 5] = arrays["contact_pressures_pa"][2, 5] = 5e3
    arrays["moved_m"][2, 5, 2] = -2e-4
    write_press(tmp_path, arrays, ABOUT)
    found = read_press(tmp_path)
    assert found.captions[2] == "depth 0.20 mm, force 1.000 N along z, 5.000 N sideways"
    assert [each.values[2].max() for each in found.fields] == pytest.approx([5.0, 5.0])
    assert found.moved_mm.min() == pytest.approx(-0.2)


def test_presses_of_studies_start_untouched(tmp_path):
    moved = np.zeros((2, 3, 3))
    moved[1, 0, 2] = -1e-4
    arrays = {
        "depth_mm": np.array([0.1, 0.2]),
        "force_n": np.array([[0, 0, 0.5], [0, 0, 1.5]]),
        "contact_rest_m": np.array([[0.0, 0, 0], [1e-3, 0, 0], [0, 1e-3, 0]]),
        "contact_moved_m": moved,
        "contact_faces": np.array([[0, 1, 2]]),
    }
    np.savez(tmp_path / "press_sphere.npz", **arrays)
    states = read_design_press(tmp_path / "press_sphere.npz")
    assert states.count == 3 and "force 1.500 N" in states.captions[2]
    np.testing.assert_allclose(states.positions_mm(2, 2.0)[0], [0, 0, -0.2])
    np.savez(tmp_path / "none.npz", **{**arrays, "contact_moved_m": moved[:0]})
    with pytest.raises(InputError, match="no step"):
        read_design_press(tmp_path / "none.npz")


@pytest.mark.slow
def test_a_recorded_task_is_read_as_it_was(tmp_path):
    from taccel_lab.learning.gel_colors import default_colors
    from taccel_lab.tasks.catalogue import named
    from taccel_lab.tasks.replay import record_seed, write_replay

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
def test_touches_have_the_forces_and_depths_of_their_data_set(tmp_path):
    pytest.importorskip("zarr")
    from taccel_lab.datasets.reading import Dataset
    from taccel_lab.viewer.dataset_page import read_touch

    channels = ["rgb", "depth_mm", "patch_forces_n", "markers_px"]
    profile = saved_profile(tmp_path / "profile")
    make(profile, tmp_path / "data", dataset={"episodes": 2}, output={"channels": channels})
    data = Dataset(tmp_path / "data")
    place = next(k for k, row in enumerate(data.episodes) if row["rows"] > 1)
    states, rows = read_touch(data, place), data.rows_of(place)
    assert states.count == len(rows) == len(states.images.rgb)
    wrench = data.read("wrench", rows)[:, :3]
    np.testing.assert_allclose(states.forces_n.sum(axis=1), -wrench, atol=1e-5)
    depths = data.read("depth_mm", rows)
    assert np.abs(states.moved_mm[0]).max() < 0.01
    assert -np.nanmax(depths[-1]) <= states.moved_mm[-1, :, 2].min() < -0.05


@pytest.fixture
def view(monkeypatch, capsys):
    """The page of a folder, closed as soon as it is filled."""
    pytest.importorskip("viser", reason="the extra view is not installed")
    monkeypatch.setattr("taccel_lab.viewer.pages.serve_until_stopped", lambda: None)
    return lambda folder: done(capsys, "view", folder, "--no-browser", "--port", "0")


def assert_refused(found, words):
    assert found.code == 2 and words in found.err, found.err


def test_a_sound_press_is_shown(tmp_path, view):
    write_press(tmp_path, press_arrays(), ABOUT)
    assert view(tmp_path).code == 0


DAMAGE = {
    "none": lambda array: array[:0],
    "scalar": lambda array: np.array(3.0),
    "text": lambda array: np.array(["a", "b"]),
    "flat": lambda array: array.ravel()[:2],
}


@pytest.mark.parametrize("damage", DAMAGE)
@pytest.mark.parametrize("name", press_arrays())
def test_arrays_of_another_shape(name, damage, tmp_path, view):
    if damage == "none" and name in ("tets", "faces", "indenter_faces"):
        return  # Nothing to draw is no fault.
    arrays = press_arrays()
    write_press(tmp_path, {**arrays, name: DAMAGE[damage](arrays[name])}, ABOUT)
    assert_refused(view(tmp_path), STATES)


@pytest.mark.parametrize(
    ("about", "words"),
    [
        ({"press": 3}, "press is 3; a table"),
        ({"press": {"force_n": "a"}}, "press.force_n is 'a'; a number"),
        ({"press": {"force_n": None}}, "press.force_n is missing; a number"),
        ({"friction_coefficient": "x"}, "friction_coefficient is 'x'"),
    ],
)
def test_figures_of_another_kind(about, words, tmp_path, view):
    write_press(tmp_path, press_arrays(), about)
    assert_refused(view(tmp_path), words)


@pytest.mark.parametrize("part", [0.0, 0.5, 1.0])
def test_a_mesh_that_is_cut_short_or_another(part, tmp_path, view):
    (tmp_path / PRESS).write_text(json.dumps(ABOUT))
    write_mesh_vtu(tmp_path / "gel.vtu", block_mesh((2, 2, 1), (0.02, 0.02, 0.004)))
    data = (tmp_path / "gel.vtu").read_bytes()
    (tmp_path / "gel.vtu").write_bytes(data[: int(part * len(data))])
    assert_refused(view(tmp_path), "gel.vtu is damaged, or no mesh of a press")


@pytest.mark.slow
def test_damaged_data_sets(tmp_path, view):
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    profile = saved_profile(tmp_path / "profile")
    make(profile, tmp_path / "made", dataset={"episodes": 2}, output={"channels": ["depth_mm"]})
    assert view(tmp_path / "made").code == 0

    def about(data, key, value):
        found = json.loads((data / "dataset.json").read_text())
        (data / "dataset.json").write_text(json.dumps({**found, key: value}))

    def table(data, name, column, value):
        for path in (data / name, *(p / name for p in DatasetFolder(data).part_folders())):
            found = pq.read_table(path)
            changed = found.remove_column(found.column_names.index(column))
            if value is not None:
                changed = changed.append_column(column, pa.array([value] * len(found)))
            pq.write_table(changed, path)

    changes = {
        "'channels' is 3": (about, "channels", 3),
        "'sensors' is []": (about, "sensors", []),
        "does not describe sensor 0": (about, "sensors", [{}]),
        "no column rows": (table, "episodes.parquet", "rows", None),
        "other values than it should in rows": (table, "episodes.parquet", "rows", "x"),
        "does not describe sensor 7": (table, "episodes.parquet", "sensor_index", 7),
        "has no step in steps.parquet": (table, "steps.parquet", "episode", 9),
        "is damaged (": (table, "steps.parquet", "row", 10**6),
        "no finished part yet": (lambda data: shutil.rmtree(data / "parts"),),
    }
    for number, (words, (change, *given)) in enumerate(changes.items()):
        data = tmp_path / str(number)
        shutil.copytree(tmp_path / "made", data)
        change(data, *given)
        assert_refused(view(data), words)


@pytest.mark.parametrize(
    ("about", "arrays"),
    [
        ({"bodies": []}, {}),
        ({"bodies": [{"name": "b", "kind": "odd"}]}, {}),
        ({}, {"times_s": np.zeros(0)}),
        ({}, {"times_s": np.array(["a"] * 4)}),
        ({"seed": "first"}, {}),
        ({}, {"depth_m": np.zeros((0, 5, 6))}),
        ({}, {"pressure_pa": np.zeros((4, 6, 5))}),
        ({}, {"markers_px": np.zeros((4, 2))}),
        ({}, {"rgb": np.zeros((4, 5, 6))}),
        ({}, {"forces_n": np.zeros((4, 1, 1))}),
        ({}, {"vertices_m_0": np.zeros((4, 0, 3))}),
        ({}, {"vertices_m_0": np.full((4, 4, 3), np.nan)}),
        ({}, {"faces_0": np.array([[0, 1, 99]])}),
        ({}, {"faces_0": np.array([["a", "b", "c"]])}),
    ],
)
def test_damaged_replays(about, arrays, tmp_path, view):
    np.savez(tmp_path / "replay.npz", **{**sound_replay(), **arrays})
    (tmp_path / "replay.json").write_text(json.dumps({**REPLAYED, **about}))
    assert_refused(view(tmp_path), "is no replay of a task as it is recorded")


def test_a_sound_replay_is_shown_and_a_study_without_figures_is_not(tmp_path, view):
    np.savez(tmp_path / "replay.npz", **sound_replay())
    (tmp_path / "replay.json").write_text(json.dumps(REPLAYED))
    assert view(tmp_path).code == 0
    StudyFolder(tmp_path / "study").add_row(DesignRow("one", "flat_pad", {}, "done"))
    assert_refused(view(tmp_path / "study"), "has no design with a figure yet")
