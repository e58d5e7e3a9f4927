# SPDX-License-Identifier: Apache-2.0
"""Materials of made-up records and of a gel's own presses are found again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from taccel_lab import presses
from taccel_lab.calibration.capture import load_capture_folder
from taccel_lab.calibration.material import force_table
from taccel_lab.calibration.material.fit import calibrate_material
from taccel_lab.calibration.material.force_table import GelBench
from taccel_lab.calibration.material.options import MaterialOptions
from taccel_lab.calibration.material.result import MaterialCalibration
from taccel_lab.errors import SimulationError
from taccel_lab.presses.mesh import press_mesh
from taccel_lab.profile import SensorProfile, load_profile, save_profile
from taccel_lab.sensors.profile import catalogue_profile
from tests.calibration.material.made_up import COARSE_FAST, FAST, ball, gel
from tests.support.variants import variants

MODULUS, NOISE = 3.1e5, 0.01
pytestmark = pytest.mark.usefixtures("press_cache")


def mini(friction: float | None = None) -> SensorProfile:
    profile = catalogue_profile("gelsight_mini")
    rubs = {} if friction is None else {"friction_coefficient": friction}
    return profile.with_block(profile.material.replace(**rubs))


def pressed_n(
    profile: SensorProfile, indenter: str, depth_mm: float, how: presses.PressPhysics
) -> float:
    """Force [N] of a press of a profile, with what ``taccel-lab press`` takes from it."""
    tool, sensor = presses.parse_indenter(indenter), profile.sensor
    mesh = press_mesh(
        sensor.family, sensor.parameters, (0.0, 0.0), tool.contact(depth_mm), how.mesh
    )
    material, path = presses.profile_material(profile.material, mesh), presses.PressPath(depth_mm)
    friction = profile.material.friction_coefficient
    setup = presses.PressSetup(mesh, material, tool, friction, how)
    outcome = presses.simulate_press(setup, (0.0, 0.0), path, presses.SeenFrom(profile.grid()))
    return float(outcome.steps[-1].wrench[2])


def recorded(
    folder: Path, indenter: str, depths: np.ndarray, rubs: float, physics: presses.PressPhysics
) -> np.ndarray:
    """Forces read off presses of a Mini of another modulus, in a capture folder."""
    true = mini(rubs)
    true = true.with_block(true.material.replace(young_modulus_pa=MODULUS))
    force = np.array([pressed_n(true, indenter, depth, physics) for depth in depths.tolist()])
    read = force * (1 + NOISE * np.random.default_rng(5).standard_normal(len(depths)))
    rows = [f"{d:.9g},{f:.9g}\n" for d, f in zip(depths, read, strict=True)]
    (folder / "press.csv").write_text("depth_mm,force_n\n" + "".join(rows))
    kind, _, radius = indenter.partition(":")
    (folder / "captures.toml").write_text(
        'schema_version = 2\nsensor = "gelsight_mini"\n[[records]]\nfile = "press.csv"\n'
        f'kind = "indentation"\ntool = {{ kind = "{kind}", radius_mm = {radius} }}\n'
    )
    return read


def calibrated(
    folder: Path, base: SensorProfile, physics: presses.PressPhysics, **fixed: float
) -> tuple[MaterialCalibration, SensorProfile]:
    options = MaterialOptions(physics=physics, fixed={"nu": base.material.poisson_ratio, **fixed})
    found = calibrate_material(load_capture_folder(folder), base, options)
    save_profile(found.apply_to(base), folder / "profile")
    return found, load_profile(folder / "profile")


@pytest.mark.thorough
@pytest.mark.parametrize("indenter", variants(["sphere:6"], ["sphere:6", "cylinder:3"]))
def test_presses_of_the_profile_reproduce_the_record(
    tmp_path: Path, indenter: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("taccel_lab.calibration.material.force_table.DEPTHS", 4)
    depths, rubs = np.array([0.25, 0.5, 0.75]), 0.4
    read = recorded(tmp_path, indenter, depths, rubs, COARSE_FAST)
    found, profile = calibrated(tmp_path, mini(rubs), COARSE_FAST, friction=rubs)
    block = profile.material
    assert block.young_modulus_pa == pytest.approx(MODULUS, rel=0.03)
    low, high = block.provenance.interval["young_modulus_pa"]
    assert low < MODULUS < high
    fitted = block.fitted_with
    assert fitted is not None and fitted.indenters == (indenter,)
    assert fitted.physics == {**fitted.physics, "accuracy": "fast", "element": "quadratic"}
    assert fitted.friction_coefficient == block.friction_coefficient == rubs
    assert presses.physics_difference(block, COARSE_FAST, block.friction_coefficient) is None
    assert found.stiffness is not None
    shift = fitted.touch_shift_mm["press.csv"]
    low, high = block.provenance.interval["touch_shift_mm of press.csv"]
    assert low < 0.0 < high
    depth, force = float(depths[-1]), float(read[-1])
    again = pressed_n(profile, indenter, depth - shift, COARSE_FAST)
    assert again == pytest.approx(force, rel=3 * NOISE)
    low, high = found.stiffness.force_interval_n(0, depth - shift)
    assert low < again < high
    low, high = found.stiffness.force_interval_n(0, depth, reading=True)
    assert low < force < high


@pytest.mark.slow
def test_a_press_with_other_friction_is_not_that_of_the_fit(tmp_path: Path) -> None:
    """The profile says the coefficient that fits, and a press takes it; another is a tenth off."""
    depths = np.linspace(0.2, 1.4, 9)
    force = float(recorded(tmp_path, "sphere:7.5", depths, 0.0, FAST)[-1])
    found, profile = calibrated(tmp_path, mini(), FAST)
    assert mini().material.friction_coefficient == 1.0
    assert profile.material.friction_coefficient == 0.0
    assert "friction_assumed" in {remark.code for remark in found.remarks}
    fitted = profile.material.fitted_with
    assert fitted is not None and not fitted.friction_measured
    depth = float(depths[-1]) - fitted.touch_shift_mm["press.csv"]
    assert pressed_n(profile, "sphere:7.5", depth, FAST) == pytest.approx(force, rel=3 * NOISE)
    rubbing = profile.with_block(profile.material.replace(friction_coefficient=1.0))
    assert pressed_n(rubbing, "sphere:7.5", depth, FAST) > 1.08 * force
    said = presses.physics_difference(rubbing.material, replace(FAST), 1.0)
    assert said is not None and "friction 0 (this press: 1)" in said


@pytest.mark.thorough
def test_a_press_that_does_not_converge_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Too few Newton iterations for a deep step; nothing of it is kept for the next try."""
    bench = GelBench(replace(gel(), physics=COARSE_FAST), ball(6.0), 1.0, 0.3)
    with monkeypatch.context() as patch:
        hasty = {"max_newton_iterations": 2, "max_substep_halvings": 0}
        patch.setattr(force_table, "RUBBING_LIMITS", hasty)
        with pytest.raises(SimulationError, match="did not converge"):
            bench.pressed(bench.gel)
    found = bench.pressed(bench.gel)
    assert found["force_n"] > 0 and found["seconds"] > 0
    assert bench.pressed(bench.gel)["seconds"] == found["seconds"], "taken from the cache"
