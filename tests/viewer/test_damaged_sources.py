# SPDX-License-Identifier: Apache-2.0
"""Damaged presses, data sets, replays and studies are refused by ``view`` in words."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.datasets.folder import DatasetFolder
from taccel_lab.geometry.block import block_mesh
from taccel_lab.geometry.vtu import write_mesh_vtu
from taccel_lab.studies.evaluate.design_row import DesignRow
from taccel_lab.studies.evaluate.study_folder import StudyFolder
from taccel_lab.viewer.press_folder import PRESS, STATES
from tests.support.commands import Done, done
from tests.support.small_data_sets import make, saved_profile

pytest.importorskip("viser", reason="the extra view is not installed")
Arrays = dict[str, np.ndarray]


View = Callable[[Path], Done]


@pytest.fixture
def view(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> View:
    """The page of a folder, closed as soon as it is filled."""
    monkeypatch.setattr("taccel_lab.viewer.pages.serve_until_stopped", lambda: None)
    return lambda folder: done(capsys, "view", folder, "--no-browser", "--port", "0")


def assert_refused(found: Done, words: str) -> None:
    assert found.code == 2 and words in found.err, found.err


def press_arrays() -> Arrays:
    """What ``press --states`` keeps, of a block and a triangle that comes down in two steps."""
    mesh = block_mesh((2, 2, 1), (0.02, 0.02, 0.004))
    nodes, steps = len(mesh.nodes_m), 3
    return {
        "nodes_m": mesh.nodes_m,
        "tets": mesh.tets.astype(np.int64),
        "faces": mesh.faces.astype(np.int64),
        "depth_mm": np.array([0.0, 0.1, 0.2]),
        "force_n": np.zeros((steps, 3)),
        "indenter_poses": np.tile([0.0, 0, 0.001, 0, 0, 0, 1], (steps, 1)),
        "moved_m": np.zeros((steps, nodes, 3)),
        "contact_forces_n": np.zeros((steps, nodes, 3)),
        "contact_pressures_pa": np.zeros((steps, nodes)),
        "von_mises_pa": np.zeros((steps, nodes)),
        "indenter_vertices_m": 1e-3 * np.eye(3),
        "indenter_faces": np.array([[0, 1, 2]]),
        "images": np.zeros((steps, 4, 6, 3), dtype=np.uint8),
    }


def write_press(folder: Path, arrays: Arrays, about: object) -> None:
    np.savez(folder / STATES, **arrays)
    (folder / PRESS).write_text(json.dumps(about))


ABOUT = {"sensor": "x", "friction_coefficient": 0.5, "press": {"force_n": 1.5}}


def test_a_sound_press_is_shown(tmp_path: Path, view: View) -> None:
    write_press(tmp_path, press_arrays(), ABOUT)
    assert view(tmp_path).code == 0


DAMAGE: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "none": lambda array: array[:0],
    "scalar": lambda array: np.array(3.0),
    "text": lambda array: np.array(["a", "b"]),
    "flat": lambda array: array.ravel()[:2],
}


@pytest.mark.parametrize("damage", DAMAGE)
@pytest.mark.parametrize("name", press_arrays())
def test_arrays_of_another_shape(name: str, damage: str, tmp_path: Path, view: View) -> None:
    if damage == "none" and name in ("tets", "faces", "indenter_faces"):
        return  # Nothing to draw is no fault.
    arrays = press_arrays()
    arrays[name] = DAMAGE[damage](arrays[name])
    write_press(tmp_path, arrays, ABOUT)
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
def test_figures_of_another_kind(about: object, words: str, tmp_path: Path, view: View) -> None:
    write_press(tmp_path, press_arrays(), about)
    assert_refused(view(tmp_path), words)


@pytest.mark.parametrize("part", [0.0, 0.5, 1.0])
def test_a_mesh_that_is_cut_short_or_another(part: float, tmp_path: Path, view: View) -> None:
    (tmp_path / PRESS).write_text(json.dumps(ABOUT))
    write_mesh_vtu(tmp_path / "gel.vtu", block_mesh((2, 2, 1), (0.02, 0.02, 0.004)))
    data = (tmp_path / "gel.vtu").read_bytes()
    (tmp_path / "gel.vtu").write_bytes(data[: int(part * len(data))])
    assert_refused(view(tmp_path), "gel.vtu is damaged, or no mesh of a press")


@pytest.mark.slow
def test_damaged_data_sets(tmp_path: Path, view: View) -> None:
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    profile = saved_profile(tmp_path / "profile")
    make(profile, tmp_path / "made", dataset={"episodes": 2}, output={"channels": ["depth_mm"]})
    assert view(tmp_path / "made").code == 0

    def about(key: str, value: object) -> Callable[[Path], None]:
        def change(data: Path) -> None:
            found = json.loads((data / "dataset.json").read_text())
            (data / "dataset.json").write_text(json.dumps({**found, key: value}))

        return change

    def table(name: str, column: str, value: object) -> Callable[[Path], None]:
        def change(data: Path) -> None:
            for path in (data / name, *(p / name for p in DatasetFolder(data).part_folders())):
                found = pq.read_table(path)
                at = found.column_names.index(column)
                changed = found.remove_column(at)
                if value is not None:
                    changed = changed.append_column(column, pa.array([value] * len(found)))
                pq.write_table(changed, path)

        return change

    changes = {
        "'channels' is 3": about("channels", 3),
        "'sensors' is []": about("sensors", []),
        "does not describe sensor 0": about("sensors", [{}]),
        "no column rows": table("episodes.parquet", "rows", None),
        "other values than it should in rows": table("episodes.parquet", "rows", "x"),
        "does not describe sensor 7": table("episodes.parquet", "sensor_index", 7),
        "has no step in steps.parquet": table("steps.parquet", "episode", 9),
        "is damaged (": table("steps.parquet", "row", 10**6),
        "no finished part yet": lambda data: shutil.rmtree(data / "parts"),
    }
    for number, (words, change) in enumerate(changes.items()):
        data = tmp_path / str(number)
        shutil.copytree(tmp_path / "made", data)
        change(data)
        assert_refused(view(data), words)


REPLAYED = {
    "task": "x",
    "seed": 3,
    "cause": "",
    "bodies": [{"name": "b", "kind": "soft"}],
    "forces": ["f"],
}


def sound_replay() -> Arrays:
    """What ``task record`` keeps, of four frames of two triangles."""
    return {
        "times_s": np.arange(4.0),
        "depth_m": np.zeros((4, 5, 6)),
        "pressure_pa": np.zeros((4, 5, 6)),
        "markers_px": np.zeros((4, 2, 2)),
        "rgb": np.zeros((4, 5, 6, 3), dtype=np.uint8),
        "forces_n": np.zeros((4, 1)),
        "vertices_m_0": np.random.default_rng(1).random((4, 4, 3)),
        "faces_0": np.array([[0, 1, 2], [0, 2, 3]]),
    }


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
def test_damaged_replays(
    about: dict[str, object], arrays: Arrays, tmp_path: Path, view: View
) -> None:
    for number, (more, changed) in enumerate([({}, {}), (about, arrays)]):
        np.savez(tmp_path / "replay.npz", **{**sound_replay(), **changed})
        (tmp_path / "replay.json").write_text(json.dumps({**REPLAYED, **more}))
        found = view(tmp_path)
        assert found.code == 2 * number
    assert_refused(found, "is no replay of a task as it is recorded")


def test_a_study_whose_rows_have_no_figures(tmp_path: Path, view: View) -> None:
    row = DesignRow(id="one", family="flat_pad", parameters={}, status="done")
    StudyFolder(tmp_path).add_row(row)
    assert_refused(view(tmp_path), "has no design with a figure yet")
