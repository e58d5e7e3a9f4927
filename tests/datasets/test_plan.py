# SPDX-License-Identifier: Apache-2.0
"""Specifications of data sets and the touches they plan."""

from __future__ import annotations

import functools
import shutil
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvista
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.datasets.motion import Placing, Touch
from taccel_lab.datasets.plan import DatasetPlan
from taccel_lab.datasets.runner import touches_of
from taccel_lab.datasets.spec import DatasetSpec, load_spec
from taccel_lab.errors import InputError
from taccel_lab.model.embedding import rotate
from taccel_lab.presses import parse_indenter
from taccel_lab.presses.path import rolled_mm
from taccel_lab.profile import save_profile
from tests.support.small_data_sets import plan, small_profile, table

NO_IMAGES = {"output": {"channels": ["depth_mm"]}}
EXAMPLES = Path(__file__).parents[2] / "taccel_lab" / "datasets" / "examples"


@pytest.mark.thorough
@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.toml")), ids=lambda path: path.stem)
def test_examples_are_sound(path: Path, tmp_path: Path) -> None:
    # What a reader has of their own lies beside the file: a profile with a spread.
    beside = tmp_path / "examples"
    shutil.copytree(EXAMPLES, beside)
    save_profile(small_profile(), beside / "my_mini")
    made = DatasetPlan(load_spec(beside / path.name), beside)
    assert len(made.episodes) == made.spec.dataset.episodes
    assert {e.split for e in made.episodes} == {"train", "test"}


def motion(kind: str = "press", depth_mm: Any = (0.1, 0.2), **more: Any) -> dict[str, Any]:
    return {"motions": [{"kind": kind, "depth_mm": depth_mm, **more}]}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"dataset": {"seeds": 1}},
            r"dataset\.seeds: unknown key \(did you mean seed\?\); allowed: name, episodes, seed",
        ),
        ({"dataset": {"episodes": 0}}, r"dataset\.episodes: .*greater than or equal to 1"),
        (motion("push"), r"motions\.0\.kind: .*'press'"),
        (motion(depth_mm=[0.3, 0.2]), "wrong way round"),
        (motion(depth_mm=[0.0, 0.2]), "above 0, got 0"),
        (motion("shear"), "needs shear_mm"),
        (motion(twist_deg=[0, 1]), "twist_deg belongs to twist, not to press"),
        (motion(step_mm=1e-4), r"would take 2e\+03 steps of step_mm = 0\.0001 mm .*; at most 1000"),
        (motion(depth_mm=0.3), "a list in square brackets is needed"),
        ({"motions": []}, r"motions: list should have at least 1"),
        ({"objects": [{"tool": "sphere:2"}, {"tool": "sphere:2"}]}, "two objects are called"),
        ({"objects": [{"tool": "sphere:2", "tilt_deg": [0, 40]}]}, r"must lie in \[0, 15\]"),
        ({"randomise": {"friction": [0.5, 9]}}, r"friction must lie in \[0, 5\]"),
        ({"output": {"channels": ["rgb", "rgb"]}}, "named twice: rgb"),
        ({"output": {"size_px": [4, 4]}}, r"must lie in 8\.\.8192 px"),
        ({"dataset": {"x_mm": [0, 1], "y_mm": [0, 1], "view": 1}}, "either view, or x_mm and y_mm"),
    ],
)
def test_bad_form(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=rf"^small\.toml: .*{message}"):
        DatasetSpec.checked(table("flat_pad", **changes), "small.toml")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sensors": [{"profile": "nowhere"}]}, "neither a profile folder nor a sensor"),
        ({"objects": [{"tool": "mesh:nowhere.stl"}]}, r"nowhere\.stl"),
        ({"objects": [{"tool": "star:3"}]}, "'star:3' is not understood"),
        (motion(depth_mm=[0.1, 60.0]), r"motions\[0\] on flat_pad: depth 60 mm goes past the gel"),
        (motion(depth_mm=[1e-4, 4e-4]), r"motions\[0\]: depth_mm ends at 0\.0004 mm; .*in metres"),
        ({"output": {"channels": ["heat"]}}, "no channel 'heat'"),
        ({"output": {"channels": ["rgb", "wrench"]}}, "'wrench' is always kept; leave it out"),
        ({"sensors": [{"profile": "flat_pad", "units": 3}]}, "states no measured spread"),
        ({"dataset": {"x_mm": [0, 90], "y_mm": [0, 0]}}, r"placed at \(90, 0\) mm: .*choose a"),
    ],
)
def test_what_cannot_be_is_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        plan("flat_pad", **{**NO_IMAGES, **changes})


