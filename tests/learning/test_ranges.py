# SPDX-License-Identifier: Apache-2.0
"""Draws of episodes: within the file's ranges, a sensor's spread or given ones, and even."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode

from taccel_lab.errors import InputError
from taccel_lab.geometry.block import block_mesh
from taccel_lab.learning.catalogue import make_vec
from taccel_lab.learning.vector_env import EpisodeDraws, TactileVectorEnv
from taccel_lab.profile import PerturbationBlock, Provenance, SensorProfile
from taccel_lab.sensors.profile import catalogue_profile
from tests.tasks.changed import parameters


@pytest.fixture(scope="module")
def assumed() -> SensorProfile:
    mini = catalogue_profile("gelsight_mini")
    mesh = block_mesh((5, 5, 1), (20.75e-3, 25.25e-3, 4e-3), 0.1)
    gel = mini.gel.replace(node_count=mesh.node_count, tet_count=mesh.tet_count)
    return replace(mini, gel=gel, mesh=mesh)


@pytest.fixture(scope="module")
def measured(assumed: SensorProfile) -> SensorProfile:
    """It with a modulus of 80 to 120 kPa, a ratio of 0.44 to 0.46 and a friction of 0.6 to 1."""
    evidence = {
        "kind": "calibrated",
        "method": "a test",
        "source": "a test",
        "inputs": {"file": "0" * 64},
        "residuals": {"force_n": 0.1},
        "valid_region": {"depth_mm": (0.0, 1.0)},
    }
    interval = {"young_modulus_pa": (8e4, 1.2e5), "poisson_ratio": (0.44, 0.46)}
    source = Provenance(**evidence, interval=interval)
    values = {"young_modulus_pa": 1e5, "poisson_ratio": 0.45, "friction_coefficient": 0.8}
    material = assumed.material.replace(**values, provenance=source)
    units = PerturbationBlock(friction_coefficient=0.1, provenance=Provenance(**evidence))
    return assumed.with_block(material).with_block(units)


def drawn(env: TactileVectorEnv, gels: list[str], held: str = "object") -> dict[str, np.ndarray]:
    model = env.model
    ids, held_id = [model.body_id(gel) for gel in gels], model.body_id(held)
    return {
        "modulus": model.largest_moduli.numpy()[:, ids],
        "friction": model.pair_friction.numpy()[:, ids, held_id],
        "mass": model.masses.numpy()[:, model.affine.first_control],
    }


@pytest.mark.thorough(cases=("grasp-lift-hand-object-mass1",))
@pytest.mark.parametrize(
    ("task", "held", "mass"),
    [
        ("grasp-lift", "object", (0.075, 0.125)),
        ("grasp-lift-hand", "object", (0.075, 0.125)),
        ("peg-insertion", "peg", (0.0154, 0.0256)),
    ],
)
def test_a_sensor_s_own_spread_is_drawn(
    task: str, held: str, mass: tuple[float, float], measured: SensorProfile
) -> None:
    env = make_vec(task, 32, sensor=measured, randomised=True, device="cpu")
    env.reset(seed=3)
    gels = [body.name for body in env.model.scene.soft_bodies]
    found = drawn(env, gels, held)
    # 2 a b / (a + b) of the gel's friction and the object's 0.2.
    wanted = {
        "modulus": (8e4, 1.2e5),
        "friction": (2 * 0.6 * 0.2 / 0.8, 2 * 1.0 * 0.2 / 1.2),
        "mass": mass,
    }
    for name, (low, high) in wanted.items():
        values = found[name]
        assert low <= values.min() and values.max() <= high, name
        assert values.min() < low + 0.2 * (high - low) and values.max() > high - 0.2 * (high - low)
    assert (found["modulus"] == found["modulus"][:, :1]).all(), "gels of one episode are alike"
    ranges = {item.what: item for item in env.task.ranges({})}
    assert (ranges["poisson_ratio"].low, ranges["poisson_ratio"].high) == (0.44, 0.46)
    assert ranges["poisson_ratio"].of == tuple((gel,) for gel in gels)
    env = make_vec(task, 2, sensor=measured, randomised=True, device="cpu")
    env.reset(seed=3)
    seen, _, _, truncated, _ = env.step(torch.zeros(env.action_space.shape))
    assert not truncated.any() and torch.isfinite(seen["wrench"]).all()


def test_the_crown_of_a_sensor_s_gel_is_where_the_peg_s_path_has_it(
    measured: SensorProfile,
) -> None:
    """Mounts stand 2 mm further apart each: the example's gels have their face at z = 2 mm."""
    places = []
    for sensor in (None, measured):
        env = make_vec("peg-insertion", 1, sensor=sensor, device="cpu")
        env.reset(seed=0)
        seen = env.step(torch.zeros(1, 4))[0]
        assert (seen["wrench"][0, :, 2] < -1).all(), "both squeeze the peg"
        places.append(env.state.poses.numpy()[0, :2, 0])
    np.testing.assert_allclose(places[1] - places[0], [2e-3, -2e-3], atol=1e-12)


