# SPDX-License-Identifier: Apache-2.0
"""A profile in the light of today: degradation is recovered, held-out presses place no other."""

from __future__ import annotations

import dataclasses
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.calibration.capture import CapturedPress, CaptureSet, ContactCircle
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.light.light_change import RefitFrame, fit_light_change
from taccel_lab.calibration.light.refit import (
    NewFrames,
    calibrate_refit,
    refit_frames,
    refit_profile,
)
from taccel_lab.calibration.light.refit_result import RefitCalibration, refit_page
from taccel_lab.errors import InputError
from taccel_lab.networks.color_settings import ColorModelConfig
from taccel_lab.profile import BackgroundBlock, ColorBlock, Provenance, SensorProfile
from taccel_lab.signals.color_model import ColorModel
from tests.calibration.drawn.faults import add_gradient, add_noise, drift, poison, quantise
from tests.signals.host_colors import host_change
from tests.support.analytic_surface import analytic_surface
from tests.support.synthetic_presses import (
    BALL_RADIUS_MM,
    GRID,
    flat_background,
    flat_profile,
    synthetic_captures,
)

GAIN = np.array([0.7, 0.9, 1.0])
OFFSET = np.array([2.0, -1.0, 0.0])


def old_profile() -> SensorProfile:
    """A profile with a colour model of random weights whose response is some tens of levels."""
    config = ColorModelConfig(GRID.width_px, GRID.height_px, hidden=(8,))
    rng = np.random.default_rng(0)
    weights = {
        name: rng.normal(0, 1.0, shape).astype(np.float32)
        for name, shape in config.weight_shapes().items()
    }
    made_up = Provenance(kind="assumed", method="made up for a test", source="none")
    profile = flat_profile(GRID, 3.0).with_block(
        BackgroundBlock(provenance=made_up), textured().astype(np.float32)
    )
    return profile.with_block(
        ColorBlock(architecture=config.to_dict(), provenance=made_up), weights
    )


def textured() -> np.ndarray:
    rng = np.random.default_rng(5)
    return np.clip(flat_background() + rng.normal(0, 8, flat_background().shape), 0, 255)


def model_of(profile: SensorProfile) -> ColorModel:
    assert profile.color is not None and profile.color_weights is not None
    return ColorModel(ColorModelConfig.from_dict(profile.color.architecture), profile.color_weights)


def new_frames(
    profile: SensorProfile,
    count: int = 5,
    *,
    gain: np.ndarray = GAIN,
    offset: np.ndarray = OFFSET,
    noise: float = 0.0,
    whole_levels: bool = False,
    seed: int = 0,
) -> list[RefitFrame]:
    rng = np.random.default_rng(seed)
    model = model_of(profile)
    frames = []
    for i in range(count):
        circle = ContactCircle(
            float(rng.uniform(40, 120)), float(rng.uniform(40, 80)), float(rng.uniform(11, 15))
        )
        surface = analytic_surface(circle, GRID, BALL_RADIUS_MM, decay_mm=1.0)
        change = host_change(
            model, surface.normals, surface.displacement_mm(), surface.rest_normals
        )
        image = drift(textured() + change, gain, offset)
        image = add_noise(add_gradient(image, 2.0, -1.0), noise, rng)
        distance = circle.distance_px(GRID)
        frames.append(
            RefitFrame(
                f"new{i}",
                f"{i:064x}",
                quantise(image) if whole_levels else image,
                change,
                distance <= circle.radius_px,
                distance <= 1.8 * circle.radius_px,
            )
        )
    return frames


def refit(
    profile: SensorProfile, frames: list[RefitFrame], mask: np.ndarray | None = None
) -> RefitCalibration:
    return refit_profile(profile, frames, source="test", surface_provider="made up", mask=mask)


