# SPDX-License-Identifier: Apache-2.0
"""Scales of pressed edges, places of a stage and other kinds: those that agree are averaged."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.calibration.capture import CapturedPress, ContactCircle, EdgeCapture, Frame
from taccel_lab.calibration.capture.load import load_capture_folder
from taccel_lab.calibration.capture.schema import EdgeEntry, LineEntry
from taccel_lab.calibration.result import Estimate
from taccel_lab.calibration.scale import ball_contacts
from taccel_lab.calibration.scale.ball_contacts import scale_from_spheres
from taccel_lab.calibration.scale.edge_line import find_edge
from taccel_lab.calibration.scale.edges import measure_edges, scale_from_edges
from taccel_lab.calibration.scale.fit import calibrate_scale
from taccel_lab.calibration.scale.result import ScaleCalibration, combine_axis
from taccel_lab.errors import InputError
from taccel_lab.report.remark import judge
from tests.calibration.drawn.faults import add_dust, add_noise, blur, poison, quantise
from tests.support.capture_sets import CaptureMaker, spread_circles, write_image
from tests.support.synthetic_presses import GRID, tiny_profile

BACKGROUND = np.full((240, 320, 3), (90.0, 120.0, 130.0))
NOISE = quantise(add_noise(BACKGROUND, 2.0, np.random.default_rng(0)))
V, U = np.mgrid[:240, :320].astype(float)


def drawn_edge(ends: np.ndarray, *, decay_px: float = 1.5, seed: int = 0) -> np.ndarray:
    """Two faces that meet in a sharp crest; beyond the ends the gel comes off it."""
    length = np.linalg.norm(ends[1] - ends[0])
    along = (ends[1] - ends[0]) / length
    t = (U - ends[0][0]) * along[0] + (V - ends[0][1]) * along[1]
    d = (V - ends[0][1]) * along[0] - (U - ends[0][0]) * along[1]
    height = np.exp(-np.maximum(np.maximum(-t, t - length), 0.0) / decay_px)
    side = np.clip(d, -0.5, 0.5) * 2
    width = np.exp(-np.maximum(np.abs(d) - 12.0, 0.0) / 4.0)
    face = np.where(side[..., None] > 0, (55.0, -30.0, -40.0), (-45.0, 10.0, 60.0))
    image = BACKGROUND + face * (np.abs(side) * width * height)[..., None]
    rng = np.random.default_rng(seed)
    return quantise(add_noise(add_dust(blur(image, 0.7), 8, rng), 1.5, rng))


def ends_of(middle: tuple[float, float], angle_deg: float, length: float) -> np.ndarray:
    direction = np.array([np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))])
    return np.array(middle) + np.array([[-0.5], [0.5]]) * length * direction


@pytest.mark.thorough
@settings(max_examples=15, deadline=None)
@given(
    u=st.floats(120, 200), v=st.floats(95, 145), angle=st.floats(-90, 90),
    length=st.floats(60, 130), seed=st.integers(0, 99),
)  # fmt: skip
def test_ends_are_found_within_their_uncertainty(
    u: float, v: float, angle: float, length: float, seed: int
) -> None:
    found = find_edge(drawn_edge(ends_of((u, v), angle, length), seed=seed), BACKGROUND)
    sigma = np.hypot(found.length_sigma_px, found.systematic_px)
    assert abs(found.length_px - length) < max(4 * sigma, 2.0)
    assert np.linalg.norm(found.ends_px.mean(axis=0) - (u, v)) < 1.5
    assert abs((found.angle_deg - angle + 90) % 180 - 90) < 1.0


def test_masked_pixels_have_no_effect() -> None:
    mask = np.ones((240, 320), dtype=bool)
    mask[180:, :] = False
    image = drawn_edge(np.array([[90.0, 100.0], [220.0, 130.0]]))
    poisoned = quantise(poison(image, mask, np.random.default_rng(0)))
    clean, dirty = (find_edge(i, BACKGROUND, mask=mask).ends_px for i in (image, poisoned))
    np.testing.assert_allclose(dirty, clean, atol=0.3)


@pytest.mark.parametrize(("image", "reason"), [
    (NOISE, "no edge"),
    (BACKGROUND.astype(np.uint8), "nothing changes sharply"),
    (drawn_edge(np.array([[40.0, 120.0], [340.0, 125.0]])), "runs out|no end"),
    (np.zeros((100, 320, 3), np.uint8), "of one size"),
], ids=["noise", "nothing", "out", "size"])  # fmt: skip
def test_pictures_without_a_whole_edge_are_refused(image: np.ndarray, reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        find_edge(image, BACKGROUND)


def captured(images: list[np.ndarray], line: LineEntry | None = None) -> list[EdgeCapture]:
    return [
        EdgeCapture(
            EdgeEntry(image=f"e{k}.png", length_mm=10.0, line=line),
            Frame(f"e{k}", f"e{k}.png", f"{k:064d}", lambda image=image: image),
        )
        for k, image in enumerate(images)
    ]


def edges_at(
    scale: tuple[float, float], angles: list[float], share: float = 1.0
) -> list[np.ndarray]:
    """Edges of 10 mm, of which the first has touched with a share."""
    images = []
    for k, angle in enumerate(angles):
        one = np.diff(ends_of((0, 0), angle, 1.0), axis=0)[0]
        length = 10.0 / float(np.linalg.norm(one * scale)) * (1.0 if k else share)
        ends = ends_of((160.0 + 3 * k, 118.0 + 2 * k), angle, length)
        images.append(drawn_edge(ends, decay_px=0.5, seed=k))
    return images


def test_scale_in_x_and_y_and_an_edge_that_touched_in_part() -> None:
    truth = (0.085, 0.080)
    images = edges_at(truth, [5, -10, 20, 80, 95, 60, -45], share=0.8)
    found = scale_from_edges(*measure_edges(captured(images), BACKGROUND, None))
    for axis, wanted in zip((found.x, found.y), truth, strict=True):
        assert axis is not None and abs(axis.value - wanted) < 3 * axis.sigma
    assert found.x is not None and found.x.sigma < 0.015 * truth[0]
    assert [edge["used"] for edge in found.evidence["edges"]] == [False] + [True] * 6


def test_edges_along_one_axis_only_say_so() -> None:
    images = edges_at((0.085, 0.085), [2, -5, 8, 0, 4])
    found = scale_from_edges(*measure_edges(captured(images), BACKGROUND, None))
    assert found.x is not None and found.y is not None and found.y.sigma > 2 * found.x.sigma
    assert any(remark.code == "too_few" for remark in found.remarks)


def test_a_drawn_line_stands_in_for_an_edge_that_is_not_found() -> None:
    line = LineEntry(u_px=160, v_px=120, length_px=125.0, angle_deg=0.0)
    measured, refused = measure_edges(captured([NOISE], line), BACKGROUND, None)
    assert not refused and measured[0].line.length_px == pytest.approx(125.0)
    measured, refused = measure_edges(captured([NOISE]), BACKGROUND, None)
    assert not measured and "no edge" in refused[0]
    with pytest.raises(InputError, match="no pressed edge"):
        scale_from_edges(measured, refused)


def test_estimates_that_disagree_are_widened_by_birges_ratio() -> None:
    """Three of 0.1 each, 0.3, 0.1 and 0.4 from their mean: chi-square is 26 of 2 degrees."""
    three = [(str(k), Estimate(value, 0.1)) for k, value in enumerate((1.0, 1.2, 1.7))]
    found = combine_axis(three)
    assert found.chi_square == pytest.approx(26.0) and found.freedom == 2
    assert found.estimate.value == pytest.approx(1.3)
    assert found.estimate.sigma == pytest.approx(0.1 / np.sqrt(3) * np.sqrt(13))
    low, high = found.estimate.interval95
    assert (high - low) / 2 == pytest.approx(1.96 * found.estimate.sigma, rel=1e-4)
    agreeing = combine_axis([("a", Estimate(1.0, 0.3)), ("b", Estimate(1.0, 0.4))])
    assert agreeing.estimate.sigma == pytest.approx(0.24)
    alone = combine_axis([("a", Estimate(1.0, 0.3, interval=(0.9, 1.8)))])
    assert alone.estimate.interval95 == (0.9, 1.8)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(st.floats(0.04, 0.06), st.floats(1e-4, 1e-3)), min_size=2, max_size=5))
def test_the_mean_lies_among_the_estimates(pairs: list[tuple[float, float]]) -> None:
    found = combine_axis([(str(k), Estimate(*pair)) for k, pair in enumerate(pairs)])
    values, sigmas = zip(*pairs, strict=True)
    assert min(values) - 1e-12 <= found.estimate.value <= max(values) + 1e-12
    assert len(found.pairs) == len(values) * (len(values) - 1) // 2
    if found.agrees and found.chi_square < found.freedom:
        assert found.estimate.sigma <= min(sigmas) + 1e-15


def test_false_alarms_are_rare_and_real_ones_are_not() -> None:
    rng = np.random.default_rng(0)
    agree = [
        combine_axis([(str(k), Estimate(rng.normal(0.05, 5e-4), 5e-4)) for k in range(3)]).agrees
        for _ in range(400)
    ]
    assert np.mean(agree) > 0.97
    apart = combine_axis([("a", Estimate(0.050, 5e-4)), ("b", Estimate(0.055, 5e-4))])
    assert not apart.agrees and abs(apart.pairs["a*b"]) == pytest.approx(7.07, abs=0.01)
    assert apart.estimate.sigma > 2e-3


@pytest.mark.parametrize("largest_px", [61, 140])
def test_balls_give_a_limit_only(largest_px: float) -> None:
    """A single circle that is far too large is a mistake of detection."""
    contacts = []
    for radius_px in (30, 45, 55, 60, largest_px):
        circle = ContactCircle(100.0, 100.0, radius_px)
        press = CapturedPress(f"p{radius_px}", "p.png", "0" * 64, lambda: BACKGROUND, circle)
        contacts.append(ball_contacts.BallContact(press, 2.0, circle))
    found = scale_from_spheres(contacts, [])
    assert found.x is None and found.y is None
    assert found.upper_x == pytest.approx(2.0 / (60 - 1.645), rel=1e-9)
    with pytest.raises(InputError, match="no contact"):
        scale_from_spheres([], ["p.png: nothing there"])


def test_contacts_are_found_on_pixels_that_are_higher_than_wide(tmp_path: Path) -> None:
    folder = CaptureMaker(spread_circles(2), labelled=False).load(tmp_path)
    for ratio in (0.98, 1.02):
        contacts, refused = ball_contacts.measure_contacts(folder, ratio)
        assert len(contacts) == 2 and not refused


HEAD = 'schema_version = 2\nsensor = "gelsight"\nbackground = "background.png"\n'


def ball_press(ball_mm: float, radius_px: float) -> str:
    return (
        f'[indenter]\nradius_mm = {ball_mm}\n[[presses]]\nimage = "press.png"\n'
        f"contact = {{u_px = 160.0, v_px = 120.0, radius_px = {radius_px}}}\n"
    )


def calibrated(folder: Path, manifest: str = "", rectified: bool = False) -> ScaleCalibration:
    """The scale of a folder, or of one with this manifest and pictures that show nothing."""
    if not (folder / "captures.toml").exists() or manifest:
        for name in ("background.png", "press.png"):
            write_image(folder / name, quantise(BACKGROUND))
        (folder / "captures.toml").write_text(HEAD + manifest, encoding="utf-8")
    captures = replace(load_capture_folder(folder), rectified=rectified)
    return calibrate_scale(captures, tiny_profile(GRID))


TRUTH = (0.085, 0.082)


def write_folder(
    folder: Path, scale: tuple[float, float] = TRUTH, pitch_mm: float = 2.0, more: str = ""
) -> Path:
    """Edges of 10 mm, a press, and markers of 2 mm pitch, which may be stated wrongly."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(0)
    write_image(folder / "background.png", quantise(add_noise(BACKGROUND, 1.0, rng)))
    write_image(folder / "press.png", quantise(BACKGROUND))
    manifest = HEAD
    for k, image in enumerate(edges_at(scale, [5, -12, 85, 70])):
        write_image(folder / f"edge_{k}.png", image)
        manifest += f'[[edges]]\nimage = "edge_{k}.png"\nlength_mm = 10.0\n'
    dots = BACKGROUND.copy()
    for u in 160.3 + np.arange(-5, 6) * 2.0 / scale[0]:
        for v in 119.6 + np.arange(-4, 5) * 2.0 / scale[1]:
            if 8 < u < 312 and 8 < v < 232:
                dots -= 80 * np.exp(-((((U - u) ** 2 + (V - v) ** 2) / 3.5**2) ** 3))[..., None]
    write_image(folder / "markers.png", quantise(add_noise(dots, 1.0, rng)))
    pitch = f"pitch_x_mm = {pitch_mm}\npitch_y_mm = {pitch_mm}\n"
    manifest += f'[markers]\nrest = "markers.png"\n{pitch}'
    (folder / "captures.toml").write_text(manifest + more, encoding="utf-8")
    return folder


