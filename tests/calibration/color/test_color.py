# SPDX-License-Identifier: Apache-2.0
"""The colour model, its fit, and what its evaluation says."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from taccel_lab.calibration.capture import CaptureSet
from taccel_lab.calibration.circles.ball_surface import BallSurface
from taccel_lab.calibration.color.fit import fit_color
from taccel_lab.calibration.color.network_fit import ColorSamples, fit_color_model, train
from taccel_lab.calibration.press_options import ColorFitOptions, InverseFitOptions
from taccel_lab.calibration.response.frame import CaptureScene, HeldoutSet, PressFrame
from taccel_lab.calibration.unfinished import (
    BlockOutcome,
    BlockState,
    Profiles,
    UnfinishedCalibration,
)
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.networks.color_settings import ColorModelConfig
from taccel_lab.profile import load_profile, save_profile
from taccel_lab.signals.color_model import ColorModel
from taccel_lab.signals.tactile_image import tactile_image
from tests.calibration.drawn.faults import poison, quantise
from tests.support.synthetic_presses import (
    GRID,
    calibrated,
    flat_background,
    known_change,
    synthetic_captures,
    tiny_profile,
    true_surface,
    with_images,
)

QUICK = ColorFitOptions(
    hidden=(32, 32), steps=400, batch_pixels=2048, disc_pixels=1500, ring_pixels=1000,
    far_pixels=300,
)  # fmt: skip


@pytest.fixture(autouse=True)
def one_thread() -> None:
    torch.set_num_threads(1)


def frames_of(captures: CaptureSet, surfaces: list[BallSurface]) -> list[PressFrame]:
    return [
        PressFrame(press.name, press.image(), press.circle, surface, press.sha256)
        for press, surface in zip(captures.presses, surfaces, strict=True)
        if press.circle is not None
    ]


@pytest.mark.thorough
def test_round_trip_recovers_the_colour_law() -> None:
    captures, surfaces = synthetic_captures(12, noise=1.0)
    result = calibrated(captures, surfaces, options=QUICK)
    assert result.split == captures.split(4)
    assert tuple(item.name for item in result.heldout) == captures.split(4).heldout_names
    assert result.placement == "label"
    for item in result.heldout:
        surface = surfaces[int(item.name[1:])]
        truth = flat_background() + known_change(surface)
        disc = item.circle.distance_px(GRID) <= item.circle.radius_px
        # The captures' noise has a mean absolute value of 0.8 levels, the law spans +-60.
        assert np.abs(item.rendered - truth)[disc].mean() < 1.5
        assert item.score.crop_psnr_db > item.background_only.crop_psnr_db + 12
        assert item.score.crop_ssim > item.background_only.crop_ssim
    figures = result.figures()
    assert figures["heldout"]["disc_l1"] < 1.6
    psnr = [row["crop_psnr_db"] for row in figures["presses"]]
    assert psnr == sorted(psnr)


@pytest.mark.thorough
def test_poisoned_masked_pixels_have_no_effect() -> None:
    captures, surfaces = synthetic_captures(4)
    frames = frames_of(captures, surfaces)
    mask = np.ones((GRID.height_px, GRID.width_px), dtype=bool)
    mask[40:70, 60:90] = False
    rng = np.random.default_rng(0)
    spoilt = [dataclasses.replace(f, image=quantise(poison(f.image, mask, rng))) for f in frames]
    options = dataclasses.replace(QUICK, steps=40)
    whole = CaptureScene.of(captures, None)
    masked = dataclasses.replace(whole, mask=mask)
    clean = fit_color_model(frames, masked, options)
    dirty = fit_color_model(spoilt, masked, options)
    for name, weight in clean.model.weights.items():
        assert np.array_equal(weight, dirty.model.weights[name])
    assert np.array_equal(clean.background, dirty.background)
    assert clean.disc_l1_train == dirty.disc_l1_train
    unmasked = fit_color_model(spoilt, whole, options)
    other = fit_color_model(frames, whole, dataclasses.replace(options, seed=1))
    for fit in (unmasked, other):
        assert not np.array_equal(
            fit.model.weights["layer0.weight"], clean.model.weights["layer0.weight"]
        )


def test_the_steepest_ball_bounds_what_slopes_may_do() -> None:
    captures, surfaces = synthetic_captures(8)
    options = dataclasses.replace(QUICK, steps=9)
    fit = fit_color_model(frames_of(captures, surfaces), CaptureScene.of(captures, None), options)
    steepest = max(np.arccos(surface.normals[..., 2].min()) for surface in surfaces)
    assert fit.model.cone_deg == pytest.approx(np.degrees(steepest), abs=2.0)
    assert fit.model.cone_deg <= np.degrees(steepest) + 1e-9


@pytest.mark.parametrize("steps", [1, 9])
def test_a_few_steps_can_be_asked_for(steps: int) -> None:
    captures, surfaces = synthetic_captures(2)
    options = dataclasses.replace(QUICK, steps=steps)
    fit = fit_color_model(frames_of(captures, surfaces), CaptureScene.of(captures, None), options)
    assert fit.loss_curve[-1][0] == steps


def test_bad_fits_are_refused() -> None:
    captures, surfaces = synthetic_captures(3)
    with pytest.raises(InputError, match="at least one press"):
        fit_color_model([], CaptureScene.of(captures, None))
    with pytest.raises(InputError, match="steps must be at least 1"):
        ColorFitOptions(steps=0)
    with pytest.raises(InputError, match="learning_rate must lie in"):
        ColorFitOptions(learning_rate=-1.0)
    with pytest.raises(InputError, match=r"huber_levels must lie in \(0, 1000\), got 1000"):
        ColorFitOptions(huber_levels=1e3)
    with pytest.raises(InputError, match=r"learning_rate must lie in \(0, 1\), got 1"):
        InverseFitOptions(learning_rate=1.0)
    with pytest.raises(InputError, match="3 presses need as many circles and surfaces"):
        fit_color(captures, [], surfaces)
    circles = [press.circle for press in captures.presses if press.circle is not None]
    held = HeldoutSet(captures.only([1]), captures.split(2), true_surface)
    with pytest.raises(InputError, match="p1: held out and fitted at once"):
        fit_color(captures, circles, surfaces, held)
    everything = np.zeros((GRID.height_px, GRID.width_px), dtype=bool)
    masked = CaptureScene.of(dataclasses.replace(captures, mask=everything), None)
    with pytest.raises(InputError, match="masked"):
        fit_color_model(frames_of(captures, surfaces), masked, QUICK)


@pytest.mark.thorough
def test_blocks_go_through_a_profile(tmp_path: Path) -> None:
    captures, surfaces = synthetic_captures(12)
    options = dataclasses.replace(QUICK, steps=60)
    result = calibrated(captures, surfaces, options=options)
    save_profile(result.scored.apply_to(tiny_profile(GRID)), tmp_path / "profile")
    loaded = load_profile(tmp_path / "profile")
    assert loaded.color is not None and loaded.color_weights is not None
    model = ColorModel(ColorModelConfig.from_dict(loaded.color.architecture), loaded.color_weights)
    item = result.heldout[0]
    surface = true_surface(item.placed, captures.ball_radius_mm)
    assert loaded.background_rgb is not None
    rendered = tactile_image(model, loaded.background_rgb, surface)
    assert np.array_equal(rendered, item.rendered)
    residuals = loaded.color.provenance.residuals
    assert residuals["heldout_disc_l1"] == pytest.approx(
        np.mean([held.score.disc_l1 for held in result.heldout])
    )
    assert result.split is not None
    fitted = {press.name for press in captures.presses} - set(result.split.heldout_names)
    assert set(loaded.color.provenance.inputs) == {"background", *fitted}
    assert result.split.sha256[:16] in loaded.color.provenance.method


@pytest.mark.thorough
def test_a_profile_gets_the_fit_to_all_presses_with_the_scores_of_the_first() -> None:
    captures, surfaces = synthetic_captures(12)
    result = calibrated(captures, surfaces, options=dataclasses.replace(QUICK, steps=60))
    last, scored = (item.apply_to(tiny_profile(GRID)) for item in (result, result.scored))
    assert last.color is not None and scored.color is not None and last.color_weights is not None
    names = {press.name for press in captures.presses}
    assert set(last.color.provenance.inputs) == {"background", *names}
    assert "then fitted to all 12 presses" in last.color.provenance.method
    assert result.final is not None and result.scored.final is None
    # Normals are read against the same background as they were fitted to.
    np.testing.assert_array_equal(last.background_rgb, scored.background_rgb)
    for name, weight in last.color_weights.items():
        assert np.array_equal(weight, result.final.model.weights[name])
        assert not np.array_equal(weight, result.fit.model.weights[name])
    for name, value in scored.color.provenance.residuals.items():
        if name.startswith("heldout"):
            assert last.color.provenance.residuals[name] == value
    assert calibrated(captures, surfaces, options=QUICK, holdout_every=0).final is None


@pytest.mark.thorough
def test_an_image_without_its_press_is_not_in_the_last_fit() -> None:
    captures, surfaces = synthetic_captures(12)
    empty = captures.split(4).heldout[0]
    image = np.round(captures.background).astype(np.uint8)
    spoilt = with_images(captures, {empty: image})
    result = calibrated(spoilt, surfaces, options=dataclasses.replace(QUICK, steps=60))
    names = {press.name for press in captures.presses}
    assert result.final is not None
    assert set(result.final.inputs) == names - {captures.presses[empty].name}


@pytest.mark.thorough
def test_later_blocks_build_on_the_model_that_was_scored(tmp_path: Path) -> None:
    captures, surfaces = synthetic_captures(12)
    result = calibrated(captures, surfaces, options=dataclasses.replace(QUICK, steps=20))
    profiles = Profiles.of(tiny_profile(GRID)).after(result)
    kept = UnfinishedCalibration.open(tmp_path / "kept", "key")
    kept.add(BlockOutcome("color", BlockState.DONE, "good"), profiles, None)
    again = UnfinishedCalibration.open(tmp_path / "kept", "key").profiles
    assert again is not None
    for found in (profiles, again):
        assert found.basis.color is not None and found.final.color is not None
        seen = set(found.basis.color.provenance.inputs)
        assert seen == {"background", *result.train_names}
        assert set(found.final.color.provenance.inputs) > seen


@pytest.mark.thorough
def test_light_that_changes_within_the_image_asks_for_bands() -> None:
    """Lamps in stripes of a fifth of the image: the plain network smooths them away."""
    captures, surfaces = synthetic_captures(20, noise=1.0, seed=3)
    stripes = 1 + np.sin(2 * np.pi * 5 * np.arange(GRID.width_px) / GRID.width_px)[None, :, None]
    truth = [flat_background() + known_change(surface) * stripes for surface in surfaces]
    rng = np.random.default_rng(0)
    noisy = [np.clip(x + rng.normal(0, 1, x.shape), 0, 255) for x in truth]
    frames = [
        dataclasses.replace(frame, image=image)
        for frame, image in zip(frames_of(captures, surfaces), noisy, strict=True)
    ]
    error = {}
    for bands in (0, 4):
        fit = fit_color_model(
            frames[5:], CaptureScene.of(captures, None),
            dataclasses.replace(QUICK, position_bands=bands),
        )  # fmt: skip
        off = []
        for frame, wanted in zip(frames[:5], truth[:5], strict=True):
            rendered = tactile_image(fit.model, fit.background, frame.surface)
            disc = frame.circle.distance_px(GRID) <= frame.circle.radius_px
            off.append(np.abs(rendered - wanted)[disc].mean())
        error[bands] = np.mean(off)
    assert error[4] < 0.6 * error[0], error


SHARE, LEVELS, FAR = 0.3, 10.0, 100.0
"""Of the pixels, a share is off by so much: a hair, a glint."""


def pixels(count: int = 4000) -> ColorSamples:
    rng = np.random.default_rng(3)
    slope = rng.uniform(0.2, 0.5, (count, 2)) * rng.choice([-1, 1], (count, 2))
    normals = np.concatenate([-slope, np.ones((count, 1))], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    change = np.full((count, 3), LEVELS)
    change[rng.uniform(size=count) < SHARE] += FAR
    return ColorSamples(
        uv=rng.uniform(-1, 1, (count, 2)),
        normals=normals,
        rest_normals=np.tile([0.0, 0.0, 1.0], (count, 1)),
        displacement_mm=rng.uniform(-0.4, -0.1, count),
        change=change,
    )


@pytest.mark.parametrize("width", [5.0, 40.0])
def test_the_width_says_how_far_pixels_that_are_far_off_draw(width: float) -> None:
    """The answer a draws by (1 - share) (a - levels) against share * width: in closed form."""
    options = ColorFitOptions(
        steps=400, batch_pixels=1024, hidden=(8,), learning_rate=0.02, huber_levels=width
    )
    samples = pixels()
    model, curve = train(samples, PixelGrid(40, 30, 0.1, 0.1), options)
    index = np.arange(len(samples.uv)) % (40 * 30)
    found = model.predict_pixels(
        index, samples.normals, samples.displacement_mm, samples.rest_normals
    )
    share = np.mean(samples.change[:, 0] > LEVELS)
    drawn = share / (1 - share) * width
    assert np.median(found) - LEVELS == pytest.approx(drawn, rel=0.25)
    # Slope 1 beyond the width: a mean absolute error [levels].
    near, far = drawn**2 / 2, width * (FAR - drawn - width / 2)
    loss = np.mean([loss for step, loss in curve if step > 300])
    assert loss == pytest.approx(((1 - share) * near + share * far) / width, rel=0.1)
