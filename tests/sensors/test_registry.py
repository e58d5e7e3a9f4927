# SPDX-License-Identifier: Apache-2.0
"""Families of other packages join the catalogue; one that cannot be loaded harms no other."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path

import pytest

from taccel_lab.errors import InputError
from taccel_lab.sensors import sensor_families, sensor_family
from taccel_lab.sensors.families.gelsight import FAMILY
from taccel_lab.sensors.registry import catalogue
from tests.support.commands import done, refusal

Install = Callable[[str, str, str], None]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Install:
    """Puts a package with a family into a folder on sys.path, with its metadata."""
    monkeypatch.syspath_prepend(str(tmp_path))

    def add(package: str, entry: str, text: str) -> None:
        info = tmp_path / f"{package}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
        entries = f"[taccel_lab.sensors]\n{entry} = {package}_family:FAMILY\n"
        (info / "entry_points.txt").write_text(entries)
        (tmp_path / f"{package}_family.py").write_text(text)
        importlib.invalidate_caches()

    return add


GOOD = """
from dataclasses import replace
from taccel_lab.sensors.families.gelsight import FAMILY as gelsight
FAMILY = replace(gelsight, name="{name}", title="{title}")
"""


def test_a_family_that_is_installed_meanwhile_is_found(install: Install) -> None:
    for name in ("first_thumb", "second_thumb"):
        assert name not in sensor_families()
        install(f"good_{name}", name, GOOD.format(name=name, title="a thumb"))
        assert sensor_family(name).title == "a thumb"
    assert list(sensor_families()) == sorted(sensor_families())
    assert not catalogue().broken


@pytest.mark.parametrize(
    ("package", "text", "words"),
    [
        ("raising_b", "raise OSError('no licence file')", "OSError.*no licence file"),
        ("missing_b", "import a_module_that_is_not_there", "ModuleNotFoundError"),
        ("empty_b", "", "AttributeError.*FAMILY"),
        ("wrong_b", "FAMILY = 'a thumb'", "is a str, not a SensorFamily"),
        ("other_b", GOOD.format(name="toe", title="t"), "called toe.*one name"),
    ],
)
def test_a_broken_package_is_named_and_harms_no_other(
    install: Install, package: str, text: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    before = set(sensor_families())
    install(package, "soft_thumb", text)
    assert set(sensor_families()) == before
    with pytest.raises(InputError, match=words) as error:
        sensor_family("soft_thumb")
    assert "soft_thumb" in str(error.value) and package in str(error.value)
    listed = done(capsys, "sensors", "list")
    assert listed.code == 0
    assert all(
        word in " ".join(listed.out.split()) for word in ("gelsight_mini", package, "broken")
    )
    assert package in refusal(capsys, "sensors", "show", "soft_thumb")


def test_no_name_is_taken_twice(install: Install) -> None:
    """Neither that of a sensor of ours nor that of another package's."""
    install("thief_c", "gelsight", GOOD.format(name="gelsight", title="stolen"))
    for package in ("first_d", "second_d"):
        install(package, "soft_thumb", GOOD.format(name="soft_thumb", title=package))
    assert sensor_family("gelsight") is FAMILY
    assert sensor_family("soft_thumb").title in ("first_d", "second_d")
    for name in ("gelsight", "soft_thumb"):
        assert "exists already" in catalogue().broken[name].reason


def test_unknown_sensor_names_the_known() -> None:
    words = r"'gelsigth' \(did you mean gelsight\?\); taccel-lab sensors list lists all"
    with pytest.raises(InputError, match=words):
        sensor_family("gelsigth")