@pytest.mark.thorough
def test_kinds_of_captures_agree(tmp_path: Path) -> None:
    result = calibrated(write_folder(tmp_path, more=ball_press(8.0, 50.0)))
    assert {e.method for e in result.estimates} == {"edge", "markers", "spheres"}
    for axis, wanted in zip("xy", TRUTH, strict=True):
        found = result.axes[axis]
        assert found.agrees and found.freedom == 1
        assert abs(found.estimate.value - wanted) < 3 * found.estimate.sigma
        assert found.estimate.sigma < 0.01 * wanted
    assert not any(remark.code == "scale_disagrees" for remark in result.remarks)
    # That of rectified images is one of rectified images.
    measured = calibrated(write_folder(tmp_path), rectified=True)
    assert measured.apply_to(tiny_profile(GRID)).camera.rectified


@pytest.mark.thorough
def test_a_wrong_pitch_and_a_wrong_ball_are_said_to_be_so(tmp_path: Path) -> None:
    """Markers stated 12 % too far apart; a ball whose contacts are larger than itself."""
    result = calibrated(write_folder(tmp_path, pitch_mm=2.24, more=ball_press(2.0, 50.0)))
    codes = [remark.code for remark in result.remarks]
    assert codes.count("scale_disagrees") == 2 and "contacts_exceed_ball" in codes
    worst = max(result.axes["x"].pairs.items(), key=lambda item: abs(item[1]))
    assert "markers" in worst[0] and abs(worst[1]) > 4
    assert judge(result.remarks) == "weak"


