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
        ("depth_mm,force_n\n0.1,0.2\n0.2\n", "line 3 has 1 cells, the header 2"),
        ("depth_mm,force_n\n0.1,0.2\n0.2,nan\n", "line 3: column force_n: 'nan' is not a finite"),
        ("depth_mm,force_n\n0.1,0.2\n0.2,1e999\n", "not a finite number"),
        ("depth_mm,force_g\n0.1,20\n0.2,30\n", r"lacks the column force_n.*found depth_mm"),
        ("depth_mm,force_n,sigma_n\n0.1,0.1,0\n0.2,0.3,0.1\n", "sigma_n has to be positive"),
    ],
)
def test_broken_file(tmp_path: Path, text: str, message: str) -> None:
    write(tmp_path, text)
    with pytest.raises(InputError, match=message):
        load_record(tmp_path, entry())


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"r\.csv does not exist"):
        load_record(tmp_path, entry())


def test_kind_is_told_by_the_columns(tmp_path: Path) -> None:
    assert kind_of_record(write(tmp_path, "depth_mm, force_n\n")) == "indentation"
    assert kind_of_record(write(tmp_path, "time_s,depth_mm,force_n\n")) == "relaxation"
    assert kind_of_record(write(tmp_path, "shift_mm,normal_n,tangential_n\n")) == "slide"
    assert kind_of_record(write(tmp_path, "a,b\n")) is None
