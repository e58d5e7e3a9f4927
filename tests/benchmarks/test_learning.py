# SPDX-License-Identifier: Apache-2.0
"""The suite ``learning``: what its rows say, and that torch sees what the gels show and feel."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from taccel_lab.benchmarks import learning
from taccel_lab.benchmarks.learning import gel_signal
from taccel_lab.benchmarks.scenes import SceneOptions, build_scene
from taccel_lab.model.embedding import rotate
from taccel_lab.outputs import Outputs
from taccel_lab.signals import resultant_wrench
from tools.bench.report.sections import SECTIONS, number

BOTH = ("rgb", "wrench")


def options(**changes: Any) -> learning.Learning:
    few = {"envs": (3,), "steps": 3, "warm_up": 4, "reset_share": 0.4, "source": "generated"}
    return learning.Learning(**(few | changes))


def text_of(*rows: dict[str, Any]) -> str:
    """The table of a result with these rows."""
    run = {"device": "cuda", "date": "", "commit": "", "packages": {}}
    document = {"rows": list(rows), "run": run, "file": "learning.json", "complete": True}
    return SECTIONS["learning"]({"learning": [document]})


@pytest.mark.thorough
@pytest.mark.parametrize("observe", [(), BOTH], ids=["alone", "observed"])
@pytest.mark.parametrize("pace", ["together", "own"])
def test_a_learning_row(pace: str, observe: tuple[str, ...]) -> None:
    """Phases differ, some environments begin anew, and nothing else is left of before."""
    row = learning.measure(3, pace, options(observe=observe))
    assert row["residual"]["unconverged"] == 0
    assert row["residual"]["env_steps"] in ((9,) if pace == "together" else (9, 10, 11))
    assert row["calls_per_step"] == 1 or pace == "own"
    assert row["resets_per_step"] > 0
    assert row["newton_largest_mean"] >= row["newton_mean"]
    assert row["ms_per_step"]["median"] > row["beside_steps_ms"] > 0
    assert row["newton_median"] <= row["newton_p99"] <= row["newton_p999"] <= row["newton_worst"]
    text, seen = text_of(row), row["observed"]
    assert "largest of those through at once" in text and f"| 3 | {pace} |" in text
    if not observe:
        assert seen is None and "observed" not in text
        return
    assert (seen["what"], seen["gels"], seen["size_px"]) == (["rgb", "wrench"], 2, [64, 64])
    assert seen["env_steps"] == row["residual"]["env_steps"], "every finished step was looked at"
    assert seen["fps"] == pytest.approx(row["fps"]["median"])
    spent = (seen["rgb_us_per_env_step"] + seen["wrench_us_per_env_step"]) * 1e-6
    assert 1 / seen["fps"] == pytest.approx(1 / seen["fps_without"] + spent)
    assert seen["images_per_s"] == pytest.approx(2e6 / seen["rgb_us_per_env_step"])
    text = text_of(row, row | {"observed": None})
    assert "| observed: us a step of each | FPS without |" in text and "| nothing | - |" in text
    assert f"| rgb {number(seen['rgb_us_per_env_step'])}, wrench " in text


def test_by_default_phases_are_uniform_over_the_motion() -> None:
    """A window of a motion's easy part is twice as fast as the whole."""
    default = learning.Learning()
    phases = learning.LearningPhases(
        2_000, 80, default.warm_up, default.reset_share, np.random.default_rng(0)
    )
    ready = np.ones(2_000, dtype=bool)
    for _ in range(phases.warm_up):
        phases.begin(ready)
    for _ in range(100):
        share = np.histogram(phases.now, bins=4, range=(1, 80))[0] / 2_000
        np.testing.assert_allclose(share, 0.25, atol=0.04)
        phases.begin(ready)


@pytest.mark.thorough
@pytest.mark.parametrize("pace", ["together", "own"])
def test_torch_sees_the_gels_of_the_steps_that_are_over(pace: str) -> None:
    """Images are those rendered afterwards, wrenches those of the nodal forces and of the pairs of
    bodies; of environments whose step goes on there is nothing."""
    chosen = options(observe=BOTH, reset_share=0.0, envs=(4,), iterations=1)
    bench = build_scene("peg", SceneOptions(4, "generated"))
    loop = learning.LearningLoop(bench, chosen, pace)
    loop.run(9)
    observer, model, state = loop.observer, loop.model, loop.state
    assert observer is not None and observer.wrenches is not None
    # Which environments are through at once depends on the last digits, and so on the machine.
    for _ in range(40):
        grip_n = np.linalg.norm(observer.wrenches.numpy()[..., :3], axis=-1).min(initial=np.inf)
        if grip_n > 1 and (pace == "together" or 1 < loop._ready.sum() < 4):
            break
        loop.run(1)
    who = loop._ready
    assert who.all() if pace == "together" else 1 < who.sum() < 4, "the paces were meant to differ"
    poses = state.poses.numpy()
    outputs = Outputs(loop.solver).update(state)
    forces = outputs.normal_forces.numpy() + outputs.friction_forces.numpy()
    pairs = (
        outputs.contact_wrenches().totals().numpy() + outputs.friction_wrenches().totals().numpy()
    )
    wrenches, features = observer.wrenches.numpy(), observer.features
    assert features is not None and features.shape == (who.sum(), 2, 9)
    for gel in (0, 1):
        assert model.scene.soft_bodies[gel].mount == model.scene.kinematic_bodies[gel].name
        signal = gel_signal(model, gel)
        signal.update(state.positions, state.poses[:, gel])
        rgb = signal.rgb.numpy()[who]
        image = observer.images[gel]
        assert image.data_ptr() == observer._signals[gel].rgb.ptr, "the host has seen the images"
        np.testing.assert_array_equal(image.numpy(), rgb)
        assert np.ptp(rgb.astype(int), axis=0).max() > 5, "the environments were meant to differ"
        means = rgb.mean(axis=(1, 2)) / 255
        np.testing.assert_allclose(features[:, gel, :3].numpy(), means, rtol=1e-5)
        nodes = model.bodies[gel].node_slice
        back = poses[:, gel, 3:] * [-1, -1, -1, 1]
        x = rotate(back[:, None], state.positions.numpy()[:, nodes] - poses[:, gel, None, :3])
        expected = resultant_wrench(x, rotate(back[:, None], forces[:, nodes]))[who]
        assert np.linalg.norm(expected[:, :3], axis=1).min() > 1, "the gels were meant to grip"
        np.testing.assert_allclose(wrenches[:, gel], expected, rtol=1e-9, atol=1e-11)
        np.testing.assert_allclose(features[:, gel, 3:].numpy(), expected, rtol=1e-5, atol=1e-8)
        turned = rotate(back, pairs[:, gel, :3])[who]
        np.testing.assert_allclose(wrenches[:, gel, :3], turned, rtol=1e-9, atol=1e-11)


@pytest.mark.thorough
def test_looking_changes_no_step() -> None:
    bench = build_scene("peg", SceneOptions(2, "generated"))
    ends = []
    for observe in ((), ("rgb",), ("wrench",)):
        loop = learning.LearningLoop(bench, options(envs=(2,), observe=observe))
        loop.run(4)
        ends.append(loop.state.positions.numpy())
    np.testing.assert_array_equal(ends[1], ends[0])
    np.testing.assert_array_equal(ends[2], ends[0])
