# SPDX-License-Identifier: Apache-2.0
"""The small network that a calibration teaches: it reads as the ensemble does, to within what it
says, and figures are of what is read with it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.calibration.normals.result import NormalCalibration
from taccel_lab.networks.normal_settings import SMALL, ensemble_of
from taccel_lab.profile import load_profile, save_profile
from taccel_lab.reading.slopes import RAYLEIGH_MEAN, NormalMap, NormalModel
from tests.calibration.normals.conftest import QUICK, calibrated, changed
from tests.support.synthetic_presses import GRID, flat_profile, synthetic_captures

pytestmark = [pytest.mark.usefixtures("one_thread"), pytest.mark.thorough]

WIDE = replace(QUICK, hidden=(64, 64), members=4, steps=150)
"""An ensemble that is worth a small network."""


@pytest.fixture(scope="module")
def fitted() -> NormalCalibration:
    captures, surfaces = synthetic_captures(16, noise=2.0)
    return calibrated(captures, surfaces, options=WIDE)


def alone(model: NormalModel) -> NormalModel:
    """The ensemble without its small network."""
    return NormalModel(replace(model.config, small_hidden=()), ensemble_of(model.weights))


def read(model: NormalModel, result: NormalCalibration) -> list[NormalMap]:
    """The held-out presses by a model."""
    return [model.predict(i.frame.image, result.scene.background) for i in result.heldout]


def test_it_reads_as_the_ensemble_to_within_what_it_says(fitted: NormalCalibration) -> None:
    model, scene = fitted.fit.model, fitted.scene
    assert model.config.small_hidden == (64, 64)
    inside = [scene.inside(item.frame.circle) for item in fitted.heldout]
    small, ensemble = read(model, fitted), read(alone(model), fitted)
    off, error, expected = (
        np.concatenate([values[part] for values, part in zip(maps, inside, strict=True)])
        for maps in (
            [
                np.linalg.norm(a.tilt_rad - b.tilt_rad, axis=-1)
                for a, b in zip(small, ensemble, strict=True)
            ],
            [np.radians(b.sigma_deg) * RAYLEIGH_MEAN for b in ensemble],
            [np.radians(a.sigma_deg) * RAYLEIGH_MEAN for a in small],
        )
    )
    assert 0 < off.mean() < 0.5 * error.mean()
    # What it adds to the error is what it is off, by mean squares.
    added = (expected**2 - error**2).mean() / (off**2).mean()
    assert 0.4 < added < 4.0
    # Untouched gel reads as the ensemble reads it.
    still = scene.background + np.random.default_rng(0).normal(0, 2.0, scene.background.shape)
    one, other = (m.predict(still, scene.background) for m in (model, alone(model)))
    away = np.linalg.norm(one.tilt_rad - other.tilt_rad, axis=-1)
    assert away.mean() < 0.25 * np.radians(other.sigma_deg).mean()


def test_figures_are_of_the_reading_that_a_user_gets(fitted: NormalCalibration) -> None:
    for item, found in zip(fitted.heldout, read(fitted.fit.model, fitted), strict=True):
        assert np.array_equal(item.predicted.tilt_rad, found.tilt_rad)
    found = fitted.reliability
    assert found is not None and found.within_95 > 0.88 and 0.6 < found.ratio() < 1.3
    scored = fitted.heldout_means("used")["mean_deg"]
    assert scored < 0.1 * fitted.heldout_means("used")["flat_deg"]
    assert "read by one of [64, 64]" in fitted.evidence.method


def test_it_goes_into_the_profile_and_comes_back(fitted: NormalCalibration, tmp_path: Path) -> None:
    assert fitted.final is not None
    profile = fitted.apply_to(flat_profile(GRID))
    assert profile.normals is not None and profile.normal_weights is not None
    save_profile(profile, tmp_path / "p")
    again = NormalModel.from_profile(load_profile(tmp_path / "p"))
    last = fitted.final.model
    assert again.config == last.config and again.config.small_hidden == (64, 64)
    image, still = fitted.heldout[0].frame.image, fitted.scene.background
    assert np.array_equal(again.predict(image, still).tilt_rad, last.predict(image, still).tilt_rad)
    # The last fit is taught anew: to answer as its own ensemble does.
    name = f"{SMALL}layer1.weight"
    assert not np.array_equal(last.weights[name], fitted.fit.model.weights[name])
    one, other = (m.predict(image, still) for m in (last, alone(last)))
    off = np.linalg.norm(one.tilt_rad - other.tilt_rad, axis=-1)
    assert off.mean() < 0.4 * np.radians(other.sigma_deg).mean()


def test_it_is_the_same_for_a_seed_and_knows_no_held_out_image() -> None:
    captures, surfaces = synthetic_captures(8)
    split, short = captures.split(4), replace(WIDE, steps=12)

    def noise(image: np.ndarray, i: int) -> np.ndarray:
        spoilt = np.random.default_rng(i).integers(0, 256, image.shape, dtype=np.uint8)
        return spoilt if i in split.heldout else image

    clean, spoilt = (
        calibrated(each, surfaces, options=short) for each in (captures, changed(captures, noise))
    )
    for name, weight in clean.fit.model.weights.items():
        assert np.array_equal(weight, spoilt.fit.model.weights[name])
    assert any(name.startswith(SMALL) for name in clean.fit.model.weights)


def test_small_ensembles_and_few_presses_are_read_by_the_ensemble() -> None:
    captures, surfaces = synthetic_captures(8)
    short = replace(WIDE, steps=12)
    small = calibrated(captures, surfaces, options=replace(short, hidden=(24, 24)))
    few, known = captures.only(range(4)), surfaces[:4]
    for result in (small, calibrated(few, known, options=short)):
        assert result.fit.model.config.small_hidden == ()
        assert not any(name.startswith(SMALL) for name in result.fit.model.weights)
        assert "read by one of" not in result.evidence.method
