# SPDX-License-Identifier: Apache-2.0
"""Measured curves: loadings, what tables are read or refused, the fit finds what was put in."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.errors import InputError
from taccel_lab.studies.design_row import DesignRow
from taccel_lab.studies.loading import find_touch, first_loading
from taccel_lab.studies.measured_curve import read_curve
from taccel_lab.studies.measured_fit import FittedGel, fit_measured, press_table
from taccel_lab.studies.spec import Measured, spec_of
from taccel_lab.studies.study import Study, default_kit, make_study

# Loadings among what force testers record ---------------------------------------------------------


DOWN = np.linspace(0.0, 0.4, 41)
UP = DOWN[::-1]


def test_cycles_leave_the_first_way_down() -> None:
    keep, remark = first_loading(np.concatenate([DOWN, UP, DOWN, UP]))
    assert keep.tolist() == list(range(41))
    assert remark == "123 rows of ways back and later cycles left out"


def test_of_growing_cycles_what_goes_deeper_is_kept() -> None:
    depth = np.concatenate([0.3 * DOWN, 0.3 * UP, 0.6 * DOWN, 0.6 * UP, DOWN])
    keep, _ = first_loading(depth)
    assert depth[keep].max() == 0.4
    assert set(keep.tolist()) >= set(range(41))
    # Of the later ways down no row that was passed before, but for noise.
    assert depth[keep[keep > 81]].min() > 0.3 * 0.4 - 0.05 * 0.4 - 1e-9


def test_rows_without_an_order_are_sorted() -> None:
    keep, remark = first_loading(np.random.default_rng(0).permutation(DOWN))
    assert len(keep) == 41 and "sorted" in remark
    keep, remark = first_loading(UP)
    assert keep.tolist() == list(range(40, -1, -1)) and "sorted" in remark
    assert first_loading(DOWN) == (pytest.approx(np.arange(41)), "")


@settings(max_examples=40, deadline=None)
@given(
    air=st.floats(0.15, 8.0), power=st.floats(1.0, 2.5), seed=st.integers(0, 99),
    zero=st.floats(-5.0, 5.0), drift=st.floats(-0.1, 0.1),
)  # fmt: skip
def test_the_touch_and_the_load_cell_s_zero_are_found(
    air: float, power: float, seed: int, zero: float, drift: float
) -> None:
    """Of 300 rows, with noise of 2 % and of 0.3 % of the largest force."""
    rng = np.random.default_rng(seed)
    depth = np.linspace(1.0, 1.4 + air, 300)
    touch = 1.0 + air
    pressed = np.clip((depth - touch) / 0.4, 0.0, None) ** power
    noisy = pressed * (1 + 0.02 * rng.normal(size=300)) + 0.003 * rng.normal(size=300)
    found = find_touch(depth, noisy + zero + drift * (depth - touch) / (0.4 + air))
    assert found is not None
    assert found.depth_mm == pytest.approx(touch, abs=0.03)
    # In contact the drift stands still in what was put in as well as in what is taken off.
    assert found.force_n == pytest.approx(zero, abs=0.02)


@settings(max_examples=40, deadline=None)
@given(power=st.floats(1.0, 2.5), rows=st.integers(5, 300), seed=st.integers(0, 99))
def test_a_record_that_begins_at_the_touch_is_left_alone(
    power: float, rows: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    depth = np.linspace(0.0, 0.4, rows)
    force = depth**power * (1 + 0.02 * rng.normal(size=rows))
    found = find_touch(depth, force)
    assert found is None or (found.depth_mm < 0.1 and abs(found.force_n) < 0.03 * force.max())


# Curves -------------------------------------------------------------------------------------------


DEPTH = np.linspace(0.0, 0.4, 41)


def curve(folder: Path, text: str) -> Any:
    file = folder / "curve.csv"
    file.write_text(text, encoding="utf-8")
    return read_curve(Measured(file=str(file), indenter="sphere:2"))


def table(head: str, *columns: np.ndarray) -> str:
    rows = [",".join(f"{v:.9g}" for v in row) for row in zip(*columns, strict=True)]
    return "\n".join([head, *rows]) + "\n"


@pytest.mark.parametrize(
    ("head", "depth", "force"),
    [
        ("depth_mm,force_n", 1.0, 1.0), ("Depth (um),Force [mN]", 1e3, 1e3),
        ("Displacement [m],load_gf", 1e-3, 1 / 9.80665e-3),
    ],
)  # fmt: skip
def test_units_of_the_header_are_taken(
    tmp_path: Path, head: str, depth: float, force: float
) -> None:
    found = curve(tmp_path, table(head, DEPTH * depth, DEPTH**1.5 * force))
    assert found.depth_mm == pytest.approx(DEPTH)
    assert found.force_n == pytest.approx(DEPTH**1.5)
    assert found.remarks == ()


def test_rows_that_stand_twice_count_once(tmp_path: Path) -> None:
    once = curve(tmp_path, table("depth_mm,force_n", DEPTH, DEPTH**1.5))
    twice = curve(tmp_path, table("depth_mm,force_n", *np.repeat([DEPTH, DEPTH**1.5], 2, axis=1)))
    assert np.array_equal(once.depth_mm, twice.depth_mm)
    assert np.array_equal(once.force_n, twice.force_n)


@pytest.mark.parametrize(
    ("depth", "force", "message"),
    [
        (DEPTH**1.5, DEPTH, "columns swapped"),
        (DEPTH, np.full(len(DEPTH), 1.0), "does not rise with depth_mm"),
        (DEPTH, DEPTH**1.5 + 1.0, "zero is off"),
    ],
)
def test_what_no_press_of_a_ball_can_be(
    tmp_path: Path, depth: np.ndarray, force: np.ndarray, message: str
) -> None:
    with pytest.raises(InputError, match=rf"curve\.csv: .*{message}"):
        curve(tmp_path, table("depth_mm,force_n", depth, force))


def test_rows_are_put_in_order_and_lost_ones_told(tmp_path: Path) -> None:
    order = np.random.default_rng(0).permutation(len(DEPTH))
    text = table("depth_mm,force_n,contact_diameter_mm", *(v[order] for v in 3 * [DEPTH]))
    found = curve(tmp_path, text + "nan,1,1\n0.2,,1\n")
    assert found.depth_mm == pytest.approx(DEPTH)
    assert found.contact_diameter_mm == pytest.approx(DEPTH)
    assert found.remarks == (
        "2 rows without a number left out", "rows were not in order of depth; sorted",
    )  # fmt: skip


def test_the_way_back_is_left_out(tmp_path: Path) -> None:
    there_and_back = np.concatenate([DEPTH, DEPTH[-2::-1]])
    found = curve(tmp_path, table("depth_mm,force_n", there_and_back, there_and_back))
    assert len(found.depth_mm) == len(DEPTH)
    assert found.remarks == ("40 rows of the way back left out",)


@pytest.mark.parametrize(
    ("head", "depth", "force"),
    [
        ("z (\u00b5m),Load [gf]", 1e3, 1 / 9.80665e-3), ("Position (mm),Fz_N", 1.0, 1.0),
        ("Depth in mm,Force in N", 1.0, 1.0), ("Extension,Load\n(mm),(kN)", 1.0, 1e-3),
        ("Indentation Depth (mm),Normal Force (N)", 1.0, 1.0), ("depth/mm,force_z/N", 1.0, 1.0),
    ],
)  # fmt: skip
def test_headers_as_testers_write_them(
    tmp_path: Path, head: str, depth: float, force: float
) -> None:
    found = curve(tmp_path, table(head, DEPTH * depth, DEPTH**1.5 * force))
    assert found.depth_mm == pytest.approx(DEPTH)
    assert found.force_n == pytest.approx(DEPTH**1.5)


def test_other_forces_beside_the_normal_one_do_not_count(tmp_path: Path) -> None:
    sides = 0.1 * DEPTH
    found = curve(tmp_path, table("depth_mm,force_x_n,force_z_n", DEPTH, sides, DEPTH))
    assert found.force_n == pytest.approx(DEPTH)


def test_a_search_through_air_is_taken_off(tmp_path: Path) -> None:
    """A stage that comes down from 14.6 mm and touches at 12.5 mm; a load cell that drifts."""
    travel = np.linspace(0.0, 2.5, 501)
    force = 0.8 * np.clip(travel - 2.1, 0.0, None) ** 1.9
    drifting = force + 0.02 + 0.002 * np.minimum(travel, 2.1)
    found = curve(tmp_path, table("z_mm,force_n", 14.6 - travel, drifting))
    assert found.touch_mm == pytest.approx(-12.5, abs=0.03)
    assert found.depth_mm[-1] == pytest.approx(0.4, abs=0.03)
    assert found.force_n[-1] == pytest.approx(force[-1], rel=0.01)
    assert found.remarks[0] == "positions fall as the force rises: turned about"
    assert "rows in air, whose 0.024" in found.remarks[1]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (table("depth_mm,force_n", 12.3 - DEPTH, DEPTH), "forces fall on the way"),
        (table("depth_mm,force_n", DEPTH - 12.3, DEPTH), "no touch is seen in them"),
        ("depth_mm,power_w\n1,2\n", "lacks a column of force or load"),
        (table("depth,force_n", DEPTH, DEPTH), "unit of the column 'depth' is not known"),
        (table("depth_furlong,force_n", DEPTH, DEPTH), "allowed: depth_mm, depth_um"),
        (table("depth_mm,force_lbf", DEPTH, DEPTH), "allowed: force_n, force_mn"),
        (table("depth_mm,depth_um,force_n", DEPTH, DEPTH, DEPTH), "which one counts"),
        (table("depth_mm,force_n", -DEPTH, DEPTH), "reverse the sign"),
        (table("depth_mm,force_n", DEPTH, -DEPTH), "reverse the sign"),
        (table("depth_mm,force_n", DEPTH, DEPTH - 0.05), "more than noise"),
        (table("depth_mm,force_n", DEPTH * 1e3, DEPTH), "another unit"),
        (table("depth_mm,force_n", DEPTH, DEPTH * 1e4), "another unit"),
        (table("depth_mm,force_n", DEPTH[:3], DEPTH[:3]), "has 3 rows with numbers"),
        ("depth_mm,force_n\n1,x\n", "'x' is not a finite number"),
        ("", "is empty"),
    ],
)
def test_what_cannot_be_meant_is_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        curve(tmp_path, text)
    assert "curve.csv" in str(caught.value)


LAW_DEPTH = np.linspace(0.05, 0.5, 8)
LAW_FORCE = 0.8 * LAW_DEPTH**1.9


def test_a_press_is_read_as_a_table_beyond_its_steps_by_their_power_law() -> None:
    press = {"depth_mm": LAW_DEPTH.tolist(), "force_n": [[0.0, 0.0, f] for f in LAW_FORCE]}
    depth = np.array([-0.1, 1e-3, 0.07, 0.5, 1.0])
    found = press_table(press, 2e5).force_n(depth, 2e5, 0.5)
    assert found == pytest.approx(0.8 * np.clip(depth, 0.0, None) ** 1.9)


def planned(*measured: dict[str, Any]) -> Study:
    spec = {
        "study": {"name": "x", "sensor": "digit", "metrics": ["force_range"]},
        "parameters": {"thickness_mm": {"values": [1.0, 2.0]}},
        "fixed": {"shore_00": 45},
        "press": {"sphere": {"indenters": ["sphere:2", "sphere:4"]}},
        "sweep": {"kind": "grid"},
        "measured": list(measured),
    }
    return make_study(spec_of(spec), default_kit())


def rows(study: Study) -> list[DesignRow]:
    """Designs whose two balls have the law, the larger one twice the force."""
    stored = [
        {
            "indenter": f"sphere:{radius}", "thickness_mm": 1.0, "depth_mm": LAW_DEPTH.tolist(),
            "force_n": [[0.0, 0.0, radius / 2 * f] for f in LAW_FORCE],
            "contact_diameter_mm": (2 * np.sqrt(radius * LAW_DEPTH)).tolist(),
        }
        for radius in (2, 4)
    ]  # fmt: skip
    return [
        DesignRow(p.id, "digit", p.parameters, "done", curves={"sphere": stored})
        for p in study.points()
    ]


@settings(max_examples=10, deadline=None)
@given(
    ratio=st.floats(0.3, 3.0), zero=st.floats(-0.05, 0.1), seed=st.integers(0, 99),
)  # fmt: skip
def test_the_fit_finds_modulus_and_zeros(
    tmp_path_factory: pytest.TempPathFactory, ratio: float, zero: float, seed: int
) -> None:
    folder = tmp_path_factory.mktemp("measured")
    rng = np.random.default_rng(seed)
    measured = []
    for radius, offset in ((2, zero), (4, zero / 2)):
        depth = np.linspace(0.0, 0.45, 400)
        force = ratio * radius / 2 * 0.8 * np.clip(depth - offset, 0, None) ** 1.9
        noisy = np.abs(force * (1 + 0.02 * rng.normal(size=400)))
        diameter = 2 * np.sqrt(radius * np.clip(depth - offset, 0, None))
        file = folder / f"ball{radius}.csv"
        file.write_text(table("depth_mm,force_n,contact_diameter_mm", depth, noisy, diameter))
        measured.append(
            {"file": str(file), "indenter": f"sphere:{radius}", "design": {"thickness_mm": 1.0}}
        )
    study = planned(*measured)
    (gel,), problems = fit_measured(study, rows(study))
    assert problems == []
    assert gel.ratio == pytest.approx(ratio, rel=0.03)
    low, high = gel.interval_mpa
    assert low < ratio * gel.design_modulus_mpa < high
    assert high / low < 1.15
    for fitted, offset in zip(gel.curves, (zero, zero / 2), strict=True):
        assert fitted.offset_mm == pytest.approx(offset, abs=0.01)
        assert fitted.offset_interval_mm[0] < fitted.offset_mm < fitted.offset_interval_mm[1]
        assert fitted.relative_rms < 0.03
        assert fitted.modulus_alone_mpa == pytest.approx(gel.modulus_mpa, rel=0.1)
        assert fitted.contact_rms_mm is not None and fitted.contact_rms_mm < 0.2


def measured_gel(folder: Path, depth: np.ndarray, force: np.ndarray) -> FittedGel:
    """The fit of one ball's record, of a gel of 1.25 times the design's modulus."""
    file = folder / "m.csv"
    file.write_text(table("depth_mm,force_n", depth, force))
    study = planned({"file": str(file), "indenter": "sphere:2", "design": {"thickness_mm": 1.0}})
    (gel,), problems = fit_measured(study, rows(study))
    assert problems == []
    return gel


@pytest.mark.parametrize("air_mm", [0.4, 2.0, 8.0])
def test_the_fit_of_a_record_that_begins_in_air(tmp_path: Path, air_mm: float) -> None:
    rng = np.random.default_rng(3)
    travel = np.linspace(0.0, air_mm + 0.45, 600)
    force = 1.25 * 0.8 * np.clip(travel - air_mm, 0, None) ** 1.9
    noisy = force * (1 + 0.02 * rng.normal(size=600)) + 0.004 + 0.0005 * rng.normal(size=600)
    gel = measured_gel(tmp_path, travel, noisy)
    low, high = gel.interval_mpa
    assert low < 1.25 * gel.design_modulus_mpa < high < 1.2 * low
    assert gel.curves[0].offset_mm == pytest.approx(air_mm, abs=0.005)
    assert np.array(gel.curves[0].depth_mm).max() == pytest.approx(air_mm + 0.45, abs=0.03)


def test_cycles_do_not_soften_a_gel(tmp_path: Path) -> None:
    there = np.linspace(0.0, 0.45, 60)
    force = 1.25 * 0.8 * there**1.9
    depth = np.tile(np.concatenate([there, there[::-1]]), 3)
    gel = measured_gel(tmp_path, depth, np.tile(np.concatenate([force, 0.8 * force[::-1]]), 3))
    assert gel.ratio == pytest.approx(1.25, rel=0.005)


def test_a_load_cell_that_is_not_at_zero_is_told(tmp_path: Path) -> None:
    # Beginning at 0 mm the rows would say so by themselves, and the curve is refused.
    depth = np.linspace(0.03, 0.45, 60)
    force = 1.25 * 0.8 * depth**1.9
    remarks = measured_gel(tmp_path, depth, force + 0.02).curves[0].remarks
    assert any("+0.02 N in all forces" in r and "at 1.25 times" in r for r in remarks)
    assert measured_gel(tmp_path, depth, force).curves[0].remarks == []


def test_curves_too_deep_or_without_a_press_are_told(tmp_path: Path) -> None:
    deep, shallow = tmp_path / "deep.csv", tmp_path / "far.csv"
    deep.write_text(table("depth_mm,force_n", 4 * DEPTH, DEPTH))
    shallow.write_text(table("depth_mm,force_n", 2 * DEPTH, 0.8 * (2 * DEPTH) ** 1.9))
    study = planned(
        {"file": str(deep), "indenter": "sphere:2"}, {"file": str(shallow), "indenter": "sphere:4"}
    )
    gels, problems = fit_measured(study, rows(study))
    assert len(gels) == 2 and len(problems) == 2
    assert "reaches 1.6 mm in a gel 1 mm thick (thickness 1 mm)" in problems[0]
    assert "rows deeper than the press (0.5 mm) left out" in gels[0].curves[0].remarks[0]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"indenter": "sphere:9"}, "no press straight down has the indenter 'sphere:9'"),
        ({"design": {"friction": 1}}, "no swept or fixed parameter .* 'friction'"),
        ({"design": {"shore_00": 50}}, "no design of the sweep has shore_00 = 50"),
        ({"design": {"thickness_mm": 1.5}}, "no design of the sweep has thickness_mm = 1.5"),
        ({"file": "nowhere.csv"}, "nowhere.csv"),
    ],
)
def test_curves_of_no_design_are_refused(tmp_path: Path, changes: dict, message: str) -> None:
    file = tmp_path / "m.csv"
    file.write_text(table("depth_mm,force_n", DEPTH, DEPTH))
    with pytest.raises(InputError, match=message):
        planned({"file": str(file), "indenter": "sphere:2", **changes})
