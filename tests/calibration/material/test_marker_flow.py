# SPDX-License-Identifier: Apache-2.0
"""Friction and Poisson's ratio from the motion of markers, simulated on a finer mesh."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from taccel_lab.calibration.capture.schema import ToolEntry
from taccel_lab.calibration.markers.flow import MarkerFlow
from taccel_lab.calibration.material.gel import Gel, Tool
from taccel_lab.calibration.material.marker_flow import fit_flow
from taccel_lab.calibration.material.marker_flow_table import path_plan
from taccel_lab.calibration.material.press_plans import GelBench, simulate
from taccel_lab.calibration.material.tool_path import ToolPath
from taccel_lab.envs.physics import PressPhysics
from taccel_lab.errors import InputError
from tests.calibration.material.made_up import COARSE, COARSER, DEFAULT

FRICTION, POISSON = 0.5, 0.475
X, Y = np.meshgrid(np.linspace(-4, 4, 7), np.linspace(-3, 3, 5))
POINTS = np.stack([X.ravel(), Y.ravel()], axis=1)


def path(shift_mm: float = 0.9, twist_deg: float = 0.0, depth_mm: float = 0.6) -> ToolPath:
    """Down, then sideways."""
    down, side = np.linspace(0.1, 1, 5), np.linspace(0.1, 1, 7)
    depth = np.concatenate([[0.0], depth_mm * down, np.full(7, depth_mm)])
    along = np.concatenate([np.zeros(6), side])
    shift = np.stack([shift_mm * along, np.zeros(13)], axis=1)
    return ToolPath(depth, shift, twist_deg * along)


def flow_of(
    gel: Gel, tool: Tool, way: ToolPath, sigma_mm: float, physics: PressPhysics, seed: int = 0
) -> MarkerFlow:
    frames = way.chosen()
    own = gel.with_law(POISSON).with_physics(physics)
    bench = GelBench(own, tool, float(way.depth_mm.max()))
    plan = path_plan(bench, own, way, frames, POINTS, FRICTION)
    moved = simulate(bench, plan)["displacement_mm"]
    everywhere = np.zeros((len(way.depth_mm), len(POINTS), 2))
    everywhere[frames] = moved
    rng = np.random.default_rng(seed)
    seen = rng.random(everywhere.shape[:2]) > 0.1
    noisy = everywhere + sigma_mm * rng.standard_normal(everywhere.shape)
    noisy[~seen] = 77.0  # what is not seen must not matter
    return MarkerFlow(POINTS, noisy, seen, np.full(everywhere.shape, max(sigma_mm, 1e-4)))


@pytest.fixture(autouse=True)
def few_coefficients(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tables of three coefficients of friction instead of eight."""
    nodes = (0.3, 0.45, 0.7)
    monkeypatch.setattr("taccel_lab.calibration.material.marker_flow_table.MU_NODES", nodes)


@pytest.fixture(scope="module")
def tool(gel: Gel) -> Tool:
    return gel.tool(ToolEntry(kind="sphere", radius_mm=4.0))


@pytest.mark.parametrize("motion", ["shear", pytest.param("twist", marks=pytest.mark.slow)])
def test_friction_from_the_slip_of_markers(
    gel: Gel, tool: Tool, press_cache: Path, motion: str
) -> None:
    way = path() if motion == "shear" else path(0.0, 20.0)
    flow = flow_of(gel, tool, way, 0.004, COARSE)
    coarse = gel.with_law(POISSON).with_physics(COARSER)
    fit = fit_flow(flow, way, coarse, tool, free_nu=False)
    assert fit.friction_determined
    assert fit.friction == pytest.approx(FRICTION, rel=0.05)
    low, high = fit.friction_interval
    assert low < FRICTION < high
    assert fit.rms_mm < 0.3 * fit.moved_mm


def test_a_press_alone_leaves_friction_open(gel: Gel, tool: Tool, press_cache: Path) -> None:
    way = path(0.0)
    flow = flow_of(gel, tool, way, 0.05, COARSER)
    coarse = gel.with_law(POISSON).with_physics(COARSER)
    fit = fit_flow(flow, way, coarse, tool, free_nu=False)
    assert not fit.friction_determined
    assert any(remark.code == "flow_friction_undetermined" for remark in fit.remarks)


@pytest.mark.slow
def test_poisson_ratio_from_how_the_gel_swells(gel: Gel, tool: Tool, press_cache: Path) -> None:
    way = path()
    flow = flow_of(gel, tool, way, 0.003, DEFAULT)
    coarse = gel.with_law(POISSON).with_physics(COARSE)
    fit = fit_flow(flow, way, coarse, tool)
    assert fit.nu_determined
    assert fit.poisson_ratio == pytest.approx(POISSON, abs=0.02)
    assert fit.friction == pytest.approx(FRICTION, rel=0.08)


def test_paths_are_read_and_checked(gel: Gel, tool: Tool) -> None:
    poses = {
        "z_mm": np.array([1.0, -0.2, -0.5, -0.5]),
        "x_mm": np.array([2.0, 2.0, 2.0, 2.5]),
        "y_mm": np.full(4, -1.0),
    }
    way = ToolPath.of_poses(poses, "a.csv")
    np.testing.assert_allclose(way.depth_mm, [0, 0.2, 0.5, 0.5])
    np.testing.assert_allclose(way.shift_mm[:, 0], [0, 0, 0, 0.5])
    assert way.place_mm == (2.0, -1.0)
    with pytest.raises(InputError, match="needs z_mm"):
        ToolPath.of_poses({"x_mm": np.zeros(3)}, "a.csv")
    with pytest.raises(InputError, match="never touches"):
        ToolPath.of_poses({"z_mm": np.ones(3)}, "a.csv")
    flow = MarkerFlow(POINTS, np.zeros((3, 35, 2)), np.ones((3, 35), bool), np.ones((3, 35, 2)))
    with pytest.raises(InputError, match="4 rows, the video 3 frames"):
        fit_flow(flow, way, gel, tool)
    off = MarkerFlow(POINTS + 40, np.zeros((4, 35, 2)), np.ones((4, 35), bool), np.ones((4, 35, 2)))
    with pytest.raises(InputError, match="0 of 35 markers lie on the pad"):
        fit_flow(off, way, gel, tool)
