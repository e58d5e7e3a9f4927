# SPDX-License-Identifier: Apache-2.0
"""Data sets are made, with dots, and exported."""

from __future__ import annotations

import errno
import gc
import json
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.spatial.transform import Rotation

from taccel_lab.camera.gel_camera import GelCamera
from taccel_lab.datasets import runner
from taccel_lab.datasets.check import check_dataset
from taccel_lab.datasets.exports import export_lerobot, export_univtac
from taccel_lab.datasets.folder import DatasetFolder
from taccel_lab.datasets.reading import Dataset
from taccel_lab.errors import InputError
from taccel_lab.files.output_marker import OUTPUT_MARKER
from taccel_lab.profile import CameraBlock, MarkersBlock, save_profile
from taccel_lab.sensors.profile import catalogue_profile
from taccel_lab.viewer.dataset_page import read_touch
from tests.signals.find_dots import distances_px, find_dots
from tests.support.dotted_profiles import LIGHT, with_painted_dots
from tests.support.small_data_sets import ASSUMED, make, parts_of, plan, small_profile
from tests.support.strangers import LURES, REFUSED, SECRET, lure

ROOT = Path(__file__).parents[2]


def started(*words: object) -> subprocess.Popen[bytes]:
    """A run of its own: profile, folder, shard, processes, and at which part it is killed."""
    command = [sys.executable, "-m", "tests.support.small_data_sets", *map(str, words)]
    return subprocess.Popen(command, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)})


@pytest.mark.thorough
def test_equal_bytes_by_shards_and_folders(profile: Path, made: Path, tmp_path: Path) -> None:
    """Two shards in folders of their own, one of them by another process, give what one run gave;
    together they are read as one."""
    other = started(profile, tmp_path / "b", "2/2", "1")
    first = make(profile, tmp_path / "a", (1, 2))
    assert other.wait() == 0 and first.complete
    one, two = parts_of(tmp_path / "a"), parts_of(tmp_path / "b")
    assert one and two and not set(one) & set(two)
    assert {**one, **two} == parts_of(made)
    both, whole = Dataset([tmp_path / "a", tmp_path / "b"]), Dataset(made)
    assert len(both) == len(whole)
    assert sorted(row["episode"] for row in both.episodes) == list(range(6))
    assert not check_dataset([tmp_path / "a", tmp_path / "b"])


@pytest.mark.thorough
def test_a_killed_run_goes_on_and_ends_the_same(profile: Path, made: Path, tmp_path: Path) -> None:
    folder = DatasetFolder(tmp_path / "k")
    assert started(profile, folder.root, "1/1", "0", "2").wait() == -signal.SIGKILL
    before = parts_of(folder.root)
    assert len(folder.part_folders()) == 1 and set(before) < set(parts_of(made))
    hidden = [path for path in (folder.root / "parts").iterdir() if path.name.startswith(".")]
    assert hidden, "it was killed while it wrote"
    outcome = make(profile, folder.root)
    assert outcome.complete and outcome.parts_there == len(folder.part_folders()) - len(
        outcome.done
    )
    assert parts_of(folder.root) == parts_of(made)
    hidden = [path for path in (folder.root / "parts").iterdir() if path.name.startswith(".")]
    assert not hidden
    assert make(profile, folder.root).done == []


@pytest.mark.thorough
def test_what_a_part_leaves_in_circles_goes_with_the_next(
    profile: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Commands look for circles rarely; zarr's hold the chunks that were written."""
    finish, held = runner._finish, []

    def counted(*arguments: Any) -> Any:
        held.append(sum(isinstance(one, memoryview) for one in gc.get_objects()))
        return finish(*arguments)

    monkeypatch.setattr(runner, "_finish", counted)
    gc.disable()
    try:
        make(profile, tmp_path / "a", dataset={"episodes": 16})
    finally:
        gc.enable()
    # Two parts are written while the next is simulated.
    assert len(held) == 8 and max(held[4:]) <= max(held[:4])


@pytest.mark.thorough
def test_other_data_sets_and_files_are_left_alone(profile: Path, tmp_path: Path) -> None:
    begun = tmp_path / "begun"
    make_plan = plan(profile)
    DatasetFolder(begun).begin(make_plan, "small")
    with pytest.raises(InputError, match=r"another data set: its spec.dataset differ.*several are"):
        DatasetFolder(begun).require_usable(plan(profile, dataset={"seed": 9}))
    DatasetFolder(begun).require_usable(make_plan)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="holds files and no data set"):
        make(profile, tmp_path / "mine")
    with (
        DatasetFolder(begun).locked("1/2"),
        pytest.raises(InputError, match="another run makes shard 1/2"),
        DatasetFolder(begun).locked("1/2"),
    ):
        pass


