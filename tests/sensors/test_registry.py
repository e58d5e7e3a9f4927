# SPDX-License-Identifier: Apache-2.0
"""Families of other packages join the catalogue; one that cannot be loaded harms no other."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

from taccel_lab.cli import app
from taccel_lab.errors import InputError
from taccel_lab.sensors import sensor_families, sensor_family
from taccel_lab.sensors.families.gelsight import FAMILY
from taccel_lab.sensors.registry import catalogue


class Installed:
    """A folder on sys.path in which packages are installed, by their metadata."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def add(self, package: str, entry: str, text: str) -> None:
        info = self.folder / f"{package}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(
            f"[taccel_lab.sensors]\n{entry} = {package}_family:FAMILY\n"
        )
        (self.folder / f"{package}_family.py").write_text(text)
        importlib.invalidate_caches()


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Installed:
    monkeypatch.syspath_prepend(str(tmp_path))
    return Installed(tmp_path)


GOOD = """
from dataclasses import replace
from taccel_lab.sensors.families.gelsight import FAMILY as gelsight
FAMILY = replace(gelsight, name="{name}", title="{title}")
"""


def test_a_family_that_is_installed_meanwhile_is_found(installed: Installed) -> None:
    for name in ("first_thumb", "second_thumb"):
        assert name not in sensor_families()
        installed.add(f"good_{name}", name, GOOD.format(name=name, title="a thumb"))
        assert sensor_family(name).title == "a thumb"
    assert list(sensor_families()) == sorted(sensor_families())
    assert not catalogue().broken


@pytest.mark.parametrize(
    ("package", "text", "words"),
    [
        ("raising_b", "raise OSError('no licence file')", ["OSError", "no licence file"]),
        ("missing_b", "import a_module_that_is_not_there", ["ModuleNotFoundError"]),
        ("empty_b", "", ["AttributeError", "FAMILY"]),
        ("wrong_b", "FAMILY = 'a thumb'", ["is a str, not a SensorFamily"]),
        ("other_b", GOOD.format(name="toe", title="t"), ["called toe", "one name"]),
    ],
)
def test_a_broken_package_is_named_and_harms_no_other(
    installed: Installed,
    package: str,
    text: str,
    words: list[str],
    capsys: pytest.CaptureFixture[str],
) -> None:
    before = set(sensor_families())
    installed.add(package, "soft_thumb", text)
    assert set(sensor_families()) == before
    with pytest.raises(InputError) as error:
        sensor_family("soft_thumb")
    for word in ["soft_thumb", package, *words]:
        assert word in str(error.value)
    assert app.main(["sensors", "list"]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "gelsight_mini" in printed and package in printed and "broken" in printed
    assert app.main(["sensors", "show", "soft_thumb"]) == 2
    assert package in capsys.readouterr().err


def test_no_name_is_taken_twice(installed: Installed) -> None:
    """Neither that of a sensor of ours nor that of another package's."""
    installed.add("thief_c", "gelsight", GOOD.format(name="gelsight", title="stolen"))
    for package in ("first_d", "second_d"):
        installed.add(package, "soft_thumb", GOOD.format(name="soft_thumb", title=package))
    assert sensor_family("gelsight") is FAMILY
    assert sensor_family("soft_thumb").title in ("first_d", "second_d")
    for name in ("gelsight", "soft_thumb"):
        assert "exists already" in catalogue().broken[name].reason


def test_unknown_sensor_names_the_known() -> None:
    with pytest.raises(
        InputError, match=r"'gelsigth' \(did you mean gelsight\?\); known: .*gelsight"
    ):
        sensor_family("gelsigth")
