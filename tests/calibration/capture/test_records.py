# SPDX-License-Identifier: Apache-2.0
"""Force records: columns, units, signs and order, each refused with what was found."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.calibration.capture.record_checks import apparent_modulus_mpa, check_record
from taccel_lab.calibration.capture.records import kind_of_record, load_record
from taccel_lab.calibration.capture.schema import RecordEntry, ToolEntry
from taccel_lab.errors import InputError
from taccel_lab.files.loading_faults import require_loading
from taccel_lab.presses.bonded_layer import layer_force_n

RADIUS_MM = 4.0
DEPTH_MM = np.array([0.1, 0.25, 0.4, 0.6, 0.8, 1.0])


def hertz_n(modulus_mpa: float, depth_mm: np.ndarray = DEPTH_MM) -> np.ndarray:
    return 4 / 3 * modulus_mpa * np.sqrt(RADIUS_MM) * depth_mm**1.5


def entry(kind: str = "indentation", **changes: object) -> RecordEntry:
    tool = {"kind": "sphere", "radius_mm": RADIUS_MM}
    return RecordEntry.model_validate({"file": "r.csv", "kind": kind, "tool": tool} | changes)


def indentation(depth_mm: np.ndarray, force_n: np.ndarray, **changes: object) -> None:
    columns = {"depth_mm": np.asarray(depth_mm), "force_n": np.asarray(force_n)}
    check_record("r.csv", entry(**changes), columns)


@given(
    modulus=st.floats(0.01, 3.0),
    deepest=st.floats(0.1, 3.0),
    count=st.integers(3, 40),
    noise=st.floats(0.0, 0.01),
    seed=st.integers(0, 99),
)
def test_records_of_gels_are_accepted(
    modulus: float, deepest: float, count: int, noise: float, seed: int
) -> None:
    depth = np.linspace(deepest / count, deepest, count)
    force = hertz_n(modulus, depth)
    force += np.random.default_rng(seed).normal(0, noise * force.max(), count)
    indentation(depth, force)
    assert apparent_modulus_mpa(depth, force, RADIUS_MM) == pytest.approx(modulus, rel=0.1)


@given(modulus=st.floats(0.1, 2.0), unit=st.sampled_from(["mN", "grams"]))
def test_forces_in_another_unit(modulus: float, unit: str) -> None:
    factor = {"mN": 1e3, "grams": 101.97}[unit]
    with pytest.raises(InputError, match=rf"r\.csv.*MPa stiff.*read as .*{unit}"):
        indentation(DEPTH_MM, factor * hertz_n(modulus))


@pytest.mark.parametrize(
    ("depth", "force", "message"),
    [
        (DEPTH_MM, -hertz_n(0.2), "sign of the column is reversed"),
        (-DEPTH_MM, hertz_n(0.2), r"row 6 has depth_mm = -1; travel past first touch"),
        (DEPTH_MM / 1e3, hertz_n(0.2), r"reaches only 0\.001.*in metres"),
        (DEPTH_MM * 1e3, hertz_n(0.2), r"reaches 1000; at most 20 mm \(micrometres\?\)"),
        (DEPTH_MM[::-1], hertz_n(0.2), r"depth_mm falls from 1 to 0\.8 in row 2"),
        (np.r_[DEPTH_MM, DEPTH_MM[::-1]], np.r_[hertz_n(0.2), hertz_n(0.2)[::-1]], "unloading"),
        (DEPTH_MM, [0.1, 0.3, 0.9, 0.5, 0.6, 1.5], r"falls to 0\.5 N in row 4 after 0\.9 N"),
        (DEPTH_MM, [0.1, 0.3, -0.4, 0.9, 1.2, 1.5], r"row 3 has force_n = -0\.4 N.*than noise"),
        (DEPTH_MM, hertz_n(0.2) / 9.8e3, "kN"),
        (DEPTH_MM, np.zeros(6), "no force is positive"),
    ],
)  # fmt: skip
def test_faulty_indentation(depth: np.ndarray, force: np.ndarray, message: str) -> None:
    with pytest.raises(InputError, match=message):
        indentation(depth, np.asarray(force))


def test_small_negative_readings_are_noise() -> None:
    indentation(DEPTH_MM, hertz_n(0.2) - 0.02, force_sigma_n=0.02)


def test_stated_noise_decides_what_falls() -> None:
    force = hertz_n(0.2)
    force[3] = force[2] - 0.03
    indentation(DEPTH_MM, force, force_sigma_n=0.02)
    with pytest.raises(InputError, match="in row 4"):
        indentation(DEPTH_MM, force, force_sigma_n=0.005)


def test_unknown_tool_is_given_the_benefit_of_the_doubt() -> None:
    # 14 MPa by a 4 mm ball, 6 MPa by a 20 mm one: nobody knows.
    indentation(DEPTH_MM, hertz_n(14.0), tool=ToolEntry())
    with pytest.raises(InputError, match="MPa stiff"):
        indentation(DEPTH_MM, hertz_n(14.0))


def test_relaxation_runs_forward() -> None:
    columns = {
        "time_s": np.array([0.0, 1.0, 1.0, 2.0]),
        "depth_mm": np.full(4, 1.0),
        "force_n": np.array([1.5, 1.4, 1.35, 1.3]),
    }
    with pytest.raises(InputError, match=r"time_s falls from 1 to 1 in row 3.*forward in time"):
        check_record("r.csv", entry("relaxation"), columns)
    columns["time_s"][2:] = [1.5, 2.0]
    check_record("r.csv", entry("relaxation"), columns)


def test_slide_with_columns_swapped() -> None:
    columns = {
        "shift_mm": np.linspace(0, 3, 5),
        "normal_n": np.full(5, 0.2),
        "tangential_n": np.full(5, 2.0),
    }
    with pytest.raises(InputError, match=r"10 times normal_n.*swapped"):
        check_record("r.csv", entry("slide"), columns)
    columns["normal_n"] = np.full(5, 2.0)
    check_record("r.csv", entry("slide"), columns)


def write(folder: Path, text: str) -> Path:
    path = folder / "r.csv"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("depth_mm,force_n\n", "holds 0 rows; a header and at least 2"),
        ("depth_mm,force_n\n0.1,0.2\n0.2,nan\n", "line 3: column force_n: 'nan' is not a finite"),
        ("depth_mm,force_g\n0.1,20\n0.2,30\n", r"lacks the column force_n.*found depth_mm"),
        ("depth_mm,force_n,sigma_n\n0.1,0.1,0\n0.2,0.3,0.1\n", "sigma_n has to be positive"),
    ],
)
def test_broken_file(tmp_path: Path, text: str, message: str) -> None:
    write(tmp_path, text)
    with pytest.raises(InputError, match=message):
        load_record(tmp_path, entry())


def loaded(folder: Path, depth: np.ndarray, force: np.ndarray, head: str = "depth_mm,force_n"):
    rows = [f"{d:.9g},{f:.9g}" for d, f in zip(depth, force, strict=True)]
    write(folder, "\n".join([head, *rows]) + "\n")
    return load_record(folder, entry())


DENSE_MM = np.linspace(0.05, 1.0, 20)


@pytest.mark.parametrize(
    ("depth", "force", "message"),
    [
        (DENSE_MM, np.full(20, 1.0), r"r\.csv: force_n does not rise with depth_mm: it is 1 N"),
        (hertz_n(0.5, DENSE_MM), DENSE_MM, "rises ever less .*columns swapped"),
        (DENSE_MM, hertz_n(0.5, DENSE_MM) + 1.0, r"zero is off.*rows in air.*\(depth_mm below 0\)"),
        # Of the three depths that FEATS publishes.
        ([1.6503, 5.9641, 13.5257], [0.5, 1.0, 1.5], "columns swapped"),
    ],
)  # fmt: skip
def test_what_no_press_of_a_ball_can_be(
    tmp_path: Path, depth: np.ndarray, force: np.ndarray, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        loaded(tmp_path, depth, force)


@given(
    radius=st.floats(1.0, 15.0), thickness=st.floats(1.0, 6.0), nu=st.floats(0.4, 0.5),
    late=st.floats(-0.3, 0.3), count=st.integers(3, 40), noise=st.sampled_from([0, 0.003, 0.01]),
    seed=st.integers(0, 999),
)  # fmt: skip
def test_no_press_of_a_ball_on_a_layer_is_refused(
    radius: float, thickness: float, nu: float, late: float, count: int, noise: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    deepest = min(0.5 * thickness, 0.6 * radius)
    depth = np.sort(rng.uniform(0.05, 1.0, count)) * deepest
    late *= min(1.0, deepest)
    force = layer_force_n("sphere", np.maximum(depth - late, 0), radius, thickness, nu, 2e5)
    force += rng.normal(0, noise * force.max(), count)
    require_loading(depth, force, 0.02 * force.max(), ball=True)


def test_published_forces_are_read(tmp_path: Path) -> None:
    record = loaded(tmp_path, np.array([0.5, 1.0, 1.5]), np.array([1.6503, 5.9641, 13.5257]))
    assert record.zero is None and len(record.columns["force_n"]) == 3


def test_what_the_load_cell_reads_in_air_is_taken_off(tmp_path: Path) -> None:
    depth = np.linspace(-1.0, 1.0, 41)
    true = hertz_n(0.5, np.maximum(depth, 0.0))
    noise = np.random.default_rng(0).normal(0, 0.01, len(depth))
    record = loaded(tmp_path, depth, true + 1.0 + noise)
    assert record.zero is not None and record.columns["depth_mm"].min() > 0
    low, high = record.zero.interval95
    assert low < 1.0 < high and high - low < 0.05
    kept = depth > 0
    assert record.columns["force_n"] == pytest.approx(true[kept], abs=0.05)
    with pytest.raises(InputError, match="Reverse the column's sign, or cut the approach off"):
        loaded(tmp_path, depth, true[::-1] + 1.0)


def test_rows_that_stand_twice_count_once(tmp_path: Path) -> None:
    once = loaded(tmp_path, DENSE_MM, hertz_n(0.5, DENSE_MM))
    twice = loaded(tmp_path, np.repeat(DENSE_MM, 2), np.repeat(hertz_n(0.5, DENSE_MM), 2))
    for name, values in once.columns.items():
        assert np.array_equal(twice.columns[name], values)


@pytest.mark.parametrize(
    ("kind", "columns"),
    [
        (
            "relaxation",
            {"time_s": np.arange(6.0), "depth_mm": np.arange(6.0), "force_n": np.ones(6)},
        ),
    ],
)  # fmt: skip
def test_a_load_cell_that_was_not_read(kind: str, columns: dict[str, np.ndarray]) -> None:
    with pytest.raises(InputError, match=r"r\.csv: .* is 1 in every row"):
        check_record("r.csv", entry(kind), columns)


def test_kind_is_told_by_the_columns(tmp_path: Path) -> None:
    assert kind_of_record(write(tmp_path, "depth_mm, force_n\n")) == "indentation"
    assert kind_of_record(write(tmp_path, "time_s,depth_mm,force_n\n")) == "relaxation"
    assert kind_of_record(write(tmp_path, "shift_mm,normal_n,tangential_n\n")) == "slide"
    assert kind_of_record(write(tmp_path, "a,b\n")) is None
