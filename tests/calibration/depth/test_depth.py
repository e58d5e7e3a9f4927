# SPDX-License-Identifier: Apache-2.0
"""Depth of grey sensors: synthetic round trips with faults, and the authors' own 9DTact presses."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from taccel_lab.calibration.capture import CapturedPress, CaptureSet, ContactCircle
from taccel_lab.calibration.circles.grey import find_grey_contact
from taccel_lab.calibration.depth import curve
from taccel_lab.calibration.depth.depth_page import depth_page
from taccel_lab.calibration.depth.fit import fit_depth
from taccel_lab.calibration.depth.options import DepthOptions
from taccel_lab.calibration.depth.result import DepthCalibration
from taccel_lab.errors import InputError
from taccel_lab.files.images import read_image
from taccel_lab.files.regular_file import file_sha256
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import SensorProfile, load_profile, save_profile
from taccel_lab.reading.reader import Reader
from taccel_lab.report.page import write_page
from taccel_lab.signals.depth_response import DepthResponse
from tests.calibration.drawn.faults import quantise
from tests.support.real_data import real_data
from tests.support.synthetic_presses import flat_profile, memory_captures, with_circles, with_images

GRID = PixelGrid(200, 150, 0.1, 0.1)
BALL_MM = 4.0
TRUE = DepthResponse("grey", np.linspace(0, 80, 81), 1.6 * (np.linspace(0, 1, 81) ** 1.2))
CIRCLES = [
    ContactCircle(70.3, 60.1, 26.0),
    ContactCircle(125.7, 85.2, 29.0),
    ContactCircle(95.0, 75.0, 31.5),
]
DEEPEST_MM = BALL_MM - np.sqrt(BALL_MM**2 - (0.1 * CIRCLES[2].radius_px) ** 2)
"""The ball's depth in the last of the circles, past the rim."""
RIM = DepthOptions(zero="rim")


def captures_of(
    circles: list[ContactCircle], noise: float = 0.0, seed: int = 0, labelled: bool = True
) -> CaptureSet:
    """Ball presses on a grey sensor whose depth below the rim answers by ``TRUE``."""
    rng = np.random.default_rng(seed)
    background = np.full((GRID.height_px, GRID.width_px, 3), 160.0)
    images = []
    for circle in circles:
        distance, rim = 0.1 * circle.distance_px(GRID), 0.1 * circle.radius_px
        depth = np.sqrt(np.maximum(BALL_MM**2 - distance**2, 0)) - np.sqrt(BALL_MM**2 - rim**2)
        image = TRUE.render(np.maximum(depth, 0.0), background)
        images.append(image + rng.normal(0, noise, image.shape[:2])[..., None])
    labels = circles if labelled else [None] * len(circles)
    return memory_captures(labels, images, background, GRID, BALL_MM, "9dtact")


class GreyUnit(NamedTuple):
    """Noisy presses before a background in whole levels, and the profile that they give."""

    captures: CaptureSet
    profile: SensorProfile
    rest: np.ndarray
    """RGB uint8, as ``pressed``."""
    pressed: np.ndarray
    """The deepest of the presses."""


@cache
def grey_unit() -> GreyUnit:
    captures = captures_of(CIRCLES, noise=1.0)
    rest = captures.background.astype(np.uint8)
    captures = replace(captures, background=rest)
    profile = fit_depth(captures, RIM).apply_to(flat_profile(GRID, thickness_mm=4.0))
    return GreyUnit(captures, profile, rest, quantise(captures.presses[2].image()))


def codes(result: DepthCalibration) -> dict[str, str]:
    return {remark.code: str(remark.severity) for remark in result.remarks}


def test_perfect_presses_give_the_curve() -> None:
    result = fit_depth(captures_of(CIRCLES), RIM)
    inside = (result.response.drop_levels > 3) & (result.response.drop_levels < 60)
    wanted = TRUE.depth_of(result.response.drop_levels[inside])
    assert result.response.depth_mm[inside] == pytest.approx(wanted, abs=2e-3)
    assert result.response.depth_mm[0] == 0.0 and result.left_out == "press"
    # The deepest press lies partly beyond the curve of the others, which ends there.
    assert np.median(result.left_out_mm) < 2e-3 and result.left_out_mm.mean() < 0.02