def test_images_need_a_sensor_that_can_draw_them(tmp_path: Path) -> None:
    save_profile(small_profile().without("color", "background", "lights"), tmp_path / "blind")
    with pytest.raises(InputError, match="neither a colour model nor an optical design"):
        plan(tmp_path / "blind")


def test_episodes_and_noise_follow_from_the_seed() -> None:
    few, other = (
        plan("flat_pad", dataset={"episodes": 2, "seed": seed}, **NO_IMAGES) for seed in (4, 5)
    )
    many = _cached_plan()
    assert many.episodes[:2] == few.episodes[:] != other.episodes[:]
    assert len({few.digest, many.digest, other.digest}) == 3
    noise = []
    for made in (few, other):
        touches = (touch for part in made.parts for touch in touches_of(made, part))
        noise.append({touch.seed for touch in touches if isinstance(touch, Touch)})
    assert len(noise[0]) == len(noise[1]) == 1 and noise[0] != noise[1]


def test_what_was_drawn_once_is_drawn_for_ever() -> None:
    """As the first version drew it: data sets that are there go on."""
    made = plan("flat_pad", randomise={"friction": [0.2, 0.4]}, **NO_IMAGES)
    drawn, put = made.episodes[4], made.episodes[4].placing
    assert (drawn.object, drawn.motion, sum(drawn.path.counts)) == (1, 0, 2)
    assert (put.x_mm, put.y_mm, put.lean_deg) == pytest.approx(
        (-2.8464645117414267, -1.9822033015002094, 184.41336448418556), rel=1e-12
    )
    assert (drawn.path.depth_mm, drawn.friction) == pytest.approx(
        (0.21060967189185284, 0.22673189257728996), rel=1e-12
    )
    assert [part.episodes for part in made.parts] == [(1, 2), (0, 3), (4, 5)]


@pytest.mark.thorough
def test_a_great_many_touches_are_not_kept_in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("taccel_lab.datasets.plan._TOLD_EVERY", 1_000)
    told: list[tuple[int, int]] = []
    made = plan("flat_pad", dataset={"episodes": 3_000}, **NO_IMAGES)
    tracemalloc.start()
    try:
        made.group(lambda task, done, total: told.append((done, total)))
        kept = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    assert kept < 3_000 * 300
    assert told[0] == (0, 3_000) and told[-1] == (3_000, 3_000) and len(told) > 3
    assert sum(part.steps for part in made.parts) == sum(
        sum(episode.path.counts) + 1 for episode in made.episodes
    )


def test_draws_keep_their_ranges() -> None:
    made = plan(
        "flat_pad", dataset={"episodes": 300}, randomise={"friction": [0.2, 0.4]}, **NO_IMAGES
    )
    low, high = made.place_range_mm(made.sensors[0])
    places = np.array([episode.placing.at_mm for episode in made.episodes])
    assert (places >= low).all() and (places <= high).all()
    for episode in made.episodes:
        least_mm, most_mm = made.spec.motions[episode.motion].depth_mm
        assert least_mm <= episode.path.depth_mm <= most_mm and 0.2 <= episode.friction <= 0.4
        assert (episode.split == "test") == (episode.object == 1)
    shares = np.bincount([episode.motion for episode in made.episodes]) / 300
    assert shares == pytest.approx([0.5, 0.5], abs=0.1)


@given(count=st.integers(1, 7))
def test_shards_share_all_parts(count: int) -> None:
    made = _cached_plan()
    shards = [made.shard(number, count) for number in range(1, count + 1)]
    indices = sorted(part.index for shard in shards for part in shard)
    assert indices == [part.index for part in made.parts]
    told = sorted(episode for part in made.parts for episode in part.episodes)
    assert told == list(range(40))
    assert max(map(len, shards)) - min(map(len, shards)) <= 1


