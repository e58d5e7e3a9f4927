# SPDX-License-Identifier: Apache-2.0
"""Materials of made-up records and of a gel's own presses are found again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.calibration.capture import load_capture_folder
from taccel_lab.calibration.capture.schema import ToolEntry
from taccel_lab.calibration.material import force_table
from taccel_lab.calibration.material.fit import calibrate_material
from taccel_lab.calibration.material.force_table import GelBench
from taccel_lab.calibration.material.gel import Gel
from taccel_lab.calibration.material.options import MaterialOptions
from taccel_lab.calibration.material.result import MaterialCalibration
from taccel_lab.errors import SimulationError
from taccel_lab.presses import (
    PressPath,
    PressPhysics,
    parse_indenter,
    physics_difference,
    profile_material,
    simulate_press,
)
from taccel_lab.profile import SensorProfile, load_profile, save_profile
from taccel_lab.sensors.press_mesh import press_mesh
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


@pytest.mark.thorough
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
        low, high = found.stiffness.force_interval_n(0, depth, reading=True)
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


@pytest.mark.thorough
def test_a_press_that_does_not_converge_is_refused(
    gel: Gel, press_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Too few Newton iterations for a deep step; nothing of it is kept for the next try."""
    hasty = {"max_newton_iterations": 2, "max_substep_halvings": 0}
    tool = gel.tool(ToolEntry(kind="sphere", radius_mm=6.0))
    bench = GelBench(replace(gel, physics=COARSE_FAST), tool, 1.0)
    with monkeypatch.context() as patch:
        patch.setattr(force_table, "RUBBING_LIMITS", hasty)
        with pytest.raises(SimulationError, match="did not converge"):
            bench.pressed(bench.gel, 0.3)
    found = bench.pressed(bench.gel, 0.3)
    assert found["force_n"] > 0 and found["seconds"] > 0
    assert bench.pressed(bench.gel, 0.3)["seconds"] == found["seconds"], "taken from the cache"