@pytest.mark.thorough
def test_noisy_presses_lie_within_their_spread() -> None:
    scores = []
    for seed in range(3):
        result = fit_depth(captures_of(CIRCLES, noise=1.0, seed=seed), RIM)
        error = result.response.depth_mm - TRUE.depth_of(result.response.drop_levels)
        # Noise in the abscissa draws a curve's ends towards the middle, by well under a level.
        assert np.abs(error[8:55]).max() < 0.03
        scores.append((error / np.hypot(result.spread_mm, 0.003))[8:55])
    assert np.mean(np.abs(scores) < 3.0) > 0.85


@pytest.mark.thorough
def test_contacts_are_found_without_circles() -> None:
    captures = captures_of(CIRCLES, noise=1.0, labelled=False)
    for press, circle in zip(captures.presses, CIRCLES, strict=True):
        drop = (captures.background - press.image())[..., 0]
        found = find_grey_contact(drop, GRID, name=press.name).circle
        assert np.hypot(found.u_px - circle.u_px, found.v_px - circle.v_px) < 0.5
        # Smoothing moves the steepest place inwards.
        assert circle.radius_px - 2.5 < found.radius_px < circle.radius_px + 1.0
    result = fit_depth(captures)
    assert result.left_out_mm.mean() < 0.08
    assert not any(p.given for p in result.presses)


def test_one_press_is_judged_by_its_eighths() -> None:
    result = fit_depth(captures_of(CIRCLES[:1], noise=1.0), RIM)
    assert result.left_out == "eighth of the contact" and "too_few" in codes(result)
    assert result.left_out_mm.mean() < 0.05


@pytest.mark.thorough
def test_a_dark_patch_that_the_border_cuts_is_read_where_its_label_puts_it() -> None:
    cut = ContactCircle(GRID.width_px - 12.0, 70.0, 28.0)
    captures, unlabelled = (captures_of([*CIRCLES, cut], labelled=each) for each in (True, False))
    detected = DepthOptions(zero="rim", circles="detected")
    result = fit_depth(captures, RIM)
    assert len(result.presses) == 4 and result.presses[-1].given
    assert result.presses[-1].mae_mm < 0.02
    for left_out in (fit_depth(unlabelled, RIM), fit_depth(captures, detected)):
        assert len(left_out.presses) == 3
        (message,) = [r.message for r in left_out.remarks if r.code == "presses_left_out"]
        assert "p3" in message and "touches the image's border" in message
    with pytest.raises(InputError, match="touches the image's border"):
        fit_depth(captures_of([cut]), detected)


@pytest.mark.thorough
def test_labels_off_and_presses_at_one_spot_or_that_answer_differently_are_told() -> None:
    captures = captures_of(CIRCLES, noise=0.5)
    assert not {"labels_off", "too_few", "heldout_error"} & codes(fit_depth(captures)).keys()
    moved = [replace(circle, u_px=circle.u_px - 9) for circle in CIRCLES]
    assert codes(fit_depth(with_circles(captures, moved)))["labels_off"] == "error"
    far = replace(captures.presses[0], circle=replace(CIRCLES[0], u_px=160.0, v_px=110.0))
    with pytest.raises(InputError, match="given circles disagree with the images"):
        fit_depth(replace(captures, presses=(far,)))
    assert codes(fit_depth(captures_of([CIRCLES[0]] * 3, noise=0.5)))["too_few"] == "warning"
    # One press under a third of the light of the others: no curve fits both.
    captures = captures_of(CIRCLES[:2])
    dim = captures.background - 0.35 * (captures.background - captures.presses[1].image())
    assert "heldout_error" in codes(fit_depth(with_images(captures, {1: dim})))


@pytest.mark.thorough
def test_poisoned_masked_pixels_have_no_effect() -> None:
    mask = np.ones((GRID.height_px, GRID.width_px), dtype=bool)
    mask[50:56, 60:75] = mask[:, :6] = False
    captures = replace(captures_of(CIRCLES, noise=1.0, labelled=False), mask=mask)
    dirty = [np.where(mask[..., None], p.image(), 0.0) for p in captures.presses]
    one, two = fit_depth(captures), fit_depth(with_images(captures, dirty))
    assert np.array_equal(one.response.depth_mm, two.response.depth_mm)
    assert one.presses == two.presses


