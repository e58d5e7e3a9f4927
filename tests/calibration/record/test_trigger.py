# SPDX-License-Identifier: Apache-2.0
"""A picture is taken once a contact stands still, never before; what to press next follows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.calibration.capture import ContactCircle
from taccel_lab.calibration.capture.camera import Replay, open_camera
from taccel_lab.calibration.capture.coverage import CELLS, cell_of
from taccel_lab.calibration.record.advice import SHARES, contact_radius_mm, next_press
from taccel_lab.calibration.record.trigger import HOLD_S, Phase, Rest, Seen, Trigger
from tests.calibration.drawn.faults import quantise
from tests.calibration.record.sessions import source
from tests.support.capture_sets import gel, press
from tests.support.real_data import real_data

FPS = 20.0


def watched(path: Path, how: Replay) -> tuple[list[tuple[float, Seen]], Trigger]:
    camera, trigger = open_camera(str(path), None, how), Trigger()
    seen = []
    while (shot := camera.read()) is not None:
        seen.append((shot.time_s, trigger.see(shot.image, shot.time_s)))
    return seen, trigger


@pytest.mark.parametrize("noise", [0.0, 4.0])
def test_every_press_is_taken_once_when_it_stands_still(tmp_path: Path, noise: float) -> None:
    how = Replay(noise_levels=noise, hold_s=0.9)
    seen, _ = watched(source(tmp_path / "set", 2), how)
    takes = [time for time, frame in seen if frame.take]
    assert len(takes) == 2
    # Each comes after rest and way in, and after it stood still for as long as it has to.
    period = how.hold_s + 0.5 * how.rest_s + 2 * (how.blend_s - 1 / how.fps)
    for k, time in enumerate(takes):
        arrived = how.rest_s + k * period + how.blend_s - 2 / how.fps
        assert arrived + HOLD_S < time < arrived + how.hold_s + 0.05


def test_limits_follow_the_cameras_own_noise() -> None:
    rng = np.random.default_rng(3)

    def rest_at(noise: float) -> Rest:
        trigger, k = Trigger(), 0
        while trigger.rest is None and k < 200:
            trigger.see(quantise(gel() + rng.normal(0, noise, gel().shape)), k / FPS)
            k += 1
        assert trigger.rest is not None
        return trigger.rest

    assert rest_at(4.0).change_levels > 3 * rest_at(0.5).change_levels


def test_a_moving_contact_is_not_taken() -> None:
    rng, trigger = np.random.default_rng(0), Trigger()

    def see(image: np.ndarray, k: int) -> Seen:
        noisy = image + rng.normal(0, 1.0, image.shape)
        return trigger.see(quantise(noisy), k / FPS)

    for k in range(50):
        see(gel(), k)
    phases = [
        see(press(ContactCircle(40.0 + 1.5 * k, 60.0, 15.0)), 50 + k).phase for k in range(40)
    ]
    assert Phase.TAKEN not in phases and Phase.APPROACHING in phases[3:]


def test_what_moves_at_the_start_is_not_taken_for_rest() -> None:
    trigger = Trigger()
    rng = np.random.default_rng(1)
    for k in range(40):  # Two seconds of a ball that is pulled away.
        image = press(ContactCircle(80.0, 60.0, 18.0 - 0.3 * k))
        trigger.see(quantise(image + rng.normal(0, 1.0, image.shape)), k / FPS)
    assert trigger.rest is None
    for k in range(40, 120):
        trigger.see(quantise(gel() + rng.normal(0, 1.0, gel().shape)), k / FPS)
    assert trigger.rest is not None
    assert np.abs(trigger.rest.image.mean() - gel().mean()) < 1.0


def test_a_mark_that_stays_renews_the_untouched_picture() -> None:
    rng, trigger = np.random.default_rng(2), Trigger()
    contact = press(ContactCircle(80.0, 60.0, 16.0))
    marked = gel() + 0.1 * (contact - gel())
    frames = [gel()] * 40 + [contact] * 20 + [marked] * 60 + [contact] * 20
    seen = [
        trigger.see(quantise(f + rng.normal(0, 0.5, f.shape)), k / FPS)
        for k, f in enumerate(frames)
    ]
    assert sum(frame.renewed for frame in seen) == 1
    assert sum(frame.take for frame in seen) == 2


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "count"), [("gelsight_rvsathu_sim2real", 22), ("gsmini_ruihangao_calib", 49)]
)
def test_real_presses_are_taken(tmp_path: Path, name: str, count: int) -> None:
    from taccel_lab.calibration.capture import import_captures

    (folder,) = import_captures(real_data(name), tmp_path / "set")
    seen, _ = watched(folder, Replay(noise_levels=1.0))
    assert sum(frame.take for _, frame in seen) == count


def test_a_finger_that_never_rests_is_not_taken() -> None:
    """A real video: a finger presses, shears and leaves, without ever standing still."""
    seen, trigger = watched(real_data("gsmini_markers_video"), Replay(fps=25.0))
    assert trigger.rest is not None
    assert not any(frame.take for _, frame in seen)
    assert any(frame.phase == Phase.APPROACHING for _, frame in seen)


SIZE = (320, 240)


@given(st.integers(0, 47))
def test_whoever_follows_it_covers_all_cells_at_all_depths(count: int) -> None:
    circles = []
    for _ in range(count):
        advice = next_press(circles, SIZE, 40.0)
        u, v = ((advice.cell[k] + 0.5) * SIZE[k] / CELLS[k] for k in (0, 1))
        assert advice.radius_px is not None
        circles.append(ContactCircle(u, v, advice.radius_px))
    cells = [cell_of(circle, *SIZE) for circle in circles]
    each = [cells.count(cell) for cell in {(c, r) for c in range(4) for r in range(3)}]
    assert max(each) - min(each) <= 1
    if count >= 36:
        here = {circle.radius_px for circle in circles if cell_of(circle, *SIZE) == (0, 0)}
        assert here == {share * 40.0 for share in SHARES}


def test_without_a_scale_the_depth_is_told_by_the_contacts_so_far() -> None:
    assert next_press([], SIZE, None).radius_px is None
    assert "px wide" in str(next_press([ContactCircle(30, 30, 20)], SIZE, None))


def test_a_balls_contact_is_never_wider_than_the_ball() -> None:
    assert contact_radius_mm(2.0, 5.0) == 2.0 and contact_radius_mm(2.0, 0.5) < 2.0
