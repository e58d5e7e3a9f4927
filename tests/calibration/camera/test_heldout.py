# SPDX-License-Identifier: Apache-2.0
"""Held-out views: all of them count, and none has a part in the fit that predicts it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from taccel_lab.calibration.camera.find_boards import detect_views
from taccel_lab.calibration.camera.heldout import fold_of_views
from taccel_lab.calibration.camera.intrinsics import calibrate_intrinsics
from taccel_lab.calibration.camera.lens import LENSES
from taccel_lab.calibration.camera.robust import rms
from tests.calibration.camera.views import TRUTHS, board_of, views_of
from tests.calibration.drawn.boards import chess_pattern, pose_over, render_board
from tests.calibration.drawn.faults import add_noise, quantise

FOLDS = 3


def test_views_that_no_fit_takes_count_in_the_headline() -> None:
    views = views_of("k1", 9, 0.1, seed=2)
    clean = calibrate_intrinsics(views, models=["k1"], folds=FOLDS)
    rng = np.random.default_rng(1)
    moved = rng.normal(0, 6.0, views[5].uv_px.shape)
    views[5] = replace(views[5], uv_px=views[5].uv_px + moved)
    found = calibrate_intrinsics(views, models=["k1"], folds=FOLDS)
    assert len(found.outliers) == 1 and "view5" in found.outliers[0]
    usual = 0.1 * np.sqrt(2)
    assert clean.chosen.heldout_all_px == pytest.approx(usual, rel=0.15)
    # One view of nine; its pose takes up a little.
    assert found.chosen.heldout_all_px == pytest.approx(rms(moved) / 3, rel=0.1)
    assert found.chosen.heldout_half_px > 0.9 * found.chosen.heldout_all_px
    assert found.chosen.heldout_robust_px == pytest.approx(usual, rel=0.25)
    # It does not bend the lens, nor call it a lens of another board.
    assert np.abs(found.parameters[:4] - TRUTHS["k1"][:4]).max() < 2.0
    codes = {remark.code: remark.message for remark in found.remarks}
    assert "lens_error" not in codes
    assert f"{found.chosen.heldout_all_px:.2f} px" in codes["outlier_views"]


def test_spoilt_held_out_views_leave_the_fit_bit_for_bit_as_it_is() -> None:
    views = views_of("k1", 9, 0.2, seed=4)
    clean = calibrate_intrinsics(views, models=["k1", "fisheye"], folds=FOLDS)
    rng = np.random.default_rng(0)
    spoilt = [
        replace(view, uv_px=rng.uniform(5, 235, view.uv_px.shape)) if i % FOLDS == 1 else view
        for i, view in enumerate(views)
    ]
    found = calibrate_intrinsics(spoilt, models=["k1", "fisheye"], folds=FOLDS)
    for before, after in zip(clean.scores, found.scores, strict=True):
        assert np.array_equal(after.fold_parameters[1], before.fold_parameters[1])
        assert not np.array_equal(after.fold_parameters[0], before.fold_parameters[0])
        assert after.heldout_all_px > 20


def test_held_out_images_of_noise_leave_the_fit_bit_for_bit_as_it_is() -> None:
    """From images on: what is held out is decided by the manifest, not by what is found in them."""
    parameters, rng = np.array([270.0, 268.0, 158.0, 121.0, -0.1]), np.random.default_rng(3)
    tilts = [(25, 0), (-25, 10), (5, 28), (0, -28), (20, 20), (-15, -20)]
    images = []
    for k, tilt in enumerate(tilts):
        pose = pose_over(7, 5, 4.0, distance_mm=40 + 2 * k, tilt_deg=tilt, turn_deg=20.0 * k)
        drawn = render_board(
            LENSES["k1"], parameters, pose, (320, 240), chess_pattern(7, 5), 4.0, samples=2
        )
        images.append(quantise(add_noise(drawn, 1.5, rng)))
    clean = detect_views([board_of(images, 7, 5)])
    assert [view.place for view in clean.views] == list(range(6))
    before = calibrate_intrinsics(clean.views, models=["k1"], folds=FOLDS).chosen
    for held in (0, 2):
        noise = [
            rng.integers(0, 256, image.shape, dtype=np.uint8) if k % FOLDS == held else image
            for k, image in enumerate(images)
        ]
        left = detect_views([board_of(noise, 7, 5)])
        assert len(left.refused) == 2
        assert [view.place for view in left.views] == [k for k in range(6) if k % FOLDS != held]
        after = calibrate_intrinsics(left.views, models=["k1"], folds=FOLDS)
        assert np.array_equal(after.parameters, before.fold_parameters[held])


def test_parts_go_by_the_place_in_the_manifest() -> None:
    views = views_of("k1", 7)
    assert fold_of_views(views, 3).tolist() == [0, 1, 2, 0, 1, 2, 0]
    placed = [replace(view, place=2 * i + 1) for i, view in enumerate(views)]
    assert fold_of_views(placed, 3).tolist() == [1, 0, 2, 1, 0, 2, 1]
    # All in one part, and three views in two parts: too few would be left to fit.
    assert fold_of_views(placed, 2).tolist() == list(range(7))
    assert fold_of_views(views[:3], 2).tolist() == [0, 1, 2]
