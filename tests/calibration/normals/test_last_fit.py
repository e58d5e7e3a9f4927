# SPDX-License-Identifier: Apache-2.0
"""Held-out presses: they reach nothing that is scored, and then the fit that profiles get."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from taccel_lab.calibration.capture import CaptureSet
from taccel_lab.calibration.normals.network_fit import InverseTraining
from taccel_lab.calibration.normals.samples import KnownPress
from taccel_lab.calibration.response.frame import CaptureScene
from taccel_lab.calibration.unfinished import Profiles
from tests.calibration.normals.conftest import QUICK, Clean, calibrated, changed
from tests.support import synthetic_presses as synthetic
from tests.support.synthetic_presses import GRID, flat_profile, synthetic_captures, with_images

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.mark.thorough
def test_held_out_images_reach_nothing_that_is_fitted_and_none_is_lost() -> None:
    captures, surfaces = synthetic_captures(8)
    split = captures.split(4)
    short = replace(QUICK, steps=20)

    def noise(image: np.ndarray, i: int) -> np.ndarray:
        spoilt = np.random.default_rng(i).integers(0, 256, image.shape, dtype=np.uint8)
        return spoilt if i in split.heldout else image

    clean = calibrated(captures, surfaces, options=short)
    spoilt = calibrated(changed(captures, noise), surfaces, options=short)
    for name, weight in clean.fit.model.weights.items():
        assert np.array_equal(weight, spoilt.fit.model.weights[name])
    assert clean.fit.left_out_deg == spoilt.fit.left_out_deg
    assert clean.train_names == spoilt.train_names
    assert clean.flat_noise_levels == spoilt.flat_noise_levels
    assert clean.heldout_means("used") != spoilt.heldout_means("used")
    other = calibrated(captures, surfaces, options=replace(short, seed=1)).fit.model.weights
    assert not np.array_equal(other["layer0.weight"], clean.fit.model.weights["layer0.weight"])
    first = split.heldout[0]
    bare = synthetic.with_circles(captures, {first: None}, heldout=split.heldout_names)
    lost = calibrated(with_images(bare, {first: bare.background}), surfaces, options=short)
    assert set(lost.failures) == {split.heldout_names[0]}
    (kept,) = lost.heldout
    wanted = (kept.used.mean_deg + kept.used.flat_deg) / 2
    assert lost.heldout_means("used")["mean_deg"] == pytest.approx(wanted)
    assert "heldout_failed" in {remark.code for remark in lost.remarks}


@pytest.mark.thorough
def test_a_profile_gets_the_fit_to_all_presses_with_scores_of_the_first(clean: Clean) -> None:
    result = clean[2]
    profiles = Profiles.of(flat_profile(GRID)).after(result)
    scored, last = profiles.basis, profiles.final
    assert scored.normals is not None and last.normals is not None and result.final is not None
    assert scored.normal_weights is not None and last.normal_weights is not None
    one, two = scored.normals.provenance, last.normals.provenance
    assert set(one.inputs) == {"background", *result.train_names}
    assert set(two.inputs) == {"background", *(f"p{i}" for i in range(16))}
    assert "then fitted to all 16 presses" in two.method and "then fitted" not in one.method
    assert two.residuals == one.residuals
    for name, weight in last.normal_weights.items():
        assert np.array_equal(scored.normal_weights[name], result.fit.model.weights[name])
        assert not np.array_equal(weight, scored.normal_weights[name])
    first, second = result.fit.model.config, result.final.model.config
    assert second.error_factor >= first.error_factor and second.cone_deg >= first.cone_deg
    assert len(second.presses_px) > len(first.presses_px)
    own = {name: getattr(first, name) for name in ("error_factor", "cone_deg", "presses_px")}
    assert replace(second, **own) == first


@pytest.mark.parametrize(("first", "folds"), [(5, [0, 1, 2, 0, 1, 2, 0, 1]), (3, [None] * 8)])
def test_a_last_fit_leaves_out_what_was_left_out(first: int, folds: list[int | None]) -> None:
    """A press that a network has seen would say of it that it errs little."""
    captures, surfaces = synthetic_captures(8)
    frames = [
        replace(f, image=f.image.astype(np.float32))
        for f in synthetic.frames_of(captures, surfaces)
    ]
    scene = CaptureScene.of(captures, None)
    training = InverseTraining(frames[:first], scene, replace(QUICK, steps=10))
    training.run()
    seen = [set(pool.tolist()) for pool in training.pools]
    last = training.go_on(frames[first:])
    assert training.folds == folds and len(last.inputs) == 8
    known = set(range(sum(len(part) for part in training.pixels[:first])))
    assert [set(pool.tolist()) & known for pool in training.pools] == seen
    assert set(last.left_out_deg) == ({f.name for f in frames} if first == 5 else set())


def test_pixels_are_the_same_on_any_number_of_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    captures, surfaces = synthetic_captures(5)
    frames, scene = synthetic.frames_of(captures, surfaces), CaptureScene.of(captures, None)
    frames = [replace(frame, image=frame.image.astype(np.float32)) for frame in frames]
    empty = np.zeros((GRID.height_px, GRID.width_px))
    tools = [KnownPress(frame.image, frame.surface.normals, empty, empty > 0) for frame in frames]
    found = []
    for cores in (1, 2):
        monkeypatch.setattr("taccel_lab.processes.ahead.usable_cores", lambda cores=cores: cores)
        training = InverseTraining(frames, scene, replace(QUICK, zooms=2), tools)
        found.append((training.inputs, training.normals, *training.pools))
    for one, other in zip(*found, strict=True):
        assert np.array_equal(one, other)


@pytest.mark.thorough
def test_an_image_without_its_press_is_not_in_the_last_fit() -> None:
    captures, surfaces = synthetic_captures(12)
    empty = captures.split(4).heldout[0]
    spoilt: CaptureSet = with_images(captures, {empty: captures.background})
    result = calibrated(spoilt, surfaces)
    assert result.final is not None and {item.name for item in result.heldout} >= {f"p{empty}"}
    assert set(result.final.inputs) == {f"p{i}" for i in range(12)} - {f"p{empty}"}