@pytest.mark.thorough
def test_perfect_degradation_is_recovered() -> None:
    profile = old_profile()
    result = refit(profile, new_frames(profile))
    assert result.fit.change.response == pytest.approx(GAIN, abs=1e-3)
    assert result.fit.change.light.gain == pytest.approx(GAIN, abs=1e-3)
    assert result.mean("after") < 0.3 and result.mean("before") > 5
    # The refitted profile renders a press that nobody has seen.
    refitted = result.apply_to(profile)
    unseen = new_frames(profile, 7, seed=3)[6]
    assert unseen.disc is not None and unseen.change is not None
    assert model_of(profile).config == model_of(refitted).config
    scaled = model_of(refitted).weights
    for name, value in model_of(profile).weights.items():
        factor = result.fit.change.response if name.startswith("layer1") else np.ones(1)
        shape = (-1,) + (1,) * (value.ndim - 1)
        assert scaled[name] == pytest.approx(value * factor.reshape(shape), rel=1e-5)
    assert refitted.background_rgb is not None
    rendered = refitted.background_rgb + result.fit.change.response * unseen.change
    assert np.abs(rendered - unseen.image)[unseen.disc].mean() < 0.2
    assert refitted.color is not None and "refitted" in refitted.color.provenance.method


@pytest.mark.thorough
def test_noise_within_its_own_sigma() -> None:
    profile = old_profile()
    off = []
    for seed in range(2):
        frames = new_frames(profile, noise=2.0, whole_levels=True, seed=seed)
        result = refit(profile, frames)
        sigma = np.maximum(result.fit.sigma.response, 1e-4)
        off.append((result.fit.change.response - GAIN) / sigma)
        assert result.mean("after") < 2.2
    # Student's t of 4 degrees of freedom: 95 % within 2.8.
    assert np.mean(np.abs(off) < 2.8) > 0.8
    assert np.median(np.abs(off)) > 0.1


@pytest.mark.thorough
def test_a_spoilt_frame_leaves_the_fit_without_it_bit_for_bit_as_it_is() -> None:
    profile = old_profile()
    old = np.asarray(profile.background_rgb, dtype=np.float64)
    frames = new_frames(profile, noise=1.0)
    clean = fit_light_change(frames, old)
    noise = np.random.default_rng(1).uniform(0, 255, old.shape)
    spoilt = [dataclasses.replace(f, image=noise) if k == 2 else f for k, f in enumerate(frames)]
    found = fit_light_change(spoilt, old)

    def same(k: int) -> list[bool]:
        a, b = clean.left_out[k], found.left_out[k]
        pairs = [(getattr(a.light, n), getattr(b.light, n)) for n in ("gain", "offset", "gradient")]
        return [np.array_equal(x, y) for x, y in [*pairs, (a.response, b.response)]]

    assert all(same(2)) and not any(same(1))


@pytest.mark.thorough
def test_masked_pixels_have_no_effect() -> None:
    profile = old_profile()
    mask = np.ones((GRID.height_px, GRID.width_px), dtype=bool)
    mask[10:50, 20:60] = False
    rng = np.random.default_rng(1)
    frames = new_frames(profile)
    spoilt = [dataclasses.replace(f, image=poison(f.image, mask, rng)) for f in frames]
    assert refit(profile, spoilt, mask).figures() == refit(profile, frames, mask).figures()


@pytest.mark.thorough
def test_untouched_frames_help_the_background() -> None:
    profile = old_profile()
    rng = np.random.default_rng(2)
    rest = [
        RefitFrame(
            f"rest{i}", f"{i:064x}",
            add_noise(add_gradient(drift(textured(), GAIN, OFFSET), 2.0, -1.0), 1.0, rng),
            None, None, None,
        )
        for i in range(3)
    ]  # fmt: skip
    result = refit(profile, [*new_frames(profile, 3, noise=1.0), *rest])
    truth = add_gradient(drift(textured(), GAIN, OFFSET), 2.0, -1.0)
    assert np.abs(result.background - truth).mean() < 0.6


@pytest.mark.thorough
def test_what_five_frames_cannot_tell_is_refused() -> None:
    profile = old_profile()
    same = new_frames(profile, gain=np.ones(3), offset=np.zeros(3), noise=1.0)
    flat = [dataclasses.replace(f, image=add_gradient(f.image, -2.0, 1.0)) for f in same]
    with pytest.raises(InputError, match="the old profile stays"):
        refit(profile, flat)
    with pytest.raises(InputError, match="at least 3, better 5"):
        refit(profile, same[:2])
    untouched = [dataclasses.replace(f, change=None, disc=None, near=None) for f in same]
    with pytest.raises(InputError, match="at least 2 presses"):
        refit(profile, untouched)
    wild = [
        dataclasses.replace(
            f, image=textured() + (f.change if f.change is not None else 0) * (0.2 + 0.6 * i)
        )
        for i, f in enumerate(new_frames(profile))
    ]
    with pytest.raises(InputError, match="cannot tell the correction"):
        refit(profile, wild)
    with pytest.raises(InputError, match="nothing to refit"):
        refit(profile.without("background"), same)


