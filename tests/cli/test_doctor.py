# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab doctor`` tells a sound installation from a broken one."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from taccel_lab.cli import doctor
from taccel_lab.errors import InputError
from tests.cli.conftest import Cli

ROOT = Path(__file__).parents[2]
Broken = Callable[..., list[dict[str, Any]]]


@pytest.fixture
def broken(monkeypatch: pytest.MonkeyPatch) -> Broken:
    def packages(*pairs: tuple[str, str]) -> list[dict[str, Any]]:
        """Findings where these are the requirements."""
        monkeypatch.setattr(doctor, "requirements", lambda: iter(pairs))
        return list(doctor.check_packages())

    return packages


def test_this_installation_is_sound(cli: Cli) -> None:
    report = cli.json("doctor")
    assert report["problems"] == []
    assert {package["name"] for package in report["packages"]} >= {"warp-lang", "torch", "numpy"}
    assert report["machine"]["cores"] >= 1
    devices = report["warp"]["devices"]
    assert devices[0]["name"] == "cpu"
    assert all(device["problem"] is None for device in devices)


def test_a_cache_that_cannot_be_written_is_told_beside_all_else(
    monkeypatch: pytest.MonkeyPatch, cli: Cli
) -> None:
    def refused() -> None:
        raise InputError("Warp cannot keep its kernels in /x")

    monkeypatch.setattr("taccel_lab.processes.start_warp.start_warp", refused)
    report = cli.json("doctor", code=1)
    assert report["problems"] == ["Warp cannot keep its kernels in /x"] and report["packages"]
    assert "broken: Warp cannot keep" in cli("doctor", code=1).out


def test_requirements_are_those_of_the_project_or_of_the_installed_wheel(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = dict(doctor.requirements())
    assert (names["numpy>=2.2,<3"], names["mujoco>=4,<5"]) == ("", "peers")
    # Not ours: other projects leave such files in site-packages.
    (tmp_path / "pyproject.toml").write_text("[project]\nname = 'other'\n")
    lines = ["numpy<3,>=2.1", "taxim==1.4.1; extra == 'demo'"]
    monkeypatch.setattr(importlib.metadata, "requires", lambda name: lines)
    assert list(doctor.requirements(tmp_path)) == [("numpy<3,>=2.1", ""), ("taxim==1.4.1", "demo")]


def test_missing_and_outdated_packages(broken: Broken) -> None:
    absent, old, extra = broken(("no-such-thing>=1", ""), ("numpy<1", ""), ("nor-this", "dev"))
    assert absent["problem"] == "not installed"
    assert old["problem"] == f"version {importlib.metadata.version('numpy')} is outside <1"
    assert extra["extra"] == "dev" and extra["problem"] == "not installed"
    assert len(doctor.collect()["problems"]) == 2


def test_a_missing_system_library_is_named(
    broken: Broken, monkeypatch: pytest.MonkeyPatch, cli: Cli
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(doctor, "SYSTEM_LIBRARIES", ("libnowhere.so.7",))
        broken(("numpy>=2", ""))
        assert "broken: libnowhere.so.7" in cli("doctor", code=1).out

    def fail(name: str) -> None:
        raise ImportError("libGL.so.1: cannot open shared object file")

    monkeypatch.setattr(doctor.importlib, "import_module", fail)
    (package,) = broken(("numpy>=2", ""))
    assert package["problem"] == "import numpy fails: libGL.so.1: cannot open shared object file"
    with pytest.raises(SystemExit) as caught:
        doctor.Doctor(full=True).run()
    assert caught.value.code == 1
    assert "broken: numpy" in cli.capsys.readouterr().out


def test_developers_packages_are_left_to_full() -> None:
    extras = {package["extra"] for package in doctor.check_packages(full=False)}
    assert "demo" in extras and "dev" not in extras


def test_demo_captures_are_found_or_reported_absent(monkeypatch: pytest.MonkeyPatch) -> None:
    for place, found in ((ROOT, str(ROOT)), (ROOT / "absent", None)):
        monkeypatch.setenv("TACCEL_LAB_DATA", str(place))
        assert doctor.find_data()["TACCEL_LAB_DATA"] == found