@functools.cache
def _cached_plan() -> DatasetPlan:
    return plan("flat_pad", dataset={"episodes": 40}, **NO_IMAGES)


@pytest.mark.thorough
def test_units_differ_as_measured_and_the_first_is_the_profile(profile: Path) -> None:
    made = plan(
        profile,
        dataset={"episodes": 60},
        sensors=[{"profile": str(profile), "units": 6, "test_units": 2}],
    )
    units = made.sensors[0].units
    assert units[0].young_modulus_factor == 1 and units[0].light is None
    factors = np.array([unit.young_modulus_factor for unit in units[1:]])
    assert (np.abs(factors - 1) <= 0.2 + 1e-12).all() and np.ptp(factors) > 0.01
    assert made.sensors[0].unit_grid(1) != made.sensors[0].grid
    held_out = {e.unit for e in made.episodes if e.split == "test" and e.object == 0}
    assert held_out == {4, 5}


@pytest.mark.thorough
def test_a_view_of_a_profile_beside_the_file_is_a_sensor(tmp_path: Path) -> None:
    profile = small_profile()
    bare = profile.without("background", "color", "normals", "perturbation", "force")
    grid = bare.camera.replace(width_px=24, height_px=18, center_u_px=12.0, center_v_px=9.0)
    save_profile(profile.with_view("right", bare.with_block(grid)), tmp_path / "two")
    sensors = [{"profile": "two@right", "units": 1}]
    spec = DatasetSpec.checked(table("two@right", sensors=sensors, **NO_IMAGES), "small.toml")
    made = DatasetPlan(spec, tmp_path)
    assert made.profiles[0].grid() == grid.grid()


def test_motions_end_where_they_should() -> None:
    moved = {"kind": "shear", "depth_mm": [0.5, 0.5], "shear_mm": [0.7, 0.7]}
    rolled = {"kind": "roll", "depth_mm": [0.2, 0.2], "roll_deg": [10.0, 10.0]}
    paths = []
    for one, direction in ((moved, 30.0), (rolled, 90.0)):
        motions = [{**one, "direction_deg": [direction, direction]}]
        paths.append(plan("flat_pad", motions=motions, **NO_IMAGES).episodes[0].path)
    commands = paths[0].commands()
    assert len(commands) == sum(paths[0].counts) == 3 + 4
    assert commands[2].tolist() == [0.5, 0, 0, 0, 0, 0]
    assert commands[-1, :3] == pytest.approx([0.5, 0.7 * np.cos(np.pi / 6), 0.35])
    roll = paths[1].commands()
    # Towards y it turns about -x, and moves on by height times angle.
    assert roll[-1, 3:5] == pytest.approx([-10.0, 0.0])
    assert rolled_mm(roll[-1:], np.array([3.0]))[0] == pytest.approx([0, 3 * np.radians(10)])


def test_a_tilted_tool_touches_where_it_is_placed() -> None:
    pad = _cached_plan().sensors[0].pad
    ball = parse_indenter("sphere:3")
    placing = Placing(1.0, -2.0, yaw_deg=40.0, tilt_deg=12.0, lean_deg=70.0)
    frame = placing.frame(pad, ball)
    axis = rotate(frame[3:], np.array([0.0, 0.0, 1.0]))
    assert np.degrees(np.arccos(axis[2])) == pytest.approx(12.0)
    # Along the axis the ball's centre is its radius above the face right over the place.
    centre = frame[:3] + axis * (3e-3 / axis[2])
    assert 1e3 * centre[:2] == pytest.approx([1.0, -2.0])


def test_objects_in_another_unit_are_refused_before_any_touch(tmp_path: Path) -> None:
    """Smaller than touches are deep, or than any element: a puck of 60 mm in metres."""
    for size, words in ((0.06, "0.06 mm across.* 60 mm if"), (0.3, "0.3 mm across: less than the")):
        cube = pyvista.Cube(x_length=size, y_length=size, z_length=size).triangulate()
        cube.save(tmp_path / "cube.stl")
        objects = [{"tool": f"mesh:{tmp_path / 'cube.stl'}"}]
        with pytest.raises(InputError, match=rf"objects\[0\].*{words}"):
            plan("flat_pad", objects=objects, **NO_IMAGES)