@pytest.mark.thorough
def test_held_out_presses_are_scored_and_change_nothing() -> None:
    profile = old_profile()
    frames = new_frames(profile, 7, noise=1.0)
    plain = refit(profile, frames[:5])
    result = refit_profile(
        profile, frames[:5], source="test", surface_provider="made up", heldout=frames[5:]
    )
    assert np.array_equal(result.background, plain.background)
    assert np.array_equal(result.fit.change.response, plain.fit.change.response)
    assert result.errors == plain.errors and plain.heldout == ()
    assert [error.name for error in result.heldout] == ["new5", "new6"]
    for error in result.heldout:
        assert error.after < 1.5 and error.before > 5
    assert len(result.figures()["heldout"]) == 2
    titles = [table.title for table in refit_page(result, profile).tables]
    assert "Held-out presses" in titles
    assert "Held-out presses" not in [t.title for t in refit_page(plain, profile).tables]


COUNT = 9


@pytest.fixture(scope="module")
def captures() -> CaptureSet:
    found, _ = synthetic_captures(COUNT)
    return found


@pytest.fixture(scope="module")
def profile(captures: CaptureSet) -> SensorProfile:
    # The colours of the presses are none of its model's: only circles and surfaces matter here.
    old = old_profile()
    assert old.background is not None
    return old.with_block(old.background, captures.background.astype(np.float32))


def folder_of(captures: CaptureSet, stated: tuple[str, ...] | None = None) -> CaptureFolder:
    return CaptureFolder(
        source="memory", root=Path("memory"), sensor="gelsight", unit=None, background=None,
        untouched=(), mask=None, mm_per_px=None, ball_radius_mm=BALL_RADIUS_MM,
        presses=captures.presses, heldout=stated,
    )  # fmt: skip


def names(frames: NewFrames) -> tuple[set[str], set[str]]:
    return {f.name for f in frames.fitted}, {f.name for f in frames.heldout}


def spoilt(press: CapturedPress) -> CapturedPress:
    """The press seen elsewhere, with another radius."""
    image = np.roll(press.image(), (7, -9), axis=(0, 1))
    return replace(press, read=partial(np.copy, image))


@pytest.mark.thorough
def test_what_the_manifest_holds_out_is_held_out(
    captures: CaptureSet, profile: SensorProfile
) -> None:
    few = replace(captures, presses=captures.presses[:3])
    assert names(refit_frames(profile, folder_of(few, ("p1",)))) == ({"p0", "p2"}, {"p1"})
    assert names(refit_frames(profile, folder_of(few))) == ({"p0", "p1", "p2"}, set())


@pytest.mark.thorough
def test_held_out_images_place_no_other_press(captures: CaptureSet, profile: SensorProfile) -> None:
    folder = folder_of(captures)
    heldout = folder.split().heldout
    presses = tuple(spoilt(p) if i in heldout else p for i, p in enumerate(captures.presses))
    clean, dirty = (
        refit_frames(profile, f) for f in (folder, folder_of(replace(captures, presses=presses)))
    )
    everyone = {press.name for press in captures.presses}
    held_out = set(folder.split().heldout_names)
    assert names(clean) == (everyone - held_out, held_out) and len(held_out) == COUNT // 4
    for before, after in zip(clean.fitted, dirty.fitted, strict=True):
        assert before.disc is not None and after.disc is not None
        assert before.change is not None and after.change is not None
        assert np.array_equal(before.disc, after.disc)
        assert np.array_equal(before.change, after.change)
    # Labels place held-out presses, so that theirs do not move either.
    for before, after in zip(clean.heldout, dirty.heldout, strict=True):
        assert before.disc is not None and after.disc is not None
        assert np.array_equal(before.disc, after.disc)
        assert not np.array_equal(before.image, after.image)


@pytest.mark.thorough
def test_a_held_out_press_without_a_label_is_found_in_its_own_image(
    captures: CaptureSet, profile: SensorProfile
) -> None:
    bare = replace(captures, presses=tuple(replace(p, circle=None) for p in captures.presses))
    found = refit_frames(profile, folder_of(bare, ("p4",)))
    (frame,) = found.heldout
    circle = captures.presses[4].circle
    assert circle is not None and frame.disc is not None
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