def test_shards_may_begin_a_folder_at_the_same_time(profile: Path, tmp_path: Path) -> None:
    folder = DatasetFolder(tmp_path / "shared")
    folder.root.mkdir()
    (folder.root / ".dataset.another.json").write_text("{")  # Another shard is writing it.
    with folder.locked("2/2"):
        folder.begin(plan(profile), "small")


@pytest.mark.thorough
def test_timing_writes_nothing(profile: Path, tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    outcome = runner.make_dataset(plan(profile), None, processes=0, limit=1)
    record = outcome.record()
    assert record["images"] > 2 and not record["written"] and record["bytes"] == 0
    assert list(tmp_path.iterdir()) == []


@pytest.mark.thorough
@pytest.mark.parametrize("sizes", ["kept", "of an earlier version"])
def test_damaged_parts_are_made_again_and_told(
    sizes: str, profile: Path, made: Path, copied: Path
) -> None:
    """By a look at their files: missing, cut short; a part beside them is not touched."""
    gone, cut, *sound = DatasetFolder(copied).part_folders()
    chunks = [
        next(path for path in (part / "data.zarr" / "rgb" / "c").rglob("*") if path.is_file())
        for part in (gone, cut)
    ]
    chunks[0].unlink()
    chunks[1].write_bytes(chunks[1].read_bytes()[:10] if sizes == "kept" else b"")
    if sizes != "kept":
        for part in (gone, cut):
            marker = json.loads((part / OUTPUT_MARKER).read_text())
            (part / OUTPUT_MARKER).write_text(json.dumps({"files": marker["files"]}))
    stamps = [(part / "steps.parquet").stat().st_mtime_ns for part in sound]
    said: list[str] = []
    outcome = make(profile, copied, say=said.append)
    assert outcome.complete and [done.part for done in outcome.done] == [0, 1]
    assert parts_of(copied) == parts_of(made)
    assert [(part / "steps.parquet").stat().st_mtime_ns for part in sound] == stamps
    missing = chunks[0].relative_to(gone).as_posix()
    assert said[0] == f"part 000000 is damaged and made again: {missing} is missing"
    assert "000001" in said[1] and ("has 10 bytes of" if sizes == "kept" else "is empty") in said[1]
    assert make(profile, copied, say=said.append).done == [] and len(said) == 2


@pytest.mark.thorough
def test_a_damaged_part_with_files_of_somebody_else_is_left_alone(
    profile: Path, made: Path, copied: Path
) -> None:
    part = DatasetFolder(copied).part_folders()[0]
    (part / "episodes.parquet").unlink()
    (part / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"holds notes\.txt, which .*; delete the part, and"):
        make(profile, copied)
    (part / "notes.txt").unlink()
    marker = (part / OUTPUT_MARKER).read_bytes()
    (part / OUTPUT_MARKER).write_bytes(marker[:50])
    with pytest.raises(InputError, match=r"no list of its files, .*; delete the part, and"):
        make(profile, copied)
    (part / OUTPUT_MARKER).write_bytes(marker)
    assert make(profile, copied).complete
    assert parts_of(copied) == parts_of(made)


@pytest.mark.thorough(cases=("up/x", "{0}/thesis.tex"))
@pytest.mark.parametrize("name", ["{0}/thesis.tex", "../../../thesis.tex", "C:\\x", "a\0b", "up/x"])
def test_the_list_of_a_part_names_nothing_outside(
    profile: Path, tmp_path: Path, name: str, copied: Path
) -> None:
    """A data set of somebody else, one part of which misses a file."""
    part = DatasetFolder(copied).part_folders()[0]
    (tmp_path / "thesis.tex").write_text(SECRET)
    marker = json.loads((part / OUTPUT_MARKER).read_text())
    marker["files"] |= {name.format(tmp_path): "0" * 64, "up": "link"}
    (part / OUTPUT_MARKER).write_text(json.dumps(marker))
    (part / "up").symlink_to(tmp_path)
    (part / "steps.parquet").unlink()
    if name != "up/x":
        with pytest.raises(InputError, match=r"no list of its files, .*; delete the part, and"):
            make(profile, copied)
    else:
        (tmp_path / "x").write_text(SECRET)
        assert make(profile, copied).complete
        assert (tmp_path / "x").read_text() == SECRET
    assert (tmp_path / "thesis.tex").read_text() == SECRET


@pytest.mark.parametrize("kind", ["link out", "link to a folder", "device", "pipe"])
@pytest.mark.parametrize(
    "place",
    ["parts", "parts/000001", "profiles/0", "steps.parquet", "dataset.json", ".lock-1-of-1"],
)
def test_a_folder_that_leads_elsewhere_is_not_gone_on_with(
    profile: Path, tmp_path: Path, place: str, kind: str, copied: Path
) -> None:
    secret = lure(copied / place, kind, tmp_path / "outside")
    with pytest.raises(InputError, match=r"is a link|no regular file"):
        make(profile, copied)
    assert secret.read_text() == SECRET and os.listdir(secret.parent) == [secret.name]


WIDTH, HEIGHT, RADIUS_PX = 96, 72, 3.0


def dotted_profile(folder: Path) -> Path:
    """Colours that no press changes, on a pad with 4 x 3 dots."""
    profile = small_profile()
    view = profile.grid().resized(WIDTH, HEIGHT)
    pitch_mm = 18.0 * view.mm_per_px_x
    markers = MarkersBlock(
        rows=3, columns=4, pitch_x_mm=pitch_mm, pitch_y_mm=pitch_mm,
        radius_mm=RADIUS_PX * view.mm_per_px_x, provenance=ASSUMED,
    )  # fmt: skip
    for name in ("perturbation", "color", "background"):
        profile = profile.without(name)
    profile = profile.with_block(CameraBlock.from_grid(view, ASSUMED))
    places = view.pixel_from_gel(markers.grid().points_mm())
    save_profile(with_painted_dots(profile, places, RADIUS_PX).with_block(markers), folder)
    return folder


@pytest.mark.thorough
def test_dots_go_with_the_markers(tmp_path: Path) -> None:
    profile = dotted_profile(tmp_path / "profile")
    make(
        profile, tmp_path / "out", dataset={"episodes": 1},
        objects=[{"tool": "sphere:3"}],
        motions=[{"kind": "slip", "depth_mm": [0.3, 0.4], "shear_mm": [0.3, 0.4]}],
    )  # fmt: skip
    data = Dataset(tmp_path / "out")
    rgb = data.read("rgb", slice(None)).astype(float)
    markers = data.read("markers_px", slice(None))
    background = data.profile(0).background_rgb
    assert background is not None
    assert np.abs(rgb[0] - background).max() <= 1
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    moved = np.linalg.norm(markers[-1] - markers[0], axis=1)
    assert moved.max() > 0.7
    for step in (0, len(rgb) - 1):
        for u_px, v_px in markers[step]:
            near = np.hypot(u - u_px, v - v_px) < 2 * RADIUS_PX
            dark = (LIGHT - rgb[step, ..., 0])[near]
            middle = [(dark * u[near]).sum() / dark.sum(), (dark * v[near]).sum() / dark.sum()]
            assert np.hypot(*(np.array(middle) - [u_px, v_px])) < 0.25


@pytest.mark.thorough
@pytest.mark.parametrize(
    "sensor", ["gelsight_mini", pytest.param("gelsight_40", marks=pytest.mark.slow)]
)
def test_all_channels_of_a_predicted_picture_are_of_its_camera(sensor: str, tmp_path: Path) -> None:
    designed = catalogue_profile(sensor)
    assert designed.markers is not None
    radius_px = designed.markers.radius_mm / designed.camera.mm_per_px_x
    channels = ["rgb", "markers_px", "contact_mask", "depth_mm", "patch_forces_n"]
    make(
        sensor, tmp_path / "out",
        dataset={"episodes": 1, "x_mm": [3.0, 3.0], "y_mm": [2.0, 2.0]},
        objects=[{"tool": "sphere:4"}],
        motions=[{"kind": "press", "depth_mm": [0.7, 0.7]}],
        output={"channels": channels, "patches": [8, 6]},
    )  # fmt: skip
    data = Dataset(tmp_path / "out")
    rgb, markers, touched, patches = (
        data.read(name, slice(None))
        for name in ("rgb", "markers_px", "contact_mask", "patch_forces_n")
    )
    for step in (0, len(rgb) - 1):
        found = find_dots(rgb[step], radius_px)
        assert len(found) >= 0.9 * len(markers[step])
        assert distances_px(found, markers[step]).mean() < 0.3
    camera = GelCamera.of_record(data.about[0]["sensors"][0]["units"][0]["camera"])
    # A ball sunk into the face: the middle of what it touches, seen in perspective.
    middle = camera.pixel_from_gel(np.array([3.0, 2.0, -0.7]))
    v, u = np.nonzero(touched[-1])
    assert np.abs([u.mean() - middle[0], v.mean() - middle[1]]).max() < 1.0
    force = np.linalg.norm(patches[-1], axis=-1)
    row, column = np.mgrid[: force.shape[0], : force.shape[1]]
    size = np.array([camera.width_px, camera.height_px])
    place = np.array([(force * column).sum(), (force * row).sum()]) / force.sum()
    place = (place + 0.5) * size / force.shape[::-1] - 0.5
    assert np.abs(place - middle).max() < 1.5
    # What reads the folder knows where its pixels look.
    states = read_touch(data, 0)
    sunk = next(field.values[-1] for field in states.fields if field.label == "depth image")
    deepest = states.rest_mm[np.nanargmax(sunk)]
    assert np.hypot(*(deepest[:2] - [3.0, 2.0])) < 1.0


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


@pytest.mark.thorough
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


@pytest.mark.thorough
def test_univtac_has_the_poses_of_tools_that_lean(profile: Path, tmp_path: Path) -> None:
    """Its quaternions begin with w."""
    leaning = {"tool": "sphere:3", "tilt_deg": [4, 6], "yaw_deg": [30, 60]}
    make(profile, tmp_path / "d", dataset={"episodes": 1}, objects=[leaning])
    ours = Dataset(tmp_path / "d").read("tool_pose", slice(None))
    export_univtac([tmp_path / "d"], tmp_path / "uv")
    with h5py.File(tmp_path / "uv" / "hdf5" / "0.hdf5") as file:
        theirs, still = file["embodiment/ee"][()], file["tactile/left_tactile/pose"][()]
    assert theirs[:, :3] == pytest.approx(ours[:, :3], abs=1e-7)
    turns = [Rotation.from_quat(q, scalar_first=first).as_rotvec() for q, first in
             ((theirs[:, 3:], True), (ours[:, 3:], False))]  # fmt: skip
    assert turns[0] == pytest.approx(turns[1], abs=1e-6)
    assert np.linalg.norm(turns[1], axis=1).min() > np.radians(4)
    assert Rotation.from_quat(still[:, 3:], scalar_first=True).magnitude().max() == 0


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


def test_a_data_set_that_could_not_begin_leaves_nothing(tmp_path: Path) -> None:
    root = tmp_path / "new" / "data"
    with pytest.raises(OSError), DatasetFolder(root).locked("1/1"):
        assert root.is_dir()
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert list(tmp_path.iterdir()) == []
