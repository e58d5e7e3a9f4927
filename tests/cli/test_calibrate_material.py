# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate material`` from records to a profile, and records that it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.calibration.capture.schema import ToolEntry
from taccel_lab.calibration.material.force_table import force_table
from taccel_lab.calibration.material.gel import Gel
from taccel_lab.presses.physics import PHYSICS, Accuracy, PressMeshOptions, PressPhysics
from taccel_lab.profile import load_profile
from taccel_lab.sensors.profile import catalogue_profile
from tests.cli.conftest import Cli

MODULUS, POISSON, FRICTION = 3e5, 0.47, 0.5
DEPTH = np.linspace(0.15, 1.2, 10)
FAST = PressPhysics(Accuracy.FAST, mesh=PressMeshOptions(elements_per_radius=2.0, core=4, rings=6))
"""Quicker than what a user gets."""


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture
def captures(cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A press, and a slide of a flat punch there and back."""
    monkeypatch.setenv("TACCEL_LAB_CACHE", str(cache))
    monkeypatch.setitem(PHYSICS, Accuracy.FAST, FAST)
    monkeypatch.setattr("taccel_lab.calibration.material.force_table.DEPTHS", 4)
    gel = Gel.of_profile(catalogue_profile("gelsight_mini"), physics=FAST).with_law(POISSON)
    tool = gel.tool(ToolEntry(kind="sphere", radius_mm=5.0))
    table = force_table(gel, tool, (0.15, 1.2), free_nu=False, friction=FRICTION)
    force = table.force_n(DEPTH, MODULUS, POISSON)
    rng = np.random.default_rng(0)
    folder = tmp_path / "captures"
    folder.mkdir()
    write(folder / "press.csv", depth_mm=DEPTH, force_n=force * (1 + 0.01 * rng.normal(size=10)))
    shift = np.concatenate([np.linspace(0, 3, 60), np.linspace(3, 0, 60)])
    spring = np.concatenate(
        [np.minimum(shift[:60] / 0.5, 1), 1 - np.minimum((3 - shift[60:]) / 0.5, 2)]
    )
    write(
        folder / "slide.csv",
        shift_mm=shift,
        normal_n=np.full(120, 2.0),
        tangential_n=FRICTION * 2.0 * spring + 0.01 * rng.normal(size=120),
    )
    manifest(folder)
    return folder


def write(path: Path, **columns: np.ndarray) -> None:
    rows = zip(*columns.values(), strict=True)
    lines = [",".join(f"{value:.9g}" for value in row) for row in rows]
    path.write_text("\n".join([",".join(columns), *lines]) + "\n")


def manifest(folder: Path, press_mm: float = 5.0) -> None:
    (folder / "captures.toml").write_text(
        'schema_version = 2\nsensor = "gelsight_mini"\nsource = "test"\n'
        '[[records]]\nfile = "press.csv"\nkind = "indentation"\n'
        f'tool = {{ kind = "sphere", radius_mm = {press_mm} }}\n'
        '[[records]]\nfile = "slide.csv"\nkind = "slide"\n'
        'tool = { kind = "cylinder", radius_mm = 3.0 }\n'
    )


def words(captures: Path) -> list[object]:
    out = captures.parent / "profile"
    return [captures, "--out", out, "--accuracy", "fast", "--fix", f"nu={POISSON}"]


def test_records_become_a_profile_and_a_report(captures: Path, cli: Cli) -> None:
    printed = cli.json("calibrate material", *words(captures))["material"]
    assert printed["verdict"] == "good"
    profile = load_profile(captures.parent / "profile")
    block = profile.material
    low, high = block.provenance.interval["young_modulus_pa"]
    assert low < MODULUS < high and high / low < 1.3
    assert block.young_modulus_pa == pytest.approx(MODULUS, rel=0.02)
    assert block.friction_coefficient == pytest.approx(FRICTION, rel=0.05)
    assert block.poisson_ratio == POISSON
    assert block.fitted_with is not None and block.fitted_with.friction_measured
    assert block.fitted_with.friction_coefficient == block.friction_coefficient
    assert block.fitted_with.physics["accuracy"] == "fast"
    assert block.provenance.kind == "calibrated" and block.provenance.verdict == "good"
    assert set(block.provenance.inputs) == {"press.csv", "slide.csv", "captures.toml"}
    residuals = block.provenance.residuals
    assert next(iter(residuals)) == "indentation_held_out_worst_relative"
    assert residuals["indentation_worst_relative"] < 0.04
    assert residuals["indentation_held_out_worst_relative"] < 0.06
    assert block.provenance.valid_region["depth_mm"] == pytest.approx((0.15, 1.2))
    report = captures.parent / "profile_report"
    assert (report / "report.html").is_file() and (report / "indentation.png").is_file()
    assert json.loads((report / "report.json").read_text())["held"] == {"poisson_ratio": POISSON}


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (lambda c: {**c, "force_n": c["force_n"] / 9.80665e-3}, "gram"),
        (lambda c: {**c, "force_n": c["force_n"] * 1e3}, "mN"),
        (lambda c: {**c, "depth_mm": c["depth_mm"] * 1e-3}, "metres"),
        (lambda c: {**c, "force_n": -c["force_n"]}, "sign"),
        (lambda c: {**c, "force_n": c["force_n"][::-1]}, "falls"),
        (lambda c: {**c, "depth_mm": c["depth_mm"] * 1e3}, "mm"),
    ],
)
def test_wrong_units_and_signs_are_refused(captures: Path, cli: Cli, spoil, told: str) -> None:
    data = np.loadtxt(captures / "press.csv", delimiter=",", skiprows=1)
    write(captures / "press.csv", **spoil({"depth_mm": data[:, 0], "force_n": data[:, 1]}))
    assert told in cli.refusal("calibrate material", *words(captures))
    assert not (captures.parent / "profile").exists()


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--fix", "nu"), "name=value"),
        (("--fix", "nu=0.6"), "[0, 0.4999]"),
        (("--fix", "stiffness=3"), "cannot be held"),
        (("--fix", "mooney_ratio=0.2"), "--model mooney_rivlin"),
        (("--fix", "friction=7"), "friction must lie in [0, 5]"),
        (("--device", "cuda:99"), "is not there"),
    ],
)
def test_bad_options_are_refused(
    captures: Path, cli: Cli, options: tuple[str, ...], told: str
) -> None:
    assert told in cli.refusal("calibrate material", *words(captures), *options)


def test_captures_without_forces_say_what_is_needed(captures: Path, cli: Cli) -> None:
    (captures / "captures.toml").write_text('schema_version = 2\nsensor = "gelsight_mini"\n')
    assert "[[records]]" in cli.refusal("calibrate material", *words(captures))
