# SPDX-License-Identifier: Apache-2.0
"""A force model is trained, judged on what it did not see, kept in the profile and refused."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.datasets.reading import Dataset
from taccel_lab.errors import InputError
from taccel_lab.learning.force.fit import calibrate_force
from taccel_lab.learning.force.force_page import force_page
from taccel_lab.learning.force.options import ForceOptions
from taccel_lab.learning.force.read_force import ForceReader
from taccel_lab.learning.force.result import ForceCalibration
from taccel_lab.learning.force.samples import read_samples, split_touches
from taccel_lab.learning.force.score import outside_rows
from taccel_lab.learning.force.train import LightDraw, LightSpread, tell, whitening
from taccel_lab.networks.force_settings import ForceModelConfig
from taccel_lab.profile import CameraBlock, MarkersBlock, load_profile, save_profile
from taccel_lab.report.page import write_page
from taccel_lab.signals.force_network import patch_centers_mm
from tests.learning.force.conftest import QUICK
from tests.learning.force.small_touches import COLUMNS, ROWS, TEST, planned, write_touches
from tests.support.small_data_sets import ASSUMED, SIZE

BRIEF = dataclasses.replace(QUICK, steps=3)


@pytest.mark.thorough
def test_it_tells_forces_of_balls_and_units_that_it_never_saw(trained: ForceCalibration) -> None:
    found = trained.overall
    assert found.fz_n < 0.25 * found.fz_spread_n
    assert found.shear_n < 0.8 * found.shear_spread_n
    assert found.area_mm2 < 2.0
    assert trained.at_rest is not None and trained.at_rest.fz_n < 0.1
    # The modulus of each touch is not in its image.
    assert trained.unknown_stiffness_n > 1.5 * found.fz_n
    assert trained.split.test_objects == (TEST,) and trained.split.test_units == (3,)
    assert trained.label_floor_n[0] > 0
    names = {row.name for row in trained.tables["object"]}
    assert TEST in names and {row.name for row in trained.tables["motion"]} == {"shear"}


@pytest.mark.thorough
def test_what_is_not_of_this_sensor_is_noticed(trained: ForceCalibration) -> None:
    found = {row.name: row.outside for row in trained.imposters}
    for name in ("black frame", "white frame", "noise", "red and blue swapped", "turned by half"):
        assert found[name] > 0.95, name
    assert trained.false_alarms < 0.15


@pytest.mark.thorough
def test_deeper_touches_are_seen(sensor: Path, trained: ForceCalibration, tmp_path: Path) -> None:
    """At twice the depth, by what was not asked before: colours and forces of single patches."""
    deep = planned(sensor, episodes=24, depth_mm=(1.5, 1.7))
    data = Dataset(write_touches(deep, tmp_path / "deep"))
    config, grid = trained.config, load_profile(sensor).grid()
    samples = read_samples(data, np.arange(len(data.episodes)), config)
    centers = patch_centers_mm(config, grid)
    weights = trained.trained.weights
    predicted = tell(samples, config, weights, centers, LightSpread(), QUICK, seed=1)
    beyond = samples.about["depth_mm"] > 1.2
    assert beyond.sum() > 20
    assert outside_rows(predicted, config)[beyond].mean() > 0.7
    # Not by the force and the area alone, which flatter tools may have reached.
    for changes in ({"most": (math.inf,) * 4}, {"distance_limits": (math.inf,) * 3}):
        limits = {"most": (*[math.inf] * 3, config.most[3]), **changes}
        limits = {"distance_limits": (*[math.inf] * 2, config.distance_limits[2]), **limits}
        assert outside_rows(predicted, dataclasses.replace(config, **limits))[beyond].mean() > 0.7


def test_labels_are_nominal_and_patches_add_up(sensor: Path, tmp_path: Path) -> None:
    data = Dataset(write_touches(planned(sensor, episodes=10), tmp_path / "data"))
    config = ForceModelConfig(*SIZE, columns=COLUMNS, rows=ROWS)
    samples = read_samples(data, np.arange(len(data.episodes)), config)
    sums = samples.patches_n.sum(axis=(2, 3))
    np.testing.assert_allclose(sums, samples.targets[:, :3], atol=1e-5)
    wrench = data.read("wrench", slice(None))
    factor = data.episode_table["young_modulus_factor"][data.steps["place"]]
    np.testing.assert_allclose(samples.targets[:, 2] * factor, wrench[:, 2], rtol=1e-5)
    np.testing.assert_allclose(samples.targets[:, 3] * factor, 1e3 * wrench[:, 3], rtol=1e-4)
    at_rest = data.steps["step"] == 0
    assert not samples.change[at_rest].any() and np.ptp(factor) > 0.3


@pytest.mark.thorough
def test_a_profile_scales_it(touches: Path, trained: ForceCalibration, tmp_path: Path) -> None:
    data = Dataset(touches)
    base = data.profile(0)
    save_profile(trained.apply_to(base), tmp_path / "p")
    profile = load_profile(tmp_path / "p")
    assert profile.force is not None and profile.force.provenance.inputs
    steps = np.flatnonzero(data.steps["place"] == int(trained.split.test[0]))
    rest, image = data.read("rgb", steps[[0, -1]])
    reader = ForceReader(profile, background=rest)
    found = reader.read(image)
    np.testing.assert_allclose(found.patch_forces_n.sum(axis=(0, 1)), found.force_n)
    assert found.touched and found.center_mm is not None
    row = data.episodes[int(trained.split.test[0])]
    wanted = data.read("wrench", steps[-1:])[0, 2] / row["young_modulus_factor"]
    assert abs(found.force_n[2] - wanted) < 4 * found.sigma[2]
    assert found.sigma[2] >= 0.1 * abs(found.force_n[2])
    stiff = profile.material.replace(young_modulus_pa=2 * profile.material.young_modulus_pa)
    twice = ForceReader(profile.with_block(stiff), background=rest).read(image)
    np.testing.assert_allclose(twice.force_n, 2 * found.force_n)
    np.testing.assert_allclose(twice.moment_nmm, 2 * found.moment_nmm)
    assert twice.area_mm2 == found.area_mm2 and twice.outside == found.outside
    nothing = reader.read(rest)
    assert not nothing.touched and nothing.center_mm is None
    black = reader.read(np.zeros_like(image))
    assert black.outside and black.figures()["inside_training"] is False


@pytest.mark.thorough
def test_scalars_are_the_loss(touches: Path) -> None:
    seen: list[tuple[int, float]] = []
    found = calibrate_force(
        touches, options=BRIEF, scalars=lambda values, step: seen.append((step, values["loss"]))
    )
    assert seen == found.trained.curve and seen[-1][0] == BRIEF.steps


@pytest.mark.thorough
def test_markers_may_help_where_both_have_them(touches: Path, sensor: Path) -> None:
    sizes = {"rows": 4, "columns": 6, "pitch_x_mm": 2, "pitch_y_mm": 2, "radius_mm": 0.2}
    dots = MarkersBlock(**sizes, provenance=ASSUMED)
    profile = load_profile(sensor).with_block(dots)
    found = calibrate_force(touches, profile, dataclasses.replace(BRIEF, markers="auto"))
    assert found.markers_tell and found.test.moved is not None
    assert np.abs(found.test.moved[:, :2]).max() > 0.1
    assert any(remark.code == "force_other_profile" for remark in found.remarks)


@pytest.mark.thorough
def test_the_page_says_it_all(trained: ForceCalibration, tmp_path: Path) -> None:
    write_page(force_page(trained), tmp_path / "page")
    text = (tmp_path / "page" / "report.html").read_text()
    assert "By depth past first touch" in text and TEST in text
    assert (tmp_path / "page" / "patches.png").stat().st_size > 5000


def row(episode: int, label: str, unit: int = 0, *, split: str = "train", seed: int = 3) -> dict:
    return {"split": split, "object": label, "unit": unit, "seed": seed, "episode": episode}


@pytest.mark.thorough(cases=("True",))
@pytest.mark.parametrize("held_out", [True, False])
def test_no_touch_is_on_two_sides(sensor: Path, held_out: bool) -> None:
    whole = planned(sensor, held_out=held_out)
    rows = [
        row(e.index, whole.spec.objects[e.object].label, e.unit, split=e.split)
        for e in whole.episodes
    ]
    split = split_touches(rows)
    sides = [set(part.tolist()) for part in (split.train, split.validation, split.test)]
    assert sum(map(len, sides)) == len(rows) == len(set.union(*sides))
    objects = [{rows[k]["object"] for k in side} for side in sides]
    assert not objects[0] & objects[1]
    assert split.test_units and split.test_objects
    if not held_out:
        assert "by hash" in split.rule
        again = split_touches([dict(row, seed=99) for row in rows])
        assert np.array_equal(again.test, split.test)


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 40), st.integers(0, 2**31), st.integers(1, 3))
def test_small_data_sets_are_split_or_refused(count: int, seed: int, objects: int) -> None:
    rng = np.random.default_rng(seed)
    rows = [row(k, f"o{rng.integers(objects)}", seed=seed) for k in range(count)]
    try:
        split = split_touches(rows)
    except InputError as error:
        assert "make a larger one" in str(error)
        return
    parts = np.concatenate([split.train, split.validation, split.test])
    assert sorted(parts.tolist()) == list(range(count))


@pytest.mark.thorough
def test_unusable_data_sets(touches: Path, sensor: Path, tmp_path: Path) -> None:
    bare = write_touches(planned(sensor, episodes=8, channels=["markers_px"]), tmp_path / "bare")
    profile, camera = load_profile(sensor), load_profile(sensor).camera
    colourless = profile.without("background", "color")
    wide = colourless.with_block(camera.replace(width_px=48, height_px=24))
    half = {f"mm_per_px_{axis}": getattr(camera, f"mm_per_px_{axis}") / 2 for axis in "xy"}
    middle = {"center_u_px": 15.5, "center_v_px": 11.5, "provenance": camera.provenance}
    zoomed = profile.with_block(CameraBlock(width_px=32, height_px=24, **half, **middle))
    save_profile(
        profile.with_block(profile.material.replace(young_modulus_pa=3e5)), tmp_path / "stiff"
    )
    other = write_touches(planned(tmp_path / "stiff", episodes=8), tmp_path / "data")
    for data, shown, changes, words in (
        (bare, None, {}, "no channel rgb, patch_forces_n"),
        (touches, wide, {}, "not the same view"),
        (touches, zoomed, {}, "2 times the width of gel"),
        (touches, None, {"markers": "on"}, "the profile has no block markers"),
        (touches, None, {"device": "tpu"}, "cpu or cuda"),
        ([touches, other], None, {}, "touches of 2 sensors"),
    ):
        with pytest.raises(InputError, match=words):
            calibrate_force(data, shown, dataclasses.replace(BRIEF, **changes))
    for changes in ({"steps": 0}, {"learning_rate": 2.0}, {"light": -1.0}, {"stiffness": 1.5}):
        with pytest.raises(InputError, match=next(iter(changes))):
            ForceOptions(**changes)  # type: ignore[arg-type]


def test_lights_are_those_of_the_profile_and_leave_a_dark_pixel_dark() -> None:
    change, rest = torch.zeros(64, 3, 6, 8), torch.full((64, 3, 6, 8), 100.0)
    spread = LightSpread(gain=(0.1, 0, 0), pivot=(0, 0, 0), offset=(0, 2.0, 0))
    lit = LightDraw(spread, 1.0, 5).lit(change, rest)
    assert lit[:, 0].std() == pytest.approx(10, rel=0.3)
    assert lit[:, 1].std() == pytest.approx(2, rel=0.3) and not lit[:, 2].any()
    assert torch.equal(LightDraw(spread, 0.0, 5).lit(change, rest), change)
    bright = LightDraw(LightSpread(offset=(50.0, 50.0, 50.0)), 1.0, 5).lit(change, rest + 150)
    assert float((bright + rest + 150).max()) <= 255


def test_whitening_leaves_unit_variances() -> None:
    rng = np.random.default_rng(0)
    values = rng.normal(size=(4000, 3)) @ rng.normal(size=(3, 3)).T
    white = (values - values.mean(axis=0)) @ whitening(values).T
    np.testing.assert_allclose(np.cov(white.T), np.eye(3), atol=0.05)
