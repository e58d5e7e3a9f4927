# SPDX-License-Identifier: Apache-2.0
"""Remarks of calibrations, records of their runs, and cross-conformal bounds."""

from __future__ import annotations

import string
from collections import Counter
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab import calibration, learning
from taccel_lab.calibration.blocks import BLOCKS
from taccel_lab.calibration.calibrate import calibrate
from taccel_lab.calibration.capture import load_capture_folder
from taccel_lab.calibration.profile_page import profile_page
from taccel_lab.calibration.record.folder import QUICK_LEAVES_OUT, open_record
from taccel_lab.calibration.record.session import Recorder, run_session
from taccel_lab.calibration.remarks import RemarkKind, remark_kinds, remark_table
from taccel_lab.calibration.robust_fit import radius_factor
from taccel_lab.networks.normal_settings import RAYLEIGH_95
from taccel_lab.profile import load_profile, save_profile
from taccel_lab.report.remark import Severity
from tests.calibration.record.sessions import FACTS, Watching, replaying, source

KINDS = [kind for _, kind in remark_kinds(calibration, learning)]
DOCS = Path(__file__).parents[2] / "docs"


def test_codes_are_unique() -> None:
    counts = Counter(kind.code for kind in KINDS)
    assert [code for code, count in counts.items() if count > 1] == []


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.code)
def test_kinds_are_sound(kind: RemarkKind) -> None:
    assert kind.code == kind.code.lower() and kind.code.isidentifier()
    fields = {name for _, name, _, _ in string.Formatter().parse(kind.text) if name is not None}
    assert all(name.isidentifier() for name in fields)
    assert not fields & {"frames", "blocks", "grave"}
    assert set(kind.blocks) <= {block.name for block in BLOCKS}
    # Where a figure is a sentence, another one follows behind one stop.
    assert "}{" not in kind.text
    parts = string.Formatter().parse(kind.text)
    values = {name: 1 if spec else "It is so." for _, name, spec, _ in parts if name}
    message = kind(**values).message
    assert "so.." not in message and message == message.strip()


def test_a_remark_takes_figures_images_and_severity() -> None:
    kind = RemarkKind(
        "off", Severity.WARNING, "{count} off by {gap:.1f} px", ("color",), Severity.ERROR
    )
    remark = kind(count=2, gap=1.26, frames=["a", "b"])
    assert str(remark) == "warning: 2 off by 1.3 px"
    assert (remark.code, remark.frames, remark.blocks) == ("off", ("a", "b"), ("color",))
    assert kind(count=2, gap=1.0, grave=True).severity is Severity.ERROR
    assert kind(count=2, gap=1.0, blocks=("depth",)).blocks == ("depth",)


def test_the_docs_list_all_kinds() -> None:
    made = "python tools/list_remarks.py > docs/remarks.md"
    assert (DOCS / "remarks.md").read_text(encoding="utf-8") == remark_table(
        calibration, learning
    ), made


@pytest.mark.thorough
def test_the_profile_and_its_page_say_how_captures_were_recorded(tmp_path: Path) -> None:
    path, out = source(tmp_path / "set", 2), tmp_path / "out"
    facts = replace(FACTS, quick=True, source="bench 2, by Ada")
    with open_record(out, facts) as folder:
        run_session(Recorder(folder, facts, 2), replaying(path), [Watching()])
    profile = calibrate(out, only=["background"]).profile
    save_profile(profile, tmp_path / "profile")
    (session,) = load_profile(tmp_path / "profile").sensor.recorded
    assert session.blocks == ("background", "perturbation")
    assert session.camera == str(path) and session.source == "bench 2, by Ada"
    assert session.controls["exposure"] == "as it was recorded"
    assert session.left_out == QUICK_LEAVES_OUT
    assert session.begun and datetime.now(UTC) - session.begun < timedelta(minutes=5)

    page = profile_page(profile)
    (table,) = [table for table in page.tables if table.title == "Recordings"]
    told = {row[0]: row[1] for row in table.rows}
    assert told["camera"] == str(path) and told["blocks"] == "background, perturbation"
    assert [row[1] for row in table.rows if row[0] == "left out"] == list(QUICK_LEAVES_OUT)

    # Another session's background takes the block over; what nobody recorded says nothing.
    both = session.model_copy(update={"blocks": ("background", "color")})
    older = profile.with_block(profile.sensor.replace(recorded=(both,)))
    assert load_capture_folder(path).recorded is None
    (left,) = calibrate(path, older, only=["background"]).profile.sensor.recorded
    assert left.blocks == ("color",) and left.camera == session.camera


def press_errors(rng: np.random.Generator, pixels: int = 400) -> np.ndarray:
    """Lengths of heavy-tailed vectors, of a size that differs between presses, as real ones do."""
    vectors = rng.standard_t(4, size=(pixels, 2)) / np.sqrt(2)
    return np.exp(rng.normal(0, 0.25)) * np.linalg.norm(vectors, axis=1)


@pytest.mark.thorough(cases=("36",))
@pytest.mark.parametrize("count", [6, 12, 36])
def test_new_presses_lie_in_the_radius(count: int) -> None:
    rng = np.random.default_rng(count)
    held, normal = [], []
    for _ in range(60):
        factor = radius_factor([press_errors(rng) for _ in range(count)], 0.95, RAYLEIGH_95)
        new = press_errors(rng)
        held.append((new <= factor).mean())
        normal.append((new <= RAYLEIGH_95 * np.sqrt((new**2).mean() / 2)).mean())
    assert np.mean(held) == pytest.approx(0.95, abs=0.02)
    assert np.mean(normal) < 0.945  # even with its own scale known, errors are no normal deviates


def test_normal_deviates_keep_their_radius() -> None:
    rng = np.random.default_rng(0)
    presses = [np.linalg.norm(rng.normal(size=(4000, 2)), axis=1) for _ in range(12)]
    assert radius_factor(presses, 0.95, 1.0) == pytest.approx(RAYLEIGH_95, rel=0.02)


def test_presses_weigh_alike() -> None:
    rng = np.random.default_rng(1)
    presses = [press_errors(rng) for _ in range(8)]
    presses[3] = 3 * presses[3]
    many = [*presses[:3], np.repeat(presses[3], 20), *presses[4:]]
    assert radius_factor(many, 0.95, 1.0) == radius_factor(presses, 0.95, 1.0)


@settings(max_examples=25, deadline=None)
@given(st.floats(0.01, 100.0), st.permutations(range(6)))
def test_it_follows_the_scale_and_not_the_order(scale: float, order: list[int]) -> None:
    rng = np.random.default_rng(2)
    presses = [press_errors(rng, 50) for _ in range(6)]
    found = radius_factor([scale * presses[i] for i in order], 0.95, 1.0)
    assert found == pytest.approx(scale * radius_factor(presses, 0.95, 1.0), rel=1e-9)


def test_too_few_presses_say_nothing() -> None:
    some = [np.ones(5), np.empty(0), np.ones(5), np.ones(5)]
    assert radius_factor(some, 0.95, RAYLEIGH_95) == RAYLEIGH_95
