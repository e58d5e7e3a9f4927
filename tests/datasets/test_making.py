# SPDX-License-Identifier: Apache-2.0
"""Data sets are made, with dots, by one command that goes on where it stopped."""

from __future__ import annotations

import errno
import gc
import json
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taccel_lab.camera.gel_camera import GelCamera
from taccel_lab.datasets import runner
from taccel_lab.datasets.check import check_dataset
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
from tests.support.strangers import SECRET, lure


@pytest.mark.thorough
def test_shards_in_folders_of_their_own_are_one_data_set(
    profile: Path, made: Path, copied: Path, tmp_path: Path
) -> None:
    """A shard has the bytes that one run of all gave; the other is what that run has besides."""
    assert make(profile, tmp_path / "a", (2, 2)).complete
    shard = parts_of(tmp_path / "a")
    assert shard and shard.items() < parts_of(made).items()
    for part in plan(profile).shard(2, 2):
        shutil.rmtree(copied / "parts" / part.name)
    DatasetFolder(copied).write_index()
    assert {**shard, **parts_of(copied)} == parts_of(made)
    both = Dataset([tmp_path / "a", copied])
    assert len(both) == len(Dataset(made))
    assert sorted(row["episode"] for row in both.episodes) == list(range(6))
    assert not check_dataset([tmp_path / "a", copied])


def chunk_of(part: Path) -> Path:
    return next(path for path in (part / "data.zarr/rgb/c").rglob("*") if path.is_file())


@pytest.mark.thorough
def test_the_same_command_goes_on_and_ends_the_same(
    profile: Path, made: Path, copied: Path
) -> None:
    """After a kill, that left one part half written and cut another short; in another process."""
    gone, cut, *sound = DatasetFolder(copied).part_folders()
    gone.rename(gone.with_name(f".taccel-lab-new-{gone.name}"))
    chunk_of(cut).write_bytes(chunk_of(cut).read_bytes()[:10])
    stamps = [(part / "steps.parquet").stat().st_mtime_ns for part in sound]
    said: list[str] = []
    outcome = make(profile, copied, processes=1, say=said.append)
    assert outcome.complete and outcome.parts_there == len(sound) == 1
    assert sorted(done.part for done in outcome.done) == [0, 1]
    assert parts_of(copied) == parts_of(made)
    assert [(part / "steps.parquet").stat().st_mtime_ns for part in sound] == stamps
    assert not list((copied / "parts").glob(".*"))
    assert "part 000001 is damaged and made again: " in said[0] and "has 10 bytes of" in said[0]
    assert make(profile, copied, say=said.append).done == [] and len(said) == 1


def listed(part: Path, **files: str | None) -> None:
    """Change the list of a part's files; without any, it loses their sizes."""
    marker = json.loads((part / OUTPUT_MARKER).read_text())
    kept = {"files": marker["files"] | files, "bytes": marker["bytes"] if files else None}
    (part / OUTPUT_MARKER).write_text(json.dumps(kept))


def lose_a_chunk(part: Path) -> None:
    chunk_of(part).unlink()


def empty_a_chunk_without_sizes(part: Path) -> None:
    chunk_of(part).write_bytes(b"")
    listed(part)


def add_notes(part: Path) -> None:
    (part / "episodes.parquet").unlink()
    (part / "notes.txt").write_text("mine")


def cut_the_list(part: Path) -> None:
    marker = part / OUTPUT_MARKER
    marker.write_bytes(marker.read_bytes()[:50])


def list_outside(name: str) -> Callable[[Path], None]:
    """Have the list of a part name a file elsewhere, and the part miss one that it should have."""

    def damage(part: Path) -> None:
        outside = part.parents[2]
        (outside / "x").write_text(SECRET)
        (part / "up").symlink_to(outside)
        listed(part, **{name.format(outside): "0" * 64, "up": "link"})
        (part / "steps.parquet").unlink()

    return damage


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lose_a_chunk, "part 000000 is damaged and made again: data.zarr/rgb/c/0/0/0/0 is missing"),
        (empty_a_chunk_without_sizes, "part 000000 is damaged and made again: .* is empty"),
        (list_outside("up/x"), "part 000000 is damaged"),
        (add_notes, r"holds notes\.txt, which .*; delete the part, and"),
        (cut_the_list, "no list of its files, .*; delete the part, and"),
        *[
            (list_outside(name), "no list of its files, .*; delete the part, and")
            for name in ("{0}/x", "../../../x", "C:\\x", "a\0b")
        ],
    ],
)
def test_damaged_parts_are_seen_at_a_look(
    profile: Path, copied: Path, damage: Callable[[Path], None], message: str
) -> None:
    """And taken away, to be made again; what they hold of others is not."""
    part = DatasetFolder(copied).part_folders()[0]
    damage(part)
    planned, said = plan(profile).parts, list[str]()
    if "delete the part" in message:
        folder = DatasetFolder(copied)
        with pytest.raises(InputError, match=message), folder.locked("1/1"):
            folder.without_damaged(planned, said.append)
        assert part.is_dir() and (copied / ".lock-1-of-1").is_file()
    else:
        there, missing = DatasetFolder(copied).without_damaged(planned, said.append)
        assert (there, missing) == ([*planned[1:]], [planned[0]]) and not part.exists()
        (line,) = said
        assert re.search(message, line)
    outside = copied.parent / "x"
    assert not outside.exists() or outside.read_text() == SECRET


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
        make(profile, tmp_path / "a", dataset={"episodes": 12})
    finally:
        gc.enable()
    # Two parts are written while the next is simulated.
    assert len(held) == 6 and max(held[3:]) <= max(held[:3])


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


def test_a_data_set_that_could_not_begin_leaves_nothing(tmp_path: Path) -> None:
    root = tmp_path / "new" / "data"
    with pytest.raises(OSError), DatasetFolder(root).locked("1/1"):
        assert root.is_dir()
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert list(tmp_path.iterdir()) == []