def test_ranges_that_are_given_stand_in_place(measured: SensorProfile) -> None:
    given = {"young_modulus_pa": (2e5, 2.1e5), "friction": (0.5, 0.6), "mass_kg": (0.2, 0.2)}
    for sensor in (None, measured):
        env = make_vec("grasp-lift", 8, sensor=sensor, randomised=given, device="cpu")
        env.reset(seed=0)
        found = drawn(env, ["left pad", "right pad"])
        for name, low, high in (("modulus", 2e5, 2.1e5), ("friction", 0.5, 0.6)):
            assert (found[name] >= low).all() and (found[name] <= high).all()
        np.testing.assert_allclose(found["mass"], 0.2)
        poisson = [item for item in env.task.ranges(given) if item.what == "poisson_ratio"]
        assert len(poisson) == (sensor is not None)


def test_a_sensor_without_measured_spread_is_refused(assumed: SensorProfile) -> None:
    modulus = {"young_modulus_pa": (1e5, 2e5)}
    for given, message in (
        (True, r"'gelsight_mini' states no measured spread of (friction|young_modulus)"),
        (modulus, "no measured spread of friction: its material is"),
    ):
        with pytest.raises(InputError, match=message):
            make_vec("grasp-lift", 1, sensor=assumed, randomised=given, device="cpu")
    for given in (modulus | {"friction": (0.3, 0.5)}, False):
        env = make_vec("grasp-lift", 1, sensor=assumed, randomised=given, device="cpu")
        env.reset(seed=0)


def test_bad_ranges_are_refused(measured: SensorProfile) -> None:
    skin = {"young_modulus_pa": 1e5, "poisson_ratio": 0.4, "density_kg_m3": 1e3, "name": "skin"}
    layers = measured.with_block(measured.material.replace(layers=(skin,)))
    colour = "range of 'colour', which episodes of this task do not draw; known: friction, mass_kg"
    mass = "range of mass_kg must be low <= high, got 2 and 1"
    for task, sensor, given, message in (
        *(("grasp-lift", who, {"colour": (0.0, 1.0)}, colour) for who in (None, measured)),
        *(("grasp-lift", who, {"mass_kg": (2.0, 1.0)}, mass) for who in (None, measured)),
        ("peg-insertion", layers, False, "a gel of several layers"),
        ("grasp-lift", layers, False, "a gel of several layers"),
    ):
        with pytest.raises(InputError, match=message):
            make_vec(task, 1, sensor=sensor, randomised=given, device="cpu")
    # The file's ranges are as they were.
    env = make_vec("peg-insertion", 1, device="cpu")
    listed_ranges = parameters("peg-insertion").learning.randomise
    for item, listed in zip(env.task.ranges({}), listed_ranges, strict=True):
        assert (item.what, item.low, item.high) == (listed.what, listed.low, listed.high)


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
    mode = AutoresetMode.DISABLED
    env = make_vec("peg-insertion", 16, randomised=True, autoreset_mode=mode, device="cpu")
    env.reset(seed=0)
    model = env.model
    left, right, peg, hole = map(model.body_id, ("left", "right", "peg", "hole"))

    def values() -> dict[str, np.ndarray]:
        friction, moduli = model.pair_friction.numpy(), model.largest_moduli.numpy()
        return {
            "left": moduli[:, left],
            "right": moduli[:, right],
            "left, peg": friction[:, left, peg],
            "right, peg": friction[:, right, peg],
            "peg, hole": friction[:, peg, hole],
            "peg": model.masses.numpy()[:, model.affine.first_control],
        }

    first = {name: value.copy() for name, value in values().items()}
    for item in parameters("peg-insertion").learning.randomise:
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
