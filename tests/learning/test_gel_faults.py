# SPDX-License-Identifier: Apache-2.0
"""Environments whose cameras have faulty frames: told, repeated by seed, and nothing else."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

from taccel_lab.errors import InputError
from taccel_lab.learning.catalogue import make_vec
from taccel_lab.learning.vector_env import TactileVectorEnv
from taccel_lab.signals.frame_faults import FrameFaults
from taccel_lab.signals.frame_operators import BITS
from tests.learning.envs import short_task

SEEN = {"observe": ("rgb", "proprioception"), "size_px": (40, 30), "device": "cpu"}
LOST = {"lost_rows": 0.5, "stuck": 0.3}
ACTION = [0.2, -0.1, -1.0, 0.3]


def make(count: int = 2, **options: Any) -> TactileVectorEnv:
    return make_vec(short_task(), count, **{**SEEN, **options})


def played(env: TactileVectorEnv, seed: int, steps: int = 6) -> tuple[np.ndarray, np.ndarray]:
    """Frames [frame, env, gel, h, w, 3] and bits of their faults."""
    seen, info = env.reset(seed=seed)
    frames, bits = [seen["rgb"]], [info.get("frame_faults")]
    for _ in range(steps):
        seen, *_, info = env.step(torch.tensor([ACTION] * env.num_envs))
        frames.append(seen["rgb"])
        bits.append(info.get("frame_faults"))
    if bits[0] is None:
        return torch.stack(frames).numpy(), np.zeros(0)
    return torch.stack(frames).numpy(), torch.stack(bits).numpy()  # type: ignore[arg-type]


def test_frames_are_as_their_labels_say_and_repeat_by_seed() -> None:
    env = make(faults=LOST)
    whole = played(make(), 3)[0]
    assert (played(make(faults={"wear": 1e-9}), 3)[0] == whole).all()
    frames, bits = played(env, 3)
    assert set(np.unique(bits)) == {0, BITS["lost_rows"], BITS["stuck"], sum(BITS[k] for k in LOST)}
    assert frames.dtype == np.uint8 and (frames[bits == 0] == whole[bits == 0]).all()
    for at in np.argwhere(bits == BITS["lost_rows"]).tolist():
        image, clean = frames[tuple(at)], whole[tuple(at)]
        lost = (image == image[-1, -1]).all(axis=(1, 2))
        assert image[-1, -1].tolist() in ([128] * 3, [0, 135, 0]) and lost[-1] and not lost[0]
        assert (image[~lost] == clean[~lost]).all()
    for k, row, gel in np.argwhere(bits & BITS["stuck"] > 0).tolist():
        assert k and (frames[k, row, gel] == frames[k - 1, row, gel]).all()
    again, told = played(env, 3)
    assert (told == bits).all() and (again == frames).all()
    other = played(env, 4)[1]
    # Environment 1 of seed 3 is environment 0 of seed 4, until an episode ends.
    assert (other[:4, 0] == bits[:4, 1]).all() and not (other == bits).all()
    assert (played(make(1, faults=LOST), 4)[1][:4, 0] == bits[:4, 1]).all()


LIGHT = {"dead_lamp": 1.0, "lamp_left": [0.0, 0.0], "delay": 1.0, "delay_frames": [2, 2]}


@pytest.mark.thorough
@pytest.mark.parametrize("mode", ["NEXT_STEP", "SAME_STEP"])
def test_new_episodes_have_faults_and_frames_of_their_own(mode: str) -> None:
    """Through the end of an episode that another one outlives: an action that is not a number."""
    env = make(faults=LIGHT, autoreset_mode=mode, observe=("rgb", "rgb_levels"))
    seen, info = env.reset(seed=1)
    assert (seen["rgb"].amax(dim=(2, 3)).amin(dim=-1) == 0).all()
    assert info["frame_faults"].unique().tolist() == [BITS["dead_lamp"]]
    first = seen["rgb"][0].clone()
    steps = [[ACTION] * 2] * 2 + [[ACTION, [np.nan] * 4]] + [[ACTION] * 2] * 2
    for k, actions in enumerate(steps):
        before = seen
        seen, _, _, truncated, info = env.step(torch.tensor(actions))
        assert (seen["rgb"].int() - seen["rgb_levels"]).abs().max() <= 0.51
        late = info["frame_faults"] & BITS["delay"] > 0
        if k < 2:
            assert late.all() and torch.equal(seen["rgb"][0], first)
        begins = bool(truncated[1]) if mode == "SAME_STEP" else k == 3
        if begins:
            # Its first frame comes at once: it has no earlier one.
            assert late[0].all() and not late[1].any()
            if mode == "SAME_STEP":
                late_one = info["final_obs"]["rgb"]
                assert not torch.equal(late_one[1], seen["rgb"][1])
                assert torch.equal(late_one[0], seen["rgb"][0])
        elif k == 4:
            assert late[1].all() and torch.equal(seen["rgb"][1], before["rgb"][1])


def test_gymnasium_makes_an_environment_with_faults() -> None:
    faults = FrameFaults(lost_rows=1.0, lost_from=(0.5, 0.5), lost_green=1.0)
    env = gymnasium.make("taccel_lab/PegInsertion-v0", faults=faults, **SEEN)
    seen, info = env.reset(seed=0)
    assert (seen["rgb"][:, 15:] == [0, 135, 0]).all() and (info["frame_faults"] == 1).all()


def test_an_environment_without_faults_has_none_of_it() -> None:
    env = make(faults={"lost_rows": 0.0, "shift_width": (0.1, 0.2)})
    assert "frame_faults" not in env.reset(seed=0)[1] and not env._faults.names


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"faults": {"lost_row": 0.1}}, r"no fault 'lost_row' \(did you mean lost_rows\?\)"),
        ({"faults": 0}, "faults are a table of chances and ranges, got 0"),
        (
            {"faults": {"wear": 0.1}, "observe": "depth_m"},
            "faults are of images: observe rgb or rgb_levels",
        ),
    ],
)
def test_faults_that_cannot_be_are_refused(options: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        make(**options)
