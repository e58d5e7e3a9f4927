# SPDX-License-Identifier: Apache-2.0
"""Materials of made-up records and of a gel's own presses are found again."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.calibration.capture import load_capture_folder
from taccel_lab.calibration.material.fit import calibrate_material
from taccel_lab.calibration.material.gel_presses import GelPresses, Stop
from taccel_lab.calibration.material.options import MaterialOptions
from taccel_lab.calibration.material.press_plans import CurvePlan, follow, prepare, simulate
from taccel_lab.calibration.material.result import MaterialCalibration
from taccel_lab.errors import SimulationError
from taccel_lab.geometry.block import block_mesh
from taccel_lab.presses import (
    PressPath,
    PressPhysics,
    parse_indenter,
    physics_difference,
    profile_material,
    simulate_press,
)
from taccel_lab.profile import SensorProfile, load_profile, save_profile
from taccel_lab.scene import Material, MaterialField, MaterialModel
from taccel_lab.sensors.press_mesh import press_mesh
from taccel_lab.solvers import SolverConfig
from tests.calibration.material.made_up import COARSE_FAST, FAST

MODULUS, NOISE = 3.1e5, 0.01


def pressed_n(
    profile: SensorProfile, indenter: str, depth_mm: float, physics: PressPhysics
) -> float:
    """Force [N] of a press of a profile, with what ``taccel-lab press`` takes from it."""
    tool = parse_indenter(indenter)
    mesh = press_mesh(
        profile.sensor.family, profile.sensor.parameters, (0.0, 0.0),
        tool.contact(depth_mm), physics.mesh,
    )  # fmt: skip
    outcome = simulate_press(
        mesh, profile_material(profile.material, mesh), tool, (0.0, 0.0), PressPath(depth_mm),
        profile.grid(), friction_coefficient=profile.material.friction_coefficient,
        physics=physics,
    )  # fmt: skip
    return float(outcome.steps[-1].wrench[2])


def recorded(
    folder: Path,
    base: SensorProfile,
    indenter: str,
    depths: np.ndarray,
    rubs: float,
    physics: PressPhysics,
) -> np.ndarray:
    """A capture folder of presses of ``base`` with friction ``rubs`` and another modulus; what was
    read."""
    material = base.material.replace(young_modulus_pa=MODULUS, friction_coefficient=rubs)
    true = base.with_block(material)
    rng = np.random.default_rng(5)
    force = np.array([pressed_n(true, indenter, depth, physics) for depth in depths.tolist()])
    read = force * (1 + NOISE * rng.standard_normal(len(depths)))
    rows = zip(depths, read, strict=True)
    (folder / "press.csv").write_text(
        "depth_mm,force_n\n" + "".join(f"{d:.9g},{f:.9g}\n" for d, f in rows)
    )
    kind, _, radius = indenter.partition(":")
    (folder / "captures.toml").write_text(
        'schema_version = 2\nsensor = "gelsight_mini"\n[[records]]\nfile = "press.csv"\n'
        f'kind = "indentation"\ntool = {{ kind = "{kind}", radius_mm = {radius} }}\n'
    )
    return read


def calibrated(
    folder: Path, base: SensorProfile, options: MaterialOptions
) -> tuple[MaterialCalibration, SensorProfile]:
    found = calibrate_material(load_capture_folder(folder), base, options)
    save_profile(found.apply_to(base), folder / "profile")
    return found, load_profile(folder / "profile")


@pytest.mark.parametrize(
    "indenter", ["sphere:6", pytest.param("cylinder:3", marks=pytest.mark.slow)]
)
def test_presses_of_the_profile_reproduce_the_record(
    mini: SensorProfile,
    press_cache: Path,
    tmp_path: Path,
    indenter: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("taccel_lab.calibration.material.force_table.DEPTHS", 4)
    depths = np.array([0.25, 0.5, 0.75])
    rubs = 0.4
    base = mini.with_block(mini.material.replace(friction_coefficient=rubs))
    read = recorded(tmp_path, base, indenter, depths, rubs, COARSE_FAST)
    nu = base.material.poisson_ratio
    options = MaterialOptions(physics=COARSE_FAST, fixed={"nu": nu, "friction": rubs})
    found, profile = calibrated(tmp_path, base, options)
    block = profile.material
    assert block.young_modulus_pa == pytest.approx(MODULUS, rel=0.03)
    low, high = block.provenance.interval["young_modulus_pa"]
    assert low < MODULUS < high
    fitted = block.fitted_with
    assert fitted is not None and fitted.indenters == (indenter,)
    assert fitted.physics == {**fitted.physics, "accuracy": "fast", "element": "quadratic"}
    assert fitted.friction_coefficient == block.friction_coefficient == rubs
    assert physics_difference(block, COARSE_FAST, block.friction_coefficient) is None
    assert found.stiffness is not None
    shift = fitted.touch_shift_mm["press.csv"]
    low, high = block.provenance.interval["touch_shift_mm of press.csv"]
    assert low < 0.0 < high
    for depth, force in zip(depths[2:].tolist(), read[2:].tolist(), strict=True):
        again = pressed_n(profile, indenter, depth - shift, COARSE_FAST)
        assert again == pytest.approx(force, rel=3 * NOISE)
        low, high = found.stiffness.force_interval_n(0, depth - shift)
        assert low < again < high
        low, high = found.stiffness.reading_interval_n(0, depth)
        assert low < force < high


@pytest.mark.slow
def test_a_press_with_other_friction_is_not_that_of_the_fit(
    mini: SensorProfile, press_cache: Path, tmp_path: Path
) -> None:
    """Of records that friction was not measured with, the coefficient that fits is what the profile
    says and a press takes; the other one is a tenth off."""
    depths = np.linspace(0.2, 1.4, 9)
    read = recorded(tmp_path, mini, "sphere:7.5", depths, 0.0, FAST)
    options = MaterialOptions(physics=FAST, fixed={"nu": mini.material.poisson_ratio})
    found, profile = calibrated(tmp_path, mini, options)
    assert mini.material.friction_coefficient == 1.0
    assert profile.material.friction_coefficient == 0.0
    assert "friction_assumed" in {remark.code for remark in found.remarks}
    fitted = profile.material.fitted_with
    assert fitted is not None and not fitted.friction_measured
    depth = float(depths[-1]) - fitted.touch_shift_mm["press.csv"]
    force = float(read[-1])
    assert pressed_n(profile, "sphere:7.5", depth, FAST) == pytest.approx(force, rel=3 * NOISE)
    rubbing = profile.with_block(profile.material.replace(friction_coefficient=1.0))
    assert pressed_n(rubbing, "sphere:7.5", depth, FAST) > 1.08 * force
    said = physics_difference(rubbing.material, replace(FAST), 1.0)
    assert said is not None and "friction 0 (this press: 1)" in said


MESH = block_mesh((5, 5, 2), (10e-3, 10e-3, 3e-3))
BALL = parse_indenter("sphere:6")
TIGHT = SolverConfig(relative_tolerance=1e-8, dhat_m=2e-5)
RUBBING = SolverConfig(relative_tolerance=1e-6, dhat_m=2e-5, friction_eps_m=5e-6)


def press(
    materials: Sequence[Material | MaterialField],
    frictions: Sequence[float],
    config: SolverConfig = TIGHT,
) -> GelPresses:
    return GelPresses(MESH, materials, BALL, (0.0, 0.0), frictions, config=config)


def moved(env: GelPresses, stops: Sequence[Stop]) -> np.ndarray:
    """Force [N] on the tool, [env, 3]."""
    report = env.go(stops)
    assert report.converged.all()
    return env.press_force


@pytest.mark.parametrize("model", list(MaterialModel))
def test_gels_of_unlike_moduli_in_one_scene_are_those_of_scenes_of_their_own(
    model: MaterialModel,
) -> None:
    ratios = (0.1, 0.9) if model is MaterialModel.MOONEY_RIVLIN else (0.0, 0.0)
    layered = np.where(MESH.nodes_m[MESH.tets].mean(axis=1)[:, 2] > -1e-3, 1e6, 4e5)
    materials = [
        Material(1e6, 0.49, model=model, mooney_ratio=ratios[0]),
        MaterialField(layered, 0.42, model=model, mooney_ratio=ratios[1]),
    ]
    together = moved(press(materials, (0.0, 0.0)), [Stop(0.3), Stop(0.5)])
    for i, depth in enumerate((0.3, 0.5)):
        alone = moved(press(materials[i : i + 1], (0.0,)), [Stop(depth)])
        np.testing.assert_allclose(together[i, 2], alone[0, 2], rtol=1e-7)
    # With the moduli of the other they are another gel.
    assert abs(moved(press(materials[1:], (0.0,)), [Stop(0.3)])[0, 2] / together[0, 2] - 1) > 0.05


def test_coefficients_of_friction_and_ways_differ_by_environment() -> None:
    gels = [Material(1e6, 0.47)] * 3
    frictions = (0.0, 0.2, 0.5)
    env = press(gels, frictions, RUBBING)
    moved(env, [Stop(0.4)] * 3)
    ways = [Stop(0.4, (0.1, 0.0)), Stop(0.45, (0.05, 0.0)), Stop(0.4, (0.0, 0.05))]
    together = moved(env, ways)
    for i, way in enumerate(ways):
        single = press(gels[:1], frictions[i : i + 1], RUBBING)
        moved(single, [Stop(0.4)])
        alone = moved(single, [way])
        np.testing.assert_allclose(together[i], alone[0], atol=1e-4 * alone[0, 2])
    assert abs(together[1, 0]) > 5 * abs(together[0, 0])
    assert abs(together[2, 1]) > 5 * abs(together[2, 0])


def test_scenes_that_cannot_be_shared_are_refused() -> None:
    soft, stiff = Material(1e5, 0.47), Material(1e6, 0.47)
    other = Material(1e6, 0.47, model=MaterialModel.STABLE_NEO_HOOKEAN)
    for pair in ((soft, stiff), (stiff, other)):
        with pytest.raises(ValueError, match="must share"):
            press(pair, (0.0, 0.0))
    with pytest.raises(ValueError, match="2 materials, but 1"):
        press((stiff, stiff), (0.1,))


class Bench:
    """Gels of one block; ``device`` only decides how many go together."""

    def __init__(self, device: str, config: SolverConfig = TIGHT) -> None:
        self.device, self.config = device, config
        self.built: list[int] = []

    def presses(self, plans: Sequence[CurvePlan]) -> GelPresses:
        self.built.append(len(plans))
        gels = [Material(1e6, each.poisson_ratio) for each in plans]
        return press(gels, [each.friction for each in plans], self.config)


def plan(nu: float, depths: Sequence[float], friction: float = 0.0, must: int = 0) -> CurvePlan:
    return CurvePlan(
        {"what": "test", "nu": nu, "depths": list(depths), "mu": friction},
        nu,
        0.0,
        friction,
        [Stop(depth) for depth in depths],
        read=lambda env, _: env.press_force,
        arrays=lambda rows: {"force_n": rows[:, 2]},
        must_reach=must,
    )


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TACCEL_LAB_CACHE", str(tmp_path))


def test_a_table_of_candidates_comes_out_of_one_scene(own_cache: None) -> None:
    wanted = [plan(nu, depths) for nu, depths in ((0.4, (0.2, 0.4)), (0.48, (0.1, 0.3, 0.5)))]
    bench, told = Bench("cuda:0"), []
    prepare(bench, wanted, lambda *how_far: told.append(how_far))
    assert bench.built == [2]
    assert told[0] == ("presses", 0, 2)
    found = [simulate(bench, item) for item in wanted]
    assert bench.built == [2]  # each was kept for itself
    for item, result in zip(wanted, found, strict=True):
        alone = follow(bench.presses([item]), [item])
        np.testing.assert_allclose(result["force_n"], alone.rows[0][:, 2], rtol=1e-7)
        assert len(result["force_n"]) == len(item.stops)
    # One core takes them one by one.
    slow = Bench("cpu")
    prepare(slow, [plan(0.41, (0.2,)), plan(0.42, (0.2,))])
    assert slow.built == []


def test_an_environment_that_fails_is_tried_again_alone(own_cache: None) -> None:
    """Too few Newton iterations for the deep step, enough for the shallow ones."""
    hasty = SolverConfig(relative_tolerance=1e-8, max_newton_iterations=14, max_substep_halvings=0)
    good, bad = plan(0.4, (0.02, 0.03)), plan(0.499, (0.02, 1.8), must=2)
    bench = Bench("cuda:0", hasty)
    prepare(bench, [good, bad])
    assert good.kept.exists() and not bad.kept.exists()
    assert np.isfinite(simulate(bench, good)["force_n"]).all()
    with pytest.raises(SimulationError, match="did not converge"):
        simulate(bench, bad)
    assert bench.built == [2, 1]
    tolerated = plan(0.499, (0.02, 1.8), must=1)
    forces = simulate(bench, tolerated)["force_n"]
    assert np.isfinite(forces[0]) and np.isnan(forces[1])


def test_presses_need_no_reader_of_files() -> None:
    """Machines that only simulate have none."""
    absent = ("pydantic", "rich", "tyro", "matplotlib", "cv2", "torch")
    code = (
        f"import sys; sys.modules.update(dict.fromkeys({absent!r}))\n"
        "import taccel_lab.calibration.material.press_plans, taccel_lab.geometry.block"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