@pytest.mark.thorough
def test_profile_and_report(tmp_path: Path) -> None:
    captures = grey_unit().captures
    result = fit_depth(captures, RIM)
    save_profile(result.apply_to(flat_profile(GRID, thickness_mm=BALL_MM)), tmp_path / "profile")
    profile = load_profile(tmp_path / "profile")
    assert profile.depth_response is not None
    assert profile.depth_response.provenance.residuals["left_out_depth_mm"] > 0
    found = Reader(profile).read(captures.presses[2].image())
    assert 1e3 * found.depth_m.max() == pytest.approx(DEEPEST_MM, abs=0.06)
    assert found.method == "depth" and found.sigma_deg is None
    figures = found.figures()
    assert figures["sigma_of"] == "absolute depth" and not figures["warnings"]
    assert figures["depth_error_mm"] >= result.zero_sigma_mm
    circle = ContactCircle(100.0, 70.0, 28.0)
    new, exact = (captures_of([circle], noise, 9).presses[0].image() for noise in (1.0, 0.0))
    read, drop = Reader(profile).read(new), (captures.background - exact)[..., 0]
    contact = drop > result.response.drop_levels[1]
    off_mm = np.abs(1e3 * read.depth_m - TRUE.depth_of(drop))[contact]
    assert read.reading_sigma_m is not None and read.height_sigma_m is not None
    assert (off_mm <= 2e3 * read.reading_sigma_m[contact]).mean() > 0.9
    assert (read.height_sigma_m >= read.reading_sigma_m).all()
    write_page(depth_page(result), tmp_path / "report")
    assert (tmp_path / "report" / "curve.png").stat().st_size > 5_000


def test_unusable_images_are_refused() -> None:
    edge = np.zeros((150, 200))
    edge[:, 90:100] = 40.0
    empty = np.random.default_rng(0).normal(0, 1, (150, 200))
    for drop, said in ((empty, "no contact found"), (edge, "no round contact")):
        with pytest.raises(InputError, match=said):
            find_grey_contact(drop, GRID, name="empty.png")
    captures = captures_of(CIRCLES)
    for given, how, said in (
        (replace(captures, ball_radius_mm=3.14), RIM, "not below the ball's"),
        (captures, DepthOptions(zero="travel"), "zero travel needs depth_mm"),
    ):
        with pytest.raises(InputError, match=said):
            fit_depth(given, how)


REAL = {1: 0.0510151, 2: 0.0499950}
"""Scale [mm/px] of the two 9DTacts of the authors."""


@cache
def real_press(unit: int) -> tuple[DepthCalibration, np.ndarray]:
    """The press of a unit, and the authors' table of it."""
    nine = "9dtact_official/shape_reconstruction/calibration"
    folder = real_data(f"{nine}/sensor_{unit}/depth_calibration")
    image, background = folder / "rectify_crop_sample.png", folder / "rectify_crop_ref.png"
    untouched = read_image(background)
    height, width = untouched.shape[:2]
    press = CapturedPress("ball", str(image), file_sha256(image), partial(read_image, image))
    captures = CaptureSet(
        str(folder), "9dtact", untouched, file_sha256(background), np.ones((height, width), bool),
        4.0, PixelGrid(width, height, REAL[unit], REAL[unit]), (press,), {},
    )  # fmt: skip
    return fit_depth(captures), np.load(folder / "Pixel_to_Depth.npy")


@pytest.mark.parametrize("unit", REAL)
def test_the_authors_tables_of_two_units(unit: int) -> None:
    """Made from the same press by averaging and a circle of their own."""
    result, table = real_press(unit)
    drop = np.arange(5, len(table))
    off = result.response.depth_of(drop) - table[drop]
    assert np.abs(off).mean() < 0.035
    assert np.abs(off - off.mean()).mean() < 0.012
    assert result.left_out_mm.mean() < 0.035
    sigma = result.response.sigma_of(drop)
    assert sigma is not None and (np.abs(off) <= sigma).all()


