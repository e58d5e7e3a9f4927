# SPDX-License-Identifier: Apache-2.0
"""Draws of episodes: within their ranges, even, and only where an episode begins."""

from __future__ import annotations

import numpy as np
import torch
from gymnasium.vector import AutoresetMode

from taccel_lab.learning.catalogue import make_vec
from taccel_lab.learning.starts import EpisodeDraws
from tests.learning.tasks import peg_parameters


def test_numbers_are_even_and_differ_by_seed_episode_and_place() -> None:
    env = make_vec("peg-insertion", 64, observe=("proprioception",), device="cpu")
    draws = EpisodeDraws(env.model, 3)
    everyone = torch.ones(64, dtype=torch.bool)
    draws.seed(100, everyone)
    found = torch.stack([draws.begin(everyone) for _ in range(50)])
    assert found.min() >= 0 and found.max() < 1
    np.testing.assert_allclose(found.mean(dim=(0, 1)), 0.5, atol=0.02)
    np.testing.assert_allclose(found.std(dim=(0, 1)), 1 / np.sqrt(12), atol=0.01)
    assert len(torch.unique(found)) > 0.99 * found.numel()
    for moved in (found.roll(1, 0), found.roll(1, 1), found.roll(1, 2)):
        together = torch.stack([found.flatten(), moved.flatten()])
        assert abs(torch.corrcoef(together)[0, 1]) < 0.05
    draws.seed(100, everyone)
    half = torch.arange(64) < 32
    assert torch.equal(draws.begin(half), found[0])
    second = draws.begin(everyone)
    assert torch.equal(second[half], found[1][half])
    assert torch.equal(second[~half], found[0][~half])


def test_episodes_draw_the_parameters_that_the_file_names() -> None:
    env = make_vec(
        "peg-insertion", 16, randomised=True, autoreset_mode=AutoresetMode.DISABLED, device="cpu"
    )
    env.reset(seed=0)
    model = env.model
    ids = {name: model.body_id(name) for name in ("left", "right", "peg", "hole")}
    control = model.affine.first_control

    def values() -> dict[str, np.ndarray]:
        friction = model.pair_friction.numpy()
        return {
            "left": model.largest_moduli.numpy()[:, ids["left"]],
            "right": model.largest_moduli.numpy()[:, ids["right"]],
            "left, peg": friction[:, ids["left"], ids["peg"]],
            "right, peg": friction[:, ids["right"], ids["peg"]],
            "peg, hole": friction[:, ids["peg"], ids["hole"]],
            "peg": model.masses.numpy()[:, control],
        }

    first = {name: value.copy() for name, value in values().items()}
    for item in peg_parameters().learning.randomise:
        for names in item.of:
            value = first[", ".join(names)]
            assert item.low <= value.min() and value.max() <= item.high
            assert np.ptp(value) > 0.5 * (item.high - item.low)
            np.testing.assert_array_equal(value, first[", ".join(item.of[0])])
    mask = np.arange(16) < 3
    env.reset(options={"reset_mask": mask})
    for name, value in values().items():
        assert (value[mask] != first[name][mask]).all()
        np.testing.assert_array_equal(value[~mask], first[name][~mask])
    plain = make_vec("peg-insertion", 16, device="cpu")
    plain.reset(seed=0)
    assert plain.model.pair_friction.shape[0] == 1, "without the wish nothing is drawn"
