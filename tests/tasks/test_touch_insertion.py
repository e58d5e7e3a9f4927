# SPDX-License-Identifier: Apache-2.0
"""A policy that feels on which side its peg stands, with markers and nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from taccel_lab.tasks.catalogue import named
from taccel_lab.tasks.run import run_task
from taccel_lab.tasks.touch_insertion import TouchInsertion, TouchInsertionParameters


def test_the_peg_is_moved_away_from_the_side_on_which_it_stands() -> None:
    """Without noise, from seeds that begin off the hole by more than its clearance."""
    task = named("touch-insertion")
    assert isinstance(task.parameters, TouchInsertionParameters)
    markers = task.parameters.markers.replace(noise_mm=0.0)
    task = replace(task, parameters=task.parameters.replace(markers=markers))
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


def test_a_peg_over_its_hole_goes_in_at_once_and_is_pushed_by_little() -> None:
    task = named("touch-insertion")
    assert isinstance(task.parameters, TouchInsertionParameters)
    start = task.parameters.start.replace(x_mm=0.5, y_mm=0.5)
    task = replace(task, parameters=task.parameters.replace(start=start))
    for trial in run_task(task, [0, 1], "cpu").trials:
        assert trial.success and trial.figures["tries"] == 1
        assert trial.figures["jam_force_n"] < 0.1
        # It goes down as far as the hand, which is 0.6 mm over the rim at first.
        assert abs(trial.figures["depth_mm"] - (9.6 - 0.6)) < 0.2


def test_tries_are_used_up() -> None:
    """A policy that never steps aside stays on the rim."""
    task = named("touch-insertion")
    assert isinstance(task.parameters, TouchInsertionParameters)
    policy = task.parameters.policy.replace(side_part=(1e3, 1e3), tries=2)
    task = replace(task, parameters=task.parameters.replace(policy=policy))
    (trial,) = run_task(task, [1], "cpu").trials
    assert not trial.success and trial.figures["tries"] == 2
    assert trial.figures["depth_mm"] < 0.1 and trial.steps < 60


def test_where_no_side_is_felt_the_hand_turns() -> None:
    """A policy that tells no side goes through its turns, and then stays turned."""
    task = named("touch-insertion")
    assert isinstance(task.parameters, TouchInsertionParameters)
    policy = task.parameters.policy.replace(side_part=(1e3, 1e3), turns_deg=(3.0, -5.0), tries=4)
    task = replace(task, parameters=task.parameters.replace(policy=policy))
    episode = task.begin([1], "cpu")
    assert isinstance(episode, TouchInsertion)
    seen = []
    while not episode.over:
        episode.advance()
        seen.append(round(float(episode.turns_deg[0]), 6))
    assert list(dict.fromkeys(seen)) == [0.0, 3.0, -2.0]
    assert episode.trials()[0].figures["tries"] == 4
