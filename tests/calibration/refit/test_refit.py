# SPDX-License-Identifier: Apache-2.0
"""A profile in the light of today: degradation is recovered, held-out presses place no other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taccel_lab.calibration.capture import CapturedPress, CaptureFolder, CaptureSet, ContactCircle
from taccel_lab.calibration.refit.fit import (
    NewFrames,
    calibrate_refit,
    refit_frames,
    refit_profile,
)
from taccel_lab.calibration.refit.light_change import RefitFrame, fit_light_change
from taccel_lab.calibration.refit.result import RefitCalibration, refit_page
from taccel_lab.errors import InputError
from taccel_lab.networks.color_settings import ColorModelConfig
from taccel_lab.profile import BackgroundBlock, ColorBlock, Provenance, SensorProfile
from taccel_lab.signals.color_model import ColorModel
from tests.calibration.drawn.faults import add_gradient, add_noise, drift, poison, quantise
from tests.signals.host_colors import host_change
from tests.support import synthetic_presses as drawn
from tests.support.synthetic_presses import GRID, circles_of, with_circles

GAIN = np.array([0.7, 0.9, 1.0])
OFFSET = np.array([2.0, -1.0, 0.0])
FLAT = drawn.flat_background()
TEXTURED = np.clip(FLAT + np.random.default_rng(5).normal(0, 8, FLAT.shape), 0, 255)


def lit(image: np.ndarray, gain: np.ndarray = GAIN, offset: np.ndarray = OFFSET) -> np.ndarray:
    """In the light of today."""
    return add_gradient(drift(image, gain, offset), 2.0, -1.0)


@pytest.fixture(scope="module")
def old() -> SensorProfile:
    """A profile with a colour model of random weights whose response is some tens of levels."""
    config = ColorModelConfig(GRID.width_px, GRID.height_px, hidden=(8,))
    rng = np.random.default_rng(0)
    weights = {n: rng.normal(0, 1, s).astype(np.float32) for n, s in config.weight_shapes().items()}
    made_up = Provenance(kind="assumed", method="made up for a test", source="none")
    profile = drawn.flat_profile(GRID, 3.0)
    profile = profile.with_block(BackgroundBlock(provenance=made_up), TEXTURED.astype(np.float32))
    return profile.with_block(
        ColorBlock(architecture=config.to_dict(), provenance=made_up), weights
    )


def model_of(profile: SensorProfile) -> ColorModel:
    assert profile.color is not None and profile.color_weights is not None
    return ColorModel(ColorModelConfig.from_dict(profile.color.architecture), profile.color_weights)


Frames = Callable[..., list[RefitFrame]]


@pytest.fixture(scope="module")
def new_frames(old: SensorProfile) -> Frames:
    model = model_of(old)

    def frames(count: int = 5, noise: float = 0.0, seed: int = 0, **light: Any) -> list[RefitFrame]:
        rng, found = np.random.default_rng(seed), []
        for i in range(count):
            circle = ContactCircle(*map(float, rng.uniform((40, 40, 11), (120, 80, 15))))
            surface = drawn.true_surface(circle, drawn.BALL_RADIUS_MM)
            depth_mm = surface.displacement_mm()
            change = host_change(model, surface.normals, depth_mm, surface.rest_normals)
            image = add_noise(lit(TEXTURED + change, **light), noise, rng)
            distance = circle.distance_px(GRID)
            disc, near = distance <= circle.radius_px, distance <= 1.8 * circle.radius_px
            found.append(RefitFrame(f"new{i}", f"{i:064x}", image, change, disc, near))
        return found

    return frames


def refit(profile: SensorProfile, frames: list[RefitFrame], **more: Any) -> RefitCalibration:
    return refit_profile(profile, frames, source="test", surface_provider="made up", **more)


@pytest.mark.thorough
def test_perfect_degradation_is_recovered(old: SensorProfile, new_frames: Frames) -> None:
    result = refit(old, new_frames())
    assert result.fit.change.response == pytest.approx(GAIN, abs=1e-3)
    assert result.fit.change.light.gain == pytest.approx(GAIN, abs=1e-3)
    assert result.mean("after") < 0.3 and result.mean("before") > 5
    # The refitted profile renders a press that nobody has seen.
    refitted, unseen = result.apply_to(old), new_frames(7, seed=3)[6]
    assert model_of(old).config == model_of(refitted).config
    for name, value in model_of(old).weights.items():
        factor = result.fit.change.response if name.startswith("layer1") else np.ones(1)
        scaled = value * factor.reshape((-1,) + (1,) * (value.ndim - 1))
        assert model_of(refitted).weights[name] == pytest.approx(scaled, rel=1e-5)
    assert refitted.background_rgb is not None and unseen.change is not None
    rendered = refitted.background_rgb + result.fit.change.response * unseen.change
    assert np.abs(rendered - unseen.image)[unseen.disc].mean() < 0.2
    assert refitted.color is not None and "refitted" in refitted.color.provenance.method


@pytest.mark.thorough
def test_noise_within_its_own_sigma(old: SensorProfile, new_frames: Frames) -> None:
    off = []
    for seed in range(2):
        frames = [replace(f, image=quantise(f.image)) for f in new_frames(noise=2.0, seed=seed)]
        result = refit(old, frames)
        sigma = np.maximum(result.fit.sigma.response, 1e-4)
        off.append((result.fit.change.response - GAIN) / sigma)
        assert result.mean("after") < 2.2
    # Student's t of 4 degrees of freedom: 95 % within 2.8.
    assert np.mean(np.abs(off) < 2.8) > 0.8 and np.median(np.abs(off)) > 0.1


@pytest.mark.thorough
def test_a_spoilt_frame_leaves_the_fit_without_it_bit_for_bit_as_it_is(new_frames: Frames) -> None:
    frames = new_frames(noise=1.0)
    noise = np.random.default_rng(1).uniform(0, 255, TEXTURED.shape)
    spoilt = [replace(f, image=noise) if k == 2 else f for k, f in enumerate(frames)]
    clean, found = (fit_light_change(some, TEXTURED) for some in (frames, spoilt))

    def same(k: int) -> list[bool]:
        a, b = clean.left_out[k], found.left_out[k]
        pairs = [(getattr(a.light, n), getattr(b.light, n)) for n in ("gain", "offset", "gradient")]
        return [np.array_equal(x, y) for x, y in [*pairs, (a.response, b.response)]]

    assert all(same(2)) and not any(same(1))


@pytest.mark.thorough
def test_masked_pixels_have_no_effect(old: SensorProfile, new_frames: Frames) -> None:
    mask = np.ones((GRID.height_px, GRID.width_px), dtype=bool)
    mask[10:50, 20:60] = False
    rng, frames = np.random.default_rng(1), new_frames()
    spoilt = [replace(f, image=poison(f.image, mask, rng)) for f in frames]
    one, two = (refit(old, some, mask=mask).figures() for some in (frames, spoilt))
    assert one == two


@pytest.mark.thorough
def test_untouched_frames_help_the_background(old: SensorProfile, new_frames: Frames) -> None:
    rng, truth = np.random.default_rng(2), lit(TEXTURED)
    images = [add_noise(truth, 1.0, rng) for _ in range(3)]
    rest = [RefitFrame(f"r{i}", f"{i:064x}", image, *[None] * 3) for i, image in enumerate(images)]
    result = refit(old, [*new_frames(3, noise=1.0), *rest])
    assert np.abs(result.background - truth).mean() < 0.6


@pytest.mark.thorough
def test_what_five_frames_cannot_tell_is_refused(old: SensorProfile, new_frames: Frames) -> None:
    same = new_frames(gain=np.ones(3), offset=np.zeros(3), noise=1.0)
    wild = [
        replace(f, image=TEXTURED + np.asarray(f.change) * (0.2 + 0.6 * i))
        for i, f in enumerate(new_frames())
    ]
    for profile, frames, words in (
        (old, [replace(f, image=add_gradient(f.image, -2.0, 1.0)) for f in same], "profile stays"),
        (old, same[:2], "at least 3, better 5"),
        (old, [replace(f, change=None, disc=None, near=None) for f in same], "at least 2 presses"),
        (old, wild, "cannot tell the correction"),
        (old.without("background"), same, "nothing to refit"),
    ):
        with pytest.raises(InputError, match=words):
            refit(profile, frames)


@pytest.mark.thorough
def test_held_out_presses_change_nothing(old: SensorProfile, new_frames: Frames) -> None:
    frames = new_frames(7, noise=1.0)
    plain = refit(old, frames[:5])
    result = refit(old, frames[:5], heldout=frames[5:])
    assert np.array_equal(result.background, plain.background)
    assert np.array_equal(result.fit.change.response, plain.fit.change.response)
    assert result.errors == plain.errors and plain.heldout == ()
    assert [error.name for error in result.heldout] == ["new5", "new6"]
    assert all(error.after < 1.5 and error.before > 5 for error in result.heldout)
    assert len(result.figures()["heldout"]) == 2
    for found, told in ((result, True), (plain, False)):
        titles = [table.title for table in refit_page(found, old).tables]
        assert ("Held-out presses" in titles) == told


@pytest.fixture(scope="module")
def captures() -> CaptureSet:
    return drawn.synthetic_captures(9)[0]


@pytest.fixture(scope="module")
def profile(captures: CaptureSet, old: SensorProfile) -> SensorProfile:
    # The colours of the presses are none of its model's: only circles and surfaces matter here.
    assert old.background is not None
    return old.with_block(old.background, captures.background.astype(np.float32))


def folder_of(captures: CaptureSet, stated: tuple[str, ...] | None = None) -> CaptureFolder:
    return CaptureFolder(
        source="memory", root=Path("memory"), sensor="gelsight", unit=None, background=None,
        untouched=(), mask=None, mm_per_px=None, ball_radius_mm=drawn.BALL_RADIUS_MM,
        presses=captures.presses, heldout=stated,
    )  # fmt: skip


def names(frames: NewFrames) -> tuple[set[str], set[str]]:
    return {f.name for f in frames.fitted}, {f.name for f in frames.heldout}


@pytest.mark.thorough
def test_held_out_images_place_no_other_press(captures: CaptureSet, profile: SensorProfile) -> None:
    few = replace(captures, presses=captures.presses[:3])
    assert names(refit_frames(profile, folder_of(few, ("p1",)))) == ({"p0", "p2"}, {"p1"})
    assert names(refit_frames(profile, folder_of(few))) == ({"p0", "p1", "p2"}, set())
    folder = folder_of(captures)
    split = folder.split()

    def elsewhere(press: CapturedPress) -> CapturedPress:
        image = np.roll(press.image(), (7, -9), axis=(0, 1))
        return replace(press, read=partial(np.copy, image))

    presses = [elsewhere(p) if i in split.heldout else p for i, p in enumerate(captures.presses)]
    spoilt = folder_of(replace(captures, presses=tuple(presses)))
    clean, dirty = (refit_frames(profile, some) for some in (folder, spoilt))
    held_out = set(split.heldout_names)
    assert names(clean) == ({p.name for p in captures.presses} - held_out, held_out)
    assert len(held_out) == 9 // 4
    for before, after in zip(clean.fitted, dirty.fitted, strict=True):
        assert before.disc is not None and before.change is not None
        np.testing.assert_array_equal(before.disc, after.disc)
        np.testing.assert_array_equal(before.change, after.change)
    # Labels place held-out presses, so that theirs do not move either.
    for before, after in zip(clean.heldout, dirty.heldout, strict=True):
        assert before.disc is not None and np.array_equal(before.disc, np.asarray(after.disc))
        assert not np.array_equal(before.image, after.image)


@pytest.mark.thorough
def test_a_held_out_press_without_a_label_is_found_in_its_own_image(
    captures: CaptureSet, profile: SensorProfile
) -> None:
    bare = with_circles(captures, [None] * 9)
    (frame,) = refit_frames(profile, folder_of(bare, ("p4",))).heldout
    circle = circles_of(captures)[4]
    assert frame.disc is not None
    truth = circle.distance_px(captures.grid) <= circle.radius_px
    assert (frame.disc & truth).sum() > 0.85 * (frame.disc | truth).sum()


def test_captures_of_another_sensor_and_profiles_without_a_background_are_refused(
    captures: CaptureSet, profile: SensorProfile
) -> None:
    folder = folder_of(captures)
    with pytest.raises(InputError, match="captures are of a digit, the profile is of a"):
        calibrate_refit(replace(folder, sensor="digit"), profile)
    with pytest.raises(InputError, match="nothing to refit"):
        calibrate_refit(folder, profile.without("background"))
