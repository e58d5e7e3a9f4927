# SPDX-License-Identifier: Apache-2.0
"""What the suites error, press_accuracy, scaling and skips measure, on their smallest scenes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taccel_lab.benchmarks import error, press_accuracy, scaling, skips
from taccel_lab.benchmarks.command_line import main
from taccel_lab.benchmarks.report.plots import draw_error, draw_scaling
from taccel_lab.benchmarks.report.sections import SECTIONS, VERIFICATION
from taccel_lab.benchmarks.results import read_result
from taccel_lab.benchmarks.shear_press import DEPTH_M
from taccel_lab.scene import Element

COARSE = replace(error.DEFAULT, layers=2)
FINER = replace(COARSE, dhat_m=2e-6, friction_eps_m=1e-7, relative_tolerance=1e-6)
"""What the suite takes for settled, too."""


@pytest.fixture(scope="module")
def presses() -> error.Presses:
    return error.Presses("cpu", 2)


def test_an_error_row(presses: error.Presses) -> None:
    row = error.measure(error.Row("dhat", "20 um", COARSE, FINER), presses)
    loose = replace(COARSE, relative_tolerance=0.1)
    other = error.measure(error.Row("tolerance", "0.1", loose, COARSE), presses)
    assert row["ms_per_step"]["count"] == 2
    assert row["residual"]["worst_over_contact_force"] <= 1e-4
    assert other["residual"]["worst_over_contact_force"] > 1e-4
    assert 0 < row["error"]["height_rms_um"] <= row["error"]["height_max_um"] < 20
    assert 0 < row["error"]["marker_rms_um"] <= row["error"]["marker_max_um"] < 20
    # Without any difference there is no error.
    same = error.measure(error.Row("dhat", "same", COARSE, COARSE), presses)
    assert max(same["error"].values()) == 0
    assert not other["is_default"]
    assert error.measure(error.Row("mesh", "", error.DEFAULT, COARSE), presses)["is_default"]


def test_the_error_of_the_contact_range_is_that_of_a_deeper_press(presses: error.Presses) -> None:
    """The gap of contact is a part of its range, and acts like as much more of depth, which Hertz's
    force takes to the power of 1.5: below the whole range's error, and in proportion to it."""
    found = {}
    for dhat_m in (2e-5, 1e-5):
        press = replace(FINER, dhat_m=dhat_m)
        row = error.measure(error.Row("dhat", "", press, FINER), presses)
        whole = 150 * (dhat_m - FINER.dhat_m) / DEPTH_M
        assert 0.2 * whole < row["error"]["force_percent"] < whole
        found[dhat_m] = row["error"]
        assert found[dhat_m]["height_rms_um"] < 1e6 * dhat_m
    expected = (1e-5 - FINER.dhat_m) / (2e-5 - FINER.dhat_m)
    for name in ("force_percent", "height_rms_um", "marker_rms_um"):
        assert found[1e-5][name] / found[2e-5][name] == pytest.approx(expected, rel=0.15)


def test_presses_of_a_sensor_are_compared_with_a_finer_mesh(tmp_path: Path) -> None:
    words = ["press_accuracy", "--quick", "--families", "flat_pad", "--out", str(tmp_path)]
    assert main([*words, "--tools", "ball 1.5"]) == 0
    document = read_result(tmp_path / "press_accuracy.json")
    shallow, deep = document["rows"]
    assert (shallow["depth_mm"], deep["depth_mm"]) == press_accuracy.DEPTHS_MM
    for row in (shallow, deep):
        assert row["cause"] == "" and row["nodes"] < row["converged_nodes"]
        assert 0 < abs(row["force_error"]) < row["estimated_force_error"] < 0.2
        assert 0 < row["height_rms_m"] < row["estimated_height_rms_m"] < 2e-5
        assert row["residual"] <= 1e-4
    for row in (shallow, deep):
        row["setting"] = "default"
    deep["cause"] = "unsolved"
    text = VERIFICATION["press accuracy"]({"press_accuracy": [document | {"file": "x.json"}]})
    assert "| ball 1.5, 0.1 mm | 1 |" in text and "1 of 2 cases did not converge" in text
    assert main([*words, "--tools", "hammer"]) == 2
    assert main(["press_accuracy", "--families", "no_such", "--out", str(tmp_path)]) == 2


def test_every_tool_meets_every_material() -> None:
    cases = list(press_accuracy.all_cases())
    for tool in press_accuracy.TOOLS:
        met = {(c.poisson_ratio, c.friction) for c in cases if c.tool == tool}
        assert met == set(press_accuracy.MATERIALS)
        assert press_accuracy.Case("flat_pad", tool, 0.1, 0.4, 0.0).indenter().contact(0.1)


