# SPDX-License-Identifier: Apache-2.0
"""``evaluate_designs``: shared simulations, isolated failures, what is kept."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taccel_lab.envs import PressEnv
from taccel_lab.errors import InputError
from taccel_lab.output import to_jsonable
from taccel_lab.solvers import EnvStatus, StepReport
from taccel_lab.studies import press_batch
from taccel_lab.studies.design_point import DesignPoint
from taccel_lab.studies.evaluate import evaluate_designs
from taccel_lab.studies.metrics import METRICS
from taccel_lab.studies.presses import STANDARD_PRESSES
from tests.studies.coarse_presses import coarse

SPHERE = coarse("sphere", steps=3)
SIMPLE = [
    replace(METRICS[name], load_n=0.3)
    for name in ("stiffness_secant", "bond_stress", "sensitivity_um")
]


def gelsight(name: str, **parameters: object) -> DesignPoint:
    return DesignPoint(name, "gelsight", dict(parameters))


def test_designs_share_what_is_the_same(tmp_path: Path) -> None:
    told: list[tuple[str, int, int]] = []
    results = evaluate_designs(
        [
            gelsight("a"),
            gelsight("b", young_modulus_mpa=0.3),
            gelsight("c", thickness_mm=4),
            gelsight("d", density_kg_m3=1200, young_modulus_mpa=0.3),
        ],
        [SPHERE],
        SIMPLE,
        progress=lambda *values: told.append(values),
        folder=tmp_path,
    )
    a, b, c, d = results
    assert [result.simulations for result in results] == [1, 0, 1, 0]
    assert all(result.causes == {} for result in results)
    assert told == [("meshed", 0, 2), ("press sphere", 2, 2)]
    force_a, force_b = (np.array(r.curves["sphere"][0]["force_n"]) for r in (a, b))
    assert force_b == pytest.approx(2 * force_a)
    assert d.figures == b.figures
    # At the same load the stiffer gel moves less, and the thinner one too at the same depth.
    assert b.figures["sensitivity_um"] < a.figures["sensitivity_um"]  # type: ignore[operator]
    assert c.figures["stiffness_secant"] != a.figures["stiffness_secant"]
    assert all(result.seconds > 0 for result in results)
    kept = np.load(tmp_path / "b" / "press_sphere.npz")
    assert kept["force_n"] == pytest.approx(force_b)
    assert kept["contact_moved_m"].shape == (3, len(kept["contact_rest_m"]), 3)
    assert kept["contact_faces"].max() < len(kept["contact_rest_m"])
    curves = json.loads((tmp_path / "b" / "presses.json").read_text())
    assert curves == to_jsonable(b.curves)


def test_a_design_that_cannot_be_built_leaves_the_others_alone() -> None:
    good, bad, unknown = evaluate_designs(
        [gelsight("good"), gelsight("bad", thickness_mm=0.5), DesignPoint("x", "gelsite", {})],
        [SPHERE],
        SIMPLE,
    )
    assert None not in good.figures.values() and good.causes == {}
    for lost, words in ((bad, "thickness_mm = 0.5 is below its bound"), (unknown, "gelsite")):
        assert set(lost.figures.values()) == {None} and set(lost.figures) == set(good.figures)
        assert words in lost.causes["design"]
        assert lost.causes["stiffness_secant"] == lost.causes["design"]
        assert lost.simulations == 0


def test_a_press_that_cannot_be_set_up_leaves_the_others_alone() -> None:
    away = coarse("sphere", name="away", steps=2, places=((1.0, 1.0),))
    narrow = gelsight("narrow", length_x_mm=12, length_y_mm=12)
    (result,) = evaluate_designs([narrow], [away, SPHERE], SIMPLE)
    assert None not in result.figures.values()
    assert list(result.causes) == ["press away"]
    assert list(result.curves) == ["sphere"]


def test_a_press_that_does_not_converge_leaves_its_batch_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The second environment of a batch is made to fail in the second of three steps."""
    stays: list[list[bool]] = []

    class Failing(PressEnv):
        def try_to(self, *args: Any, stay: np.ndarray, **more: Any) -> StepReport:
            stays.append(stay.tolist())
            report = super().try_to(*args, stay=stay, **more)
            if len(stays) == 2:
                report.status[1] = EnvStatus.LINE_SEARCH
            return report

    monkeypatch.setattr(press_batch, "PressEnv", Failing)
    easy, hard = evaluate_designs(
        [gelsight("easy"), gelsight("hard", thickness_mm=6)],
        [SPHERE],
        [METRICS["bond_stress"]],
    )
    assert stays == [[False, False], [False, False], [False, True]]
    assert easy.causes == {} and easy.figures["bond_stress"] is not None
    assert len(easy.curves["sphere"][0]["depth_mm"]) == 3
    cause = hard.causes["press sphere"]
    assert cause.startswith("step 2 of 3: the press at (0, 0) mm") and "LINE_SEARCH" in cause
    assert hard.figures["bond_stress"] is None
    assert hard.causes["bond_stress"] == f"press sphere: {cause}"
    assert len(hard.curves["sphere"][0]["depth_mm"]) == 1


def test_missing_presses_leave_figures_without_value() -> None:
    names = ("edge_sharpness", "stiffness_secant")
    (result,) = evaluate_designs([gelsight("a")], [SPHERE], [METRICS[name] for name in names])
    assert result.figures["edge_sharpness"] is None
    assert result.causes == {"edge_sharpness": "the press 'edge' was not asked for"}


def test_ids_and_names_must_differ() -> None:
    with pytest.raises(InputError, match="ids of their own"):
        evaluate_designs([gelsight("a"), gelsight("a")], [SPHERE], SIMPLE)
    with pytest.raises(InputError, match="names of their own"):
        evaluate_designs([gelsight("a")], [SPHERE, SPHERE], SIMPLE)


@pytest.mark.slow
def test_a_whole_design() -> None:
    (result,) = evaluate_designs(
        [gelsight("a")], list(STANDARD_PRESSES.values()), list(METRICS.values())
    )
    unknown = {name for name, value in result.figures.items() if value is None}
    # The camera's aperture is not published.
    assert unknown == {"depth_of_field"}
    assert result.simulations == 15
    figures = {name: value for name, value in result.figures.items() if value is not None}
    assert 0.4 < figures["stiffness_secant"] < 0.8
    assert figures["uniformity_force"] < 5
    assert figures["hysteresis_press"] < 2
    assert 0.1 < figures["grating_modulation"] < 0.6
    assert figures["two_point_resolution"] < 1.0
