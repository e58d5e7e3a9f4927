# SPDX-License-Identifier: Apache-2.0
"""Simulated against measured forces of a ball pressed into a GelSight Mini gel, and its material.

A steel ball of 7.5 mm radius was driven 0.5, 1.0 and 1.5 mm into a 25.25 x 20.75 x 4 mm gel and
the normal force measured (FEATS, MIT licence). A single Young's modulus has to explain all three
points: depth dependence is what a wrong contact or layer model gets wrong, a half-space (Hertz)
needs a modulus that rises by more than half. The points tell neither Poisson's ratio nor friction,
and the calibration has to say so; presses of its profile give the points again.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.cad.mesh.gel_mesh import FocusOptions, focused_gel_mesh
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.calibration.capture import load_capture_folder
from taccel_lab.calibration.material.fit import calibrate_material
from taccel_lab.calibration.material.options import MaterialOptions
from taccel_lab.calibration.material.result import MaterialCalibration
from taccel_lab.cli.app import main
from taccel_lab.presses import PHYSICS, Accuracy, PressEnv, PressPhysics, PressSetup, parse_indenter
from taccel_lab.profile import save_profile
from taccel_lab.report.remark import Verdict, judge
from taccel_lab.scene import Material
from taccel_lab.sensors.profile import catalogue_profile
from tests.calibration.material.made_up import COARSER
from tests.support.real_data import real_data
from tests.support.variants import variants


def points() -> tuple[np.ndarray, np.ndarray]:
    """Depths [mm] and forces [N]."""
    data = json.loads(real_data("gsmini_feats_calib/force_indentation.json").read_text())
    return np.array(data["indentation_mm"]), np.array(data["normal_force_N"])


def simulated_n(depths_mm: np.ndarray) -> np.ndarray:
    """Frictionless press forces [N] for a Young's modulus of 1 MPa; forces scale with it."""
    pad = GelPad(
        length_x_mm=25.25, length_y_mm=20.75, corner_radius_mm=1.5, thickness_mm=4.0,
        window_x_mm=18.0, window_y_mm=14.0,
    )  # fmt: skip
    focus = FocusOptions(
        at_mm=(0.0, 0.0), radius_mm=5.0, size_mm=0.9, core=4, rings=5, layers=2, layer_ratio=1.15
    )
    mesh, ball = focused_gel_mesh(pad, focus), parse_indenter("sphere:7.5")
    env = PressEnv(PressSetup(mesh, Material(1e6, 0.48), ball), np.zeros((1, 2)))
    assert env.model.soft_count == 2005  # with 12,969 nodes forces are 1.2 % lower
    forces = []
    for depth in depths_mm:
        env.move_to(depth)
        forces.append(env.wrench[0, 2])
    return np.array(forces)


@pytest.mark.thorough
def test_one_modulus_and_a_zero_explain_the_measured_forces() -> None:
    depth_mm, measured = points()

    def fitted(zero_mm: float) -> tuple[float, float]:
        """Modulus [MPa] by least squares in relative error, and the largest of these errors."""
        ratio = simulated_n(depth_mm + zero_mm) / measured
        modulus = ratio.sum() / (ratio**2).sum()
        return modulus, float(np.abs(modulus * ratio - 1).max())

    # As recorded 4.3 %; first touch was taken a little late, as with any ball.
    assert fitted(0.0)[1] < 0.05
    modulus_mpa, error = fitted(0.03)
    # 55 Shore 00 is about 10 to 12 Shore A, for which Gent's formula gives 0.41 to 0.47 MPa.
    assert error < 0.02 and 0.41 < modulus_mpa < 0.47
    # The half-space formula cannot do this.
    hertz = 4 / 3 * np.sqrt(7.5e-3) * (depth_mm * 1e-3) ** 1.5 / (1 - 0.48**2)
    assert np.ptp(np.log(measured / hertz)) > np.log(1.5)