def front_row(
    ms: float, total: float, own: float, layers: int = 4, default: bool = False, markers: float = 1
) -> Any:
    """A row with these figures."""
    return {
        "group": "front",
        "is_default": default,
        "settings": {
            "element": "linear",
            "layers": layers,
            "dhat_m": 1e-6 * ms,
            "relative_tolerance": 1e-4,
            "friction_eps_m": 1e-6,
            "solver": [],
        },
        "ms_per_step": {"median": ms},
        "error": {"force_percent": total, "height_rms_um": total, "marker_rms_um": markers},
        "settings_error": {"force_percent": own, "height_rms_um": own, "marker_rms_um": markers},
    }


def test_the_judge_says_whether_the_default_pays() -> None:
    rows = [
        front_row(10, 30, 4, default=True),
        front_row(14, 28, 1),
        front_row(5, 40, 8),
        front_row(8, 25, 2, layers=2),
    ]
    verdict = error.judge(rows)
    assert verdict["own_mesh"]["default_is_on_it"]
    near = verdict["own_mesh"]["best_nearby"]
    assert (near["force_percent"], near["times_as_long"]) == (1, pytest.approx(1.4))
    everything = verdict["all_meshes"]
    assert not everything["default_is_on_it"]
    assert everything["better_than_the_default"] == [
        "linear, 2 layers, dhat 8 um, tolerance 0.0001"
    ]
    assert len(everything["front"]) == 2
    # Worse markers keep a faster row from dominating.
    rows[3] = front_row(8, 25, 2, layers=2, markers=9)
    assert error.judge(rows)["all_meshes"]["default_is_on_it"]
    assert error.judge([]) == {}
    run = {"device": "cuda", "date": "", "commit": "", "packages": {}}
    document = {"rows": [], "front": verdict, "run": run, "file": "error.json", "complete": True}
    text = SECTIONS["error"]({"error": [document]})
    assert "own mesh: the default is on the front" in text
    assert "**not** on the front; faster and better are: linear, 2 layers" in text


def test_rows_cover_what_is_varied() -> None:
    groups = {row.group for row in error.all_rows(quick=False, device="cpu")}
    assert {"mesh", "dhat", "tolerance", "friction eps", "dt", "front"} < groups
    fronts = [
        row.press for row in error.all_rows(quick=False, device="cpu") if row.group == "front"
    ]
    # A gel too large to be factored is not offered what factors it.
    choices = dict(error.solver_choices("cpu"))
    assert choices == {"linear_method": "ssor"}
    assert error.DEFAULT in fronts
    assert {press.element for press in fronts} == set(Element)


def test_a_scaling_row_and_its_fit() -> None:
    points = list(
        scaling.all_points(
            scaling.Scaling(envs=(1,), cells=(3,), punch_mm=(4,), sensors=(2,), steps=2)
        )
    )
    assert [p.series for p in points] == ["environments", "nodes", "contacts", "sensors"]
    row = scaling.measure(points[2], "cpu", 1)
    assert row["size"] == row["contacts"] > 10
    assert row["residual"]["unconverged"] == 0
    rows = [
        row | {"size": size, "ms_per_step": {"median": 2.0 * size}, "memory_mib": 3 * size**0.5}
        for size in (10, 20, 40, 80)
    ]
    fit = scaling.fit(rows)["contacts"]
    assert (fit["time"], fit["memory"]) == (pytest.approx(1.0), pytest.approx(0.5))
    figure = draw_scaling({"rows": rows, "fits": scaling.fit(rows)})
    assert len(figure.axes) == 2


def test_a_skip_row() -> None:
    found = {skip.name: skip for skip in skips.all_skips("generated")}
    assert {"no friction", "no affine body", "quasi-static", "no signal"} < set(found)
    assert {"settled environments", "kinematic instead of affine"} < set(found)
    skip = found["no friction"]
    short = replace(skip, on=replace(skip.on, steps=6), off=replace(skip.off, steps=6))
    row = skips.measure(short, "cpu", 1)
    assert row["on"]["friction_lags_mean"] > row["off"]["friction_lags_mean"]
    assert row["on"]["residual"]["unconverged"] == row["off"]["residual"]["unconverged"] == 0
    on, off = (row[name]["ms_per_step"]["median"] for name in ("on", "off"))
    assert row["saved_percent"] == pytest.approx(100 * (1 - off / on))


def test_only_one_environment_moves_when_the_others_are_settled() -> None:
    found = {skip.name: skip for skip in skips.all_skips("generated")}
    bench = found["settled environments"].off.bench
    targets = bench.targets(9)
    np.testing.assert_array_equal(targets[0], bench.path[9])
    np.testing.assert_array_equal(targets[1:], np.repeat(bench.path[:1], 15, axis=0))


def test_errors_are_drawn() -> None:
    rows = [front_row(10, 1, 1, default=True), front_row(20, 0.5, 0.5)]
    figure = draw_error({"rows": rows})
    legend = figure.axes[0].get_legend()
    assert legend is not None
    labels = [text.get_text() for text in legend.get_texts()]
    assert labels == ["linear, 4 layers", "front", "default"]
