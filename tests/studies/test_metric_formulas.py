# SPDX-License-Identifier: Apache-2.0
"""Metrics on made-up presses whose figures are known."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.sensors.families.gelsight import GelSightParameters
from taccel_lab.studies.metrics import METRICS, NoFigure, surface
from taccel_lab.studies.metrics.evidence import Evidence, at_load, contact_radius_mm, dent_mm
from taccel_lab.studies.metrics.shear import lost_part
from taccel_lab.studies.metrics.surface import RESOLVED, contrast, rise_width, sizes, variation
from taccel_lab.studies.presses.press_record import PressRecord
from taccel_lab.studies.presses.standard import STANDARD_PRESSES
from tests.studies.coarse_presses import down_record, fake_record, sphere_on_gelsight

GELSIGHT = GelSightParameters()


def figure(name: str, *records: PressRecord, load_n: float = 0.5) -> float:
    metric = dataclasses.replace(METRICS[name], load_n=load_n)
    return metric.read(Evidence(GELSIGHT, {metric.presses[0]: list(records)})).value


def test_the_registry() -> None:
    assert len(METRICS) >= 25
    for name, metric in METRICS.items():
        assert metric.name == name and metric.unit and metric.description
        assert metric.better in ("higher", "lower", "none")
        assert set(metric.presses) <= set(STANDARD_PRESSES)


@pytest.mark.parametrize(
    ("read", "message"),
    [
        (lambda: at_load(down_record([0.1, 0.2], [0.3, 0.4]), np.ones(2), 0.5),
         r"press sphere ends at 0\.4 N, below the load of 0\.5 N"),
        (lambda: at_load(down_record([0.1, 0.2], [0.3, 0.4]), np.ones(2), 0.02),
         r"first step of press sphere has 0\.3 N"),
        (lambda: at_load(down_record([0.1, 0.2], [0.3, 0.3]), np.ones(2), 0.2), "does not rise"),
        (lambda: figure("stiffness_punch", down_record([0.1, 0.2], [0.1, 0.2])), "three are"),
        (lambda: figure("force_range", down_record([0.3], [0.4])), "one step alone"),
        (lambda: figure("force_range", down_record([2.4, 2.5], [0.3, 0.4], thickness_mm=20.0)),
         r"bottoms at 8 mm, .* ends at 2\.5 mm"),
        (lambda: figure("contact_area", fake_record(cause="step 2 of 6: no luck")),
         "press sphere: step 2 of 6: no luck"),
        (lambda: METRICS["contact_area"].compute(Evidence(GELSIGHT, {})),
         "'sphere' was not asked for"),
        (lambda: METRICS["contact_area"].compute(Evidence(GELSIGHT, {}, {"sphere": "too near"})),
         "press sphere: too near"),
        (lambda: rise_width(np.linspace(-1, 1, 101), 1 - 0.5 * np.abs(np.linspace(-1, 1, 101))),
         "does not fall below 10%"),
        (lambda: lost_part(np.arange(3.0), np.ones(3)), "no loop"),
        (lambda: lost_part(WAY, np.zeros(5)), "takes no work"),
    ],
)  # fmt: skip
def test_presses_without_a_figure_say_why(read: Callable[[], object], message: str) -> None:
    with pytest.raises(NoFigure, match=message):
        read()


@pytest.mark.thorough
@given(
    power=st.floats(0.3, 2.5), factor=st.floats(0.01, 10), load=st.floats(0.06, 1.0),
)  # fmt: skip
def test_power_laws_are_read_exactly(power: float, factor: float, load: float) -> None:
    force = np.array([0.05, 0.2, 0.5, 1.0])
    record = down_record([0.1, 0.2, 0.3, 0.4], force.tolist())
    read = at_load(record, factor * force**power, load)
    assert read == pytest.approx(factor * load**power, rel=1e-9)


def test_stiffness_of_hertz() -> None:
    depth = np.array([0.2, 0.4, 0.6, 0.8])
    record = down_record(depth.tolist(), (2.0 * depth**1.5).tolist())
    at = (0.5 / 2) ** (2 / 3)
    assert figure("stiffness_secant", record) == pytest.approx(0.5 / at)
    assert figure("stiffness_roller", record) == pytest.approx(0.5 / at)
    assert figure("stiffness_tangent", record) == pytest.approx(1.5 * 0.5 / at, rel=0.01)


def test_stiffness_of_a_punch_starts_at_no_depth_and_keeps_to_its_steps() -> None:
    depth = np.array([0.1, 0.2, 0.3, 0.4])
    record = down_record(depth.tolist(), (1.3 * depth + 0.4 * depth**2).tolist())
    assert figure("stiffness_punch", record) == pytest.approx(1.3)
    # Pressed with friction 0.2 into 1 mm of incompressible gel by coarse elements, whose forces
    # are up to 9 % beside a line. Closed form without friction: 9.5 N/mm, stuck: 13 to 14.
    record = down_record([0.0667, 0.1333, 0.2], [0.894, 1.6898, 2.9147])
    assert 11.0 < figure("stiffness_punch", record) < 14.0


def test_force_range() -> None:
    depth = np.linspace(0.25, 2.5, 10)
    modulus = GELSIGHT.young_modulus_mpa / (1 - GELSIGHT.poisson_ratio**2)
    hertz = 4 / 3 * modulus * math.sqrt(3) * depth**1.5
    # 40 % of 5 mm are 2 mm.
    record = down_record(depth.tolist(), hertz.tolist(), thickness_mm=5.0)
    assert figure("force_range", record) == pytest.approx(hertz[7])
    # A thick gel was not pressed that deep.
    thick = dataclasses.replace(record, thickness_mm=9.0)
    assert figure("force_range", thick) == pytest.approx(hertz[-1] * (3.6 / 2.5) ** 1.5)


def test_readings_of_a_real_press() -> None:
    record = sphere_on_gelsight()
    dent = dent_mm(record)
    # Nodes of coarse elements hang below a ball that touches the middles of their edges.
    assert dent == pytest.approx(record.depth_mm, abs=0.08)
    radius = contact_radius_mm(record)
    assert (np.diff(radius) > 0).all() and radius[-1] < 3.0
    load = float(record.normal_n[-1])
    assert figure("contact_area", record, load_n=load) == pytest.approx(math.pi * radius[-1] ** 2)
    px = figure("sensitivity_px", record, load_n=load)
    assert px == pytest.approx(radius[-1] / 0.0295 / load)
    assert figure("sensitivity_um", record, load_n=load) == pytest.approx(dent[-1] * 1e3 / load)
    assert 0 < figure("sensitivity_marker_px", record, load_n=load) * load * 0.0295 < 1.0
    expected = record.bond_peak_pa[-1] * 1e-3
    assert figure("bond_stress", record, load_n=load) == pytest.approx(expected)


def test_virtual_markers_cover_the_view() -> None:
    points = Evidence(GELSIGHT, {}).marker_points_mm()
    assert len(points) == 19 * 15
    assert np.abs(points).max(axis=0) == pytest.approx([9.0, 7.0])
    assert [0.0, 0.0] in points.tolist()


@given(width=st.floats(0.2, 2.0), peak=st.floats(0.01, 1.0))
def test_rise_of_an_exponential_dent(width: float, peak: float) -> None:
    x = np.linspace(-8, 8, 1601)
    dent = peak * np.exp(-np.abs(x) / width)
    assert rise_width(x, dent) == pytest.approx(width * math.log(9), rel=1e-3)


def test_contrast() -> None:
    x = np.linspace(-2, 2, 401)
    two = np.exp(-((np.abs(x) - 1) ** 2) / 0.02)
    assert contrast(x, two, 1.0) == pytest.approx(1.0, abs=1e-3)
    assert contrast(x, two + 1, 1.0) == pytest.approx(0.5, abs=1e-3)
    assert contrast(x, np.ones(401), 1.0) == 0.0
    assert contrast(x, np.zeros(401), 1.0) == 0.0
    assert sizes("pair:0.25x1.2") == [0.25, 1.2]


WAY = np.array([0.0, 1.0, 2.0, 1.0, 0.0])


def test_lost_work_and_variation() -> None:
    assert lost_part(WAY, WAY) == 0.0
    # Coulomb's force turns round with the motion; the trapezoid at the turn has half a step of it.
    assert lost_part(WAY, np.array([1.0, 1.0, 1.0, -1.0, -1.0])) == pytest.approx(1.5)
    assert lost_part(-WAY, -np.array([0.0, 2.0, 4.0, 1.0, 0.0])) == pytest.approx(0.25)
    assert variation([2.0, 2.0, 2.0]) == 0.0
    assert variation([1.0, 2.0, 3.0]) == pytest.approx(0.5)


@pytest.mark.parametrize(("gap_mm", "floor"), [(0.05, True), (3.0, False)])
def test_pins_count_as_resolved_from_two_pixels_on(
    gap_mm: float, floor: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A gel that keeps two dents apart at any distance is read by a camera that does not."""
    apart = 2 * 0.05 + gap_mm

    def two_dents(record: PressRecord, half_mm: float) -> tuple[np.ndarray, np.ndarray]:
        x = np.linspace(-half_mm, half_mm, 401)
        return x, -np.exp(-(((np.abs(x) - apart / 2) / (apart / 8)) ** 2))

    monkeypatch.setattr(surface, "profile_mm", two_dents)
    record = fake_record(press="pairs", indenter=f"pins:0.05x{gap_mm}")
    two_px = 2 * Evidence(GELSIGHT, {"pairs": [record]}).mm_per_px
    between = RESOLVED * apart
    assert figure("two_point_resolution", record) == pytest.approx(
        two_px if floor else between, rel=1e-3
    )
    assert (between < two_px) == floor