@pytest.fixture
def feats(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The points as a capture folder, and an empty cache."""
    monkeypatch.setenv("TACCEL_LAB_CACHE", str(tmp_path / "cache"))
    rows = (f"{depth},{force}\n" for depth, force in zip(*points(), strict=True))
    (tmp_path / "press.csv").write_text("depth_mm,force_n\n" + "".join(rows))
    (tmp_path / "captures.toml").write_text(
        'schema_version = 2\nsensor = "gelsight_mini"\nsource = "FEATS"\n[[records]]\n'
        'file = "press.csv"\nkind = "indentation"\ntool = { kind = "sphere", radius_mm = 7.5 }\n'
    )
    return tmp_path


def calibrated(feats: Path, options: MaterialOptions) -> MaterialCalibration:
    """The fit; its profile lies in the folder ``profile``."""
    base = catalogue_profile("gelsight_mini")
    found = calibrate_material(load_capture_folder(feats), base, options)
    save_profile(found.apply_to(base), feats / "profile")
    return found


def pressed_n(feats: Path, depth_mm: float, *options: str) -> float:
    """Force of ``taccel-lab press`` on the calibrated profile [N]."""
    out = feats / f"press_{depth_mm:.3f}"
    command = ["press", str(feats / "profile"), "--indenter", "sphere:7.5"]
    assert main([*command, "--depth-mm", repr(depth_mm), "--out", str(out), *options]) == 0
    return float(json.loads((out / "press.json").read_text())["press"]["force_n"])


def require_closed_loop(
    feats: Path, found: MaterialCalibration, *options: str, first: int = 0
) -> None:
    """Presses at the calibrated depths meet the points, from ``first`` on, within 3 %, which lie in
    the intervals stated for readings; a press lies in that stated for presses."""
    assert found.stiffness is not None
    stiffness, fit = found.stiffness, found.stiffness.fit
    (item,) = fit.points
    for depth, force in zip(item.depth_mm[first:], item.force_n[first:], strict=True):
        pressed = pressed_n(feats, float(depth) - fit.touch_mm(0), *options)
        assert pressed == pytest.approx(force, rel=0.03)
        low, high = stiffness.force_interval_n(0, depth, reading=True)
        assert low < force < high
    deepest = float(item.depth_mm[-1])
    low, high = stiffness.force_interval_n(0, deepest)
    assert low < pressed_n(feats, deepest, *options) < high


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("physics", "depths"), variants([(COARSER, 3)], [COARSER, PHYSICS[Accuracy.FAST]], [3, 4])
)
def test_one_modulus_without_friction_within_three_per_cent(
    feats: Path, monkeypatch: pytest.MonkeyPatch, physics: PressPhysics, depths: int
) -> None:
    """By a table of few depths instead of seven."""
    monkeypatch.setattr("taccel_lab.calibration.material.force_table.DEPTHS", depths)
    fixed = {"nu": 0.46, "friction": 0.0}
    found = calibrated(feats, MaterialOptions(physics=physics, fixed=fixed))
    assert found.stiffness is not None and "young_modulus_pa" in found.estimates
    assert np.abs(found.stiffness.fit.relative_residuals(0)).max() < 0.02
    assert max(abs(item.relative) for item in found.stiffness.held_out) < 0.06
    # Gent's formula gives 0.41 to 0.47 MPa for the vendor's 55 Shore 00, which is known to 10 %;
    # seven depths give 0.503, with an interval from 0.470 on.
    young = found.estimates["young_modulus_pa"]
    assert young.value == pytest.approx(4.7e5, rel=0.1) and young.interval95[0] < 1.1 * 4.7e5
    # The command presses with no mesh as coarse.
    if physics is not COARSER:
        require_closed_loop(feats, found, "--accuracy", "fast", first=-1)


@pytest.mark.slow
def test_what_three_points_do_not_tell(feats: Path) -> None:
    found = calibrated(feats, MaterialOptions())
    codes = {remark.code for remark in found.remarks}
    assert {"young_given_nu", "too_few", "friction_assumed"} <= codes
    assert judge(found.remarks) is Verdict.USABLE
    assert not {"poisson_ratio", "friction_coefficient"} & set(found.estimates)
    assert found.stiffness is not None
    residuals = found.stiffness.residuals()
    # In sample 0.65 %, which three points and two numbers make look better than it is.
    held_out = residuals["indentation_held_out_worst_relative"]
    assert 2 * residuals["indentation_worst_relative"] < held_out < 0.06
    base = catalogue_profile("gelsight_mini")
    block = found.apply_to(base).material
    assert block.poisson_ratio == base.material.poisson_ratio
    assert block.friction_coefficient == found.used_friction
    low, high = block.provenance.interval["young_modulus_pa"]
    # With nu of 0.45 to 0.495 alone it goes from 0.50 to 0.43 MPa.
    assert low < 4.3e5 and 5.0e5 < high
    assert block.provenance.valid_region["depth_mm"] == (0.5, 1.5)
    require_closed_loop(feats, found)
