# SPDX-License-Identifier: Apache-2.0
"""Intervals of a study's figures by their size: each thing that is not known of a gel, once and
twice as large."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from taccel_lab.geometry.block import block_mesh
from taccel_lab.presses.bonded_layer import layer_force_n
from taccel_lab.sensors.parameter_groups.material import modulus_of_shore
from taccel_lab.studies.evaluate import evaluate
from taccel_lab.studies.metrics import METRICS
from taccel_lab.studies.metrics.design_point import DesignPoint
from taccel_lab.studies.presses.press_batch import Simulated
from taccel_lab.studies.presses.press_record import PressRecord
from tests.studies.coarse_presses import coarse

THICK_MM, RADIUS_MM, DEPTH_MM = 2.0, 4.0, 0.5
GIVEN = {"thickness_mm": THICK_MM, "poisson_ratio": 0.47, "friction": 0.5, "young_modulus_mpa": 0.2}
STIFFER = np.array([0.0, 0.02, 0.05, 0.1])
"""Parts that the made-up forces lie over the law by."""


def record() -> PressRecord:
    depth = DEPTH_MM * np.array([0.25, 0.5, 0.75, 1.0])
    count, unused = len(depth), np.zeros(4)
    mesh, force = block_mesh((1, 1, 1), (0.01, 0.01, 0.002)), np.zeros((count, 3))
    force[:, 2] = 3.0 * depth**1.5 * (1 + STIFFER)
    return PressRecord(
        "sphere", f"sphere:{RADIUS_MM:g}", (0.0, 0.0), mesh, None,  # type: ignore[arg-type]
        np.zeros(7), THICK_MM, depth, unused, unused, force, unused, np.zeros((count, 7)),
        np.zeros((count, 0, 3)), unused, unused, unused, count,
    )  # fmt: skip


def stated(
    monkeypatch: pytest.MonkeyPatch, unit_spread: float = 0.0, **design: Any
) -> tuple[float, np.ndarray]:
    """The figure of a design [N/mm^1.5], and its interval less it."""
    monkeypatch.setattr(evaluate, "_recent", {})
    made = [Simulated(record(), 0.0)]
    monkeypatch.setattr(evaluate, "simulate", lambda batch, device: made)
    known = {name: value for name, value in {**GIVEN, **design}.items() if value is not None}
    press = coarse("sphere", indenters=(f"sphere:{RADIUS_MM:g}",), steps=4)
    (found,) = evaluate.evaluate_designs(
        [DesignPoint("one", "flat_pad", known)], [press], [METRICS["stiffness_a"]],
        unit_spread=unit_spread,
    )  # fmt: skip
    value = found.figures["stiffness_a"]
    assert value is not None, found.causes
    return value, np.array(found.intervals["stiffness_a"], dtype=float) - value


def layer_n(nu: float) -> float:
    depth = np.array([DEPTH_MM])
    return float(layer_force_n("sphere", depth, RADIUS_MM, THICK_MM, nu)[0])


def units(spread: float) -> tuple[float, float]:
    off = 1.96 * math.log1p(spread)
    return off, off


SHORE = modulus_of_shore("A", 20.0)
CAUSES = {
    "units": ({"unit_spread": 0.1}, units(0.1)),
    "units twice": ({"unit_spread": 0.2}, units(0.2)),
    "hardness": (
        {"shore_a": 20.0, "young_modulus_mpa": None},
        (math.log(SHORE.pa / SHORE.low_pa), math.log(SHORE.high_pa / SHORE.pa)),
    ),
    "Poisson's ratio": ({"poisson_ratio": None}, (0.0, math.log(layer_n(0.499) / layer_n(0.46)))),
}


@pytest.mark.parametrize("cause", CAUSES)
def test_figures_of_studies_hold_each_cause_by_its_size(cause, monkeypatch) -> None:
    design, logs = CAUSES[cause]
    known, fit = stated(monkeypatch)
    value, off = stated(monkeypatch, **design)
    np.testing.assert_allclose(fit[0], -fit[1])
    factors = np.exp([-logs[0], logs[1]])
    share = np.hypot(fit / known, factors - 1) * [-1, 1]
    np.testing.assert_allclose(off / value, share, rtol=2e-3)


def test_the_fits_own_interval_is_that_of_student(monkeypatch) -> None:
    """Twice what forces lie over the law is twice the interval; t of three degrees is 3.182."""
    value, off = stated(monkeypatch)
    basis = (DEPTH_MM * np.array([0.25, 0.5, 0.75, 1.0])) ** 1.5
    rest = record().force_n[:, 2] - value / (0.2e6 / evaluate.REFERENCE_PA) * basis
    sigma = math.sqrt(rest @ rest / 3 / (basis @ basis)) * 0.2e6 / evaluate.REFERENCE_PA
    np.testing.assert_allclose(off, [-3.1824 * sigma, 3.1824 * sigma], rtol=1e-4)