@pytest.mark.thorough
@pytest.mark.parametrize("unit", REAL)
def test_the_reading_of_an_eighth_is_held_by_the_other_seven(unit: int) -> None:
    """And both zeros that the image shows by the whole, and depths of the other unit's press."""
    result, _ = real_press(unit)
    (part,) = result.parts
    held = []
    for sector in range(curve.SECTOR_COUNT):
        out = part.sector == sector
        rest = part.of(~out)
        sigma_mm = curve.reading_sigma_mm(curve.left_out_errors([rest])[0])
        off = curve.fit_response([rest]).depth_of(part.drop_levels[out]) - part.depth_mm[out]
        held.append([np.mean(np.abs(off) <= k * sigma_mm) for k in (1, 2)])
    one, two = np.mean(held, axis=0)
    assert 0.65 < one < 0.9 < two
    by_rim = fit_depth(result.captures, RIM).response
    sigma = result.response.sigma_of(part.drop_levels)
    apart = by_rim.depth_of(part.drop_levels) - result.response.depth_of(part.drop_levels)
    assert sigma is not None and (np.abs(apart) <= sigma).all()
    (other,) = real_press(3 - unit)[0].parts
    sigma = result.response.sigma_of(other.drop_levels)
    off = np.abs(result.response.depth_of(other.drop_levels) - other.depth_mm)
    assert sigma is not None and (off <= 2 * sigma).mean() > 0.93


def test_the_headline_counts_the_zero() -> None:
    circles = [ContactCircle(60 + 40 * i, 70.0, 18.0 + 2 * i) for i in range(3)]
    captures = captures_of(circles, noise=0.4)
    found = {zero: fit_depth(captures, DepthOptions(zero=zero)) for zero in ("untouched", "rim")}
    # Images show two zeros; which of them is chosen does not make the other one wrong.
    apart = abs(np.mean([p.rim_depth_mm for p in found["untouched"].presses]))
    for zero, result in found.items():
        assert result.zero_gap_mm == pytest.approx(apart, abs=1e-3)
        zero_mm = np.hypot(result.offset_sigma_mm, result.zero_gap_mm)
        # Circles err by themselves; each moves its rim by the ball's slope there.
        contact = [(p.radius_px, p.radius_sigma_px) for p in result.presses]
        radius_mm, sigma_mm = GRID.mm_per_px_x * np.array(contact).T
        rims = sigma_mm * radius_mm / np.sqrt(captures.ball_radius_mm**2 - radius_mm**2)
        assert result.offset_sigma_mm == pytest.approx(np.sqrt(np.mean(rims**2) / 3))
        assert result.absolute_mm >= result.zero_sigma_mm == pytest.approx(zero_mm)
        assert result.response.zero_sigma_mm == result.zero_sigma_mm > result.offset_sigma_mm > 0
        assert result.absolute_mm >= result.left_out_mm.mean()
        figures = result.figures()
        assert figures["absolute_mm"] == result.absolute_mm and figures["zero"] == zero
        assert result.headline().startswith(f"absolute depths are off by {result.absolute_mm:.2f}")


def test_two_standard_deviations_hold_what_a_fit_did_not_see() -> None:
    rng = np.random.default_rng(0)
    errors = [np.abs(rng.normal(0.0, 0.05, 4000)) for _ in range(4)]
    assert curve.reading_sigma_mm(errors) == pytest.approx(0.05, rel=0.06)


def test_travel_of_a_press_settles_the_zero() -> None:
    """The rim lies 0.2 mm below the untouched face, whatever the grey at no drop says."""
    captures = captures_of(CIRCLES)
    *others, third = captures.presses
    third = replace(third, depth_mm=DEEPEST_MM + 0.2)
    rim = fit_depth(captures, RIM, scale_share=0.03)
    known = fit_depth(replace(captures, presses=(*others, third)))
    # A cap is deeper by the square of the scale.
    assert rim.response.depth_share == pytest.approx(0.06) and known.response.depth_share == 0.0
    assert rim.zero == "rim" and known.zero == "travel"
    assert [press.rim_depth_mm for press in known.presses] == pytest.approx([0.2] * 3)
    deeper = known.response.depth_mm[1:] - rim.response.depth_mm[1:]
    assert deeper == pytest.approx(0.2, abs=1e-6)
    # No image leaves it open any more: what first touch may be off by is left.
    assert known.zero_sigma_mm == pytest.approx(0.05) and "zero_unsure" not in codes(known)