def test_folders_without_known_lengths_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nothing of known length"):
        calibrated(tmp_path)
    result = calibrated(tmp_path, ball_press(4.0, 40.0))
    with pytest.raises(InputError, match=r"only limit it to 0\.10"):
        _ = result.scale


@pytest.mark.parametrize(("ball_mm", "contradicts"), [(4.0, False), (1.0, True)])
def test_a_stated_scale_is_taken_with_a_warning_and_checked_by_the_ball(
    tmp_path: Path, ball_mm: float, contradicts: bool
) -> None:
    stated = "mm_per_px_x = 0.05\nmm_per_px_y = 0.051\n"
    result = calibrated(tmp_path, stated + ball_press(ball_mm, 40.0))
    assert result.scale == (0.05, 0.051)
    codes = [remark.code for remark in result.remarks]
    assert "scale_not_measured" in codes and ("contacts_exceed_ball" in codes) is contradicts


STAGE_SCALE = np.array([0.0634, 0.0621])


def stage_contacts(
    angle_deg: float = 0.0, mirrored: bool = False, noise_px: float = 0.0, step: int = 0, seed=0
) -> list[ball_contacts.BallContact]:
    """Three presses at each of 12 places; the table lags behind by ``step`` presses."""
    rng = np.random.default_rng(seed)
    places = [(x, y) for y in (-4, 0, 4) for x in (-6, -2, 2, 6) for _ in range(3)]
    c, s = np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))
    turn = np.array([[c, -s], [s, c]]) @ np.diag([1.0, -1.0 if mirrored else 1.0])
    found = []
    for place, stated in zip(places, places[step:], strict=False):
        u, v = np.array([160, 120]) + turn.T @ place / STAGE_SCALE + noise_px * rng.normal(size=2)
        circle = ContactCircle(float(u), float(v), 16.0)
        press = CapturedPress("p", "p", "", lambda: np.zeros(0), circle, stage_mm=stated)
        found.append(ball_contacts.BallContact(press, 2.0, circle))
    return found


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("angle_deg", [0.0, 37.0, 90.0, 180.0])
def test_exact_places_give_the_exact_scale(angle_deg: float, mirrored: bool) -> None:
    found = ball_contacts.scale_from_stage(stage_contacts(angle_deg, mirrored))
    assert found.x is not None and found.y is not None
    assert (found.x.value, found.y.value) == pytest.approx(STAGE_SCALE, rel=1e-9)


def test_the_interval_holds_the_scale() -> None:
    inside, draws = 0, 60
    for seed in range(draws):
        found = ball_contacts.scale_from_stage(stage_contacts(20.0, noise_px=2.0, seed=seed))
        assert found.x is not None and found.x.sigma < 0.01 * STAGE_SCALE[0]
        low, high = found.x.interval95
        inside += low < STAGE_SCALE[0] < high
    assert 0.85 * draws < inside


def test_one_wrong_contact_changes_little_many_are_refused() -> None:
    found = stage_contacts(noise_px=0.5)
    found[7] = ball_contacts.BallContact(found[7].press, 2.0, ContactCircle(300.0, 10.0, 16.0))
    estimate = ball_contacts.scale_from_stage(found)
    assert estimate.x is not None and estimate.x.value == pytest.approx(STAGE_SCALE[0], rel=0.01)
    with pytest.raises(InputError, match="is each press beside the place"):
        ball_contacts.scale_from_stage(stage_contacts(noise_px=0.5, step=1))
    with pytest.raises(InputError, match="all on one line; at least 4"):
        ball_contacts.scale_from_stage(stage_contacts()[:12])
