# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab sensors list`` and ``show``."""

from __future__ import annotations

import json

import pytest

from sensors.registry import sensor_families
from taccel_lab.cli import app


def test_list(capsys: pytest.CaptureFixture[str]) -> None:
    assert app.main(["sensors", "list"]) == 0
    text = capsys.readouterr().out
    assert "gelsight" in text
    assert app.main(["sensors", "list", "--json"]) == 0
    assert set(json.loads(capsys.readouterr().out)) == set(sensor_families())


@pytest.mark.parametrize("name", sorted(sensor_families()))
def test_show_every_family(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert app.main(["sensors", "show", name]) == 0
    assert "thickness_mm" in capsys.readouterr().out
    assert app.main(["sensors", "show", name, "--json"]) == 0
    parameters = json.loads(capsys.readouterr().out)["parameters"]
    assert parameters
    assert all(parameter["source"] for parameter in parameters.values())


def test_unknown_sensor(capsys: pytest.CaptureFixture[str]) -> None:
    assert app.main(["sensors", "show", "gelsite"]) == 2
    message = capsys.readouterr().err
    assert "gelsite" in message
    assert "gelsight" in message
