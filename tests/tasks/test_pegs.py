# SPDX-License-Identifier: Apache-2.0
"""Pegs, their holes and starts; a policy that feels on which side its peg stands."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.bodies.mass_properties import mass_properties
from taccel_lab.bodies.mesh_checks import check_surface
from taccel_lab.errors import InputError
from taccel_lab.tasks.catalogue import run_task
from taccel_lab.tasks.parameters import PlanarStart
from taccel_lab.tasks.pegs import ROUND_SIDES, Hole, Peg
from taccel_lab.tasks.touch_insertion import TouchInsertion
from tests.tasks.changed import first_trial, parameters, task_with

DISC = ROUND_SIDES / 2 * np.sin(2 * np.pi / ROUND_SIDES)
PEGS = {
    "octagon": ((30.0,), 8 * np.tan(np.pi / 8) * 15**2),
    "round": ((8.0,), DISC * 4**2),
    "rectangle": ((20.0, 30.0), 600.0),
    "trapezoid": ((20.0, 24.0, 34.0), 580.0),
    "waisted": ((20.0, 30.0, 8.0, 22.0), 8 * 22.0 + 12 * 26.0),
}
"""Sizes, and area [mm^2]."""
HOLE = Hole(clearance_mm=1.5, wall_mm=8.0, depth_mm=20.0, friction=0.1)


def peg(shape: str) -> Peg:
    values = {"shape": shape, "size_mm": PEGS[shape][0], "height_mm": 40.0}
    return Peg(**values, mass_kg=0.05, friction=0.2)  # type: ignore[arg-type]


def distance(points: np.ndarray, outline: np.ndarray) -> np.ndarray:
    """Of points [n, 2] from the sides of an outline [m, 2]."""
    a, b = outline, np.roll(outline, -1, axis=0)
    part = ((points[:, None] - a) * (b - a)).sum(-1) / ((b - a) ** 2).sum(-1)
    nearest = a + np.clip(part, 0, 1)[..., None] * (b - a)
    return np.linalg.norm(points[:, None] - nearest, axis=2).min(axis=1)


def area(outline: np.ndarray) -> float:
    x, y = outline.T
    return float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2)


@pytest.mark.parametrize("shape", PEGS)
def test_pegs_are_as_large_as_asked_and_holes_as_much_larger(shape: str) -> None:
    made = peg(shape)
    volume = 1e9 * mass_properties(made.mesh(), 1.0).volume_m3
    assert volume == pytest.approx(40 * PEGS[shape][1], rel=1e-9)
    outline, hole = made.section().outline, HOLE.outline(made)
    assert np.ptp(outline[:, 0]) == pytest.approx(2 * made.half_m, rel=2e-3)
    # Middles of the hole's sides are the clearance away from the peg, corners farther.
    middles = (hole + np.roll(hole, -1, axis=0)) / 2
    np.testing.assert_allclose(distance(middles, outline), 1.5e-3, rtol=5e-3)
    block = HOLE.mesh(made)
    assert np.ptp(block.vertices_m[:, 0]) == pytest.approx(2 * (made.half_m + 9.5e-3), rel=2e-3)
    # Its faces do not lie on each other: they enclose what lies between its outlines.
    check_surface(block.vertices_m, block.faces, "the block", closed=True)
    outer = block.vertices_m[len(hole) : 2 * len(hole), :2]
    walls = 20e-3 * (area(outer) - area(hole))
    assert mass_properties(block, 1.0).volume_m3 == pytest.approx(walls, rel=1e-9)


def test_starts_from_which_the_peg_would_go_in_are_drawn_again() -> None:
    concave = parameters("peg-vitac-concave")
    assert concave.on_rim
    free, _ = concave.start.draw(range(60))
    starts, _ = concave.start.draw(range(60), concave.drawn_again)
    changed = [a != b for a, b in zip(free, starts, strict=True)]
    assert sum(changed) >= 2
    for start in starts:
        x, y, yaw = start.values()
        assert abs(x) > 1.5 or abs(y) > 1.5 or abs(yaw) > 2
        assert not concave.drawn_again(1e-3 * x, 1e-3 * y, np.radians(yaw))
    assert concave.drawn_again(0.0, 0.0, 0.0)
    with pytest.raises(InputError, match=r"no start of .* counts"):
        PlanarStart(x_mm=0.5, y_mm=0.5, yaw_deg=0.5).draw([1], concave.drawn_again)


def test_published_pegs_are_as_published() -> None:
    for name, across, hole in (("tacex", 7.986, 8.1), ("tacsl", 15.983, 16.5)):
        found = parameters(f"peg-{name}")
        assert found.peg.size_mm == (across,)
        assert across + 2 * found.hole.clearance_mm == pytest.approx(hole)


def test_sizes_that_make_no_peg_are_refused() -> None:
    for shape, size, message in (
        ("rectangle", (20.0,), "a rectangle has 2 sizes, got 1"),
        ("waisted", (20.0, 30.0, 22.0, 6.0), "shorter and narrower"),
    ):
        with pytest.raises(ValueError, match=message):
            peg("round").replace(shape=shape, size_mm=size)


@pytest.mark.thorough
def test_the_peg_is_moved_away_from_the_side_on_which_it_stands() -> None:
    """Without noise, from seeds that begin off the hole by more than its clearance."""
    task = task_with("touch-insertion", markers={"noise_mm": 0.0})
    episode = task.begin(range(8), "cpu")
    assert isinstance(episode, TouchInsertion)
    starts = np.array([[start["x_mm"], start["y_mm"]] for start in episode.starts])
    for _ in range(25):
        episode.advance()
    hands = 1e3 * episode.hands_m[:, :2]
    steps = hands - starts
    off = np.abs(starts).max(axis=1) > 1.5
    assert off.sum() >= 4
    assert (np.abs(steps[off]).max(axis=1) > 0.9).all()
    # Every step there is leads towards the hole.
    assert (steps * starts <= 1e-9).all()


@pytest.mark.thorough
def test_a_peg_over_its_hole_goes_in_at_once_and_is_pushed_by_little() -> None:
    task = task_with("touch-insertion", start={"x_mm": 0.5, "y_mm": 0.5})
    for trial in run_task(task, [0, 1], "cpu").trials:
        assert trial.success and trial.figures["tries"] == 1
        assert trial.figures["jam_force_n"] < 0.1
        # It goes down as far as the hand, which is 0.6 mm over the rim at first.
        assert abs(trial.figures["depth_mm"] - (9.6 - 0.6)) < 0.2


def test_tries_are_used_up() -> None:
    policy = {"side_part": (1e3, 1e3), "tries": 2}
    trial = first_trial(task_with("touch-insertion", policy=policy), 1)
    assert not trial.success and trial.figures["tries"] == 2
    assert trial.figures["depth_mm"] < 0.1 and trial.steps < 60


@pytest.mark.thorough
def test_where_no_side_is_felt_the_hand_turns() -> None:
    """A policy that tells no side goes through its turns, and then stays turned."""
    policy = {"side_part": (1e3, 1e3), "turns_deg": (3.0, -5.0), "tries": 4}
    episode = task_with("touch-insertion", policy=policy).begin([1], "cpu")
    assert isinstance(episode, TouchInsertion)
    seen = []
    while not episode.over:
        episode.advance()
        seen.append(round(float(episode.turns_deg[0]), 6))
    assert list(dict.fromkeys(seen)) == [0.0, 3.0, -2.0]
    assert episode.trials()[0].figures["tries"] == 4
