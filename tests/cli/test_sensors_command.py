# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab sensors list`` and ``show``."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.cli import app
from taccel_lab.sensors.registry import sensor_families, sensor_family
from taccel_lab.studies.sensor_picture import pad_section, sight_paths

NAMES = sorted(sensor_families())


def test_list(capsys: pytest.CaptureFixture[str]) -> None:
    assert app.main(["sensors", "list"]) == 0
    text = capsys.readouterr().out
    for name in NAMES:
        assert name in text
    assert app.main(["sensors", "list", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert listed["broken"] == {}
    assert sorted(listed["sensors"]) == NAMES
    mini = listed["sensors"]["gelsight_mini"]
    assert mini["size_mm"] == "25.25 x 20.75 x 4"
    assert (mini["image_px"], mini["mm_per_px"], mini["markers"]) == (
        "320 x 240",
        "0.0634",
        "9 x 7",
    )
    assert listed["sensors"]["9dtact"]["young_modulus_mpa"].count(",") == 1


@pytest.mark.parametrize("name", NAMES)
def test_show_every_family(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert app.main(["sensors", "show", name]) == 0
    text = capsys.readouterr().out
    for word in ("gel volume", "field of view", "LEDs", "housing", "young_modulus_mpa"):
        assert word in text
    assert app.main(["sensors", "show", name, "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert all(parameter["source"] for parameter in shown["parameters"].values())
    family = sensor_family(name)
    assert set(shown["parameters"]) == set(family.parameters_type.parameters())
    assert shown["optics"]["camera"]["width_px"] == family.parameters().grid().width_px
    assert list(shown["layers"]) == list(family.parameters().pad().layer_names)
    assert shown["housing"] and shown["references"]


def test_show_with_other_values(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    change = ["--set", "thickness_mm=3", "marker_pitch_mm=0"]
    assert app.main(["sensors", "show", "gelsight_mini", *change, "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["parameters"]["thickness_mm"]["source"] == "set by the user"
    assert shown["derived"]["gel under the apex"]["value"] == 3.0
    assert shown["markers"] is None
    assert app.main(["sensors", "show", "gelsight_mini", *change]) == 0
    assert "set; the default is 4.0" in " ".join(capsys.readouterr().out.split())


def test_camera_distance_moves_the_scale(capsys: pytest.CaptureFixture[str]) -> None:
    """Further away by 20 mm in air, with the same lens."""
    scales = []
    for distance in (20.8, 40.8):
        change = ["--set", "scale_from=focal_px", f"camera_distance_mm={distance}"]
        assert app.main(["sensors", "show", "digit", *change, "--json"]) == 0
        scales.append(json.loads(capsys.readouterr().out)["image"]["mm_per_px_x"])
    assert scales[1] - scales[0] == pytest.approx(20.0 / 328.57, rel=1e-9)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["gelsite"], ["gelsite", "gelsight"]),
        (["digit", "--set", "mid_radius_mm=5"], ["mid_radius_mm = 5 is below its bound"]),
        (["digit", "--set", "mid_radius_mm"], ["name=value"]),
        (["digit", "--set", "crown=5"], ["no parameter 'crown'"]),
        (["digit", "--picture", "digit.svg"], ["digit.svg must end in .png"]),
    ],
)
def test_bad_input(
    arguments: list[str], words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert app.main(["sensors", "show", *arguments]) == 2
    message = capsys.readouterr().err
    for word in words:
        assert word in message


@pytest.mark.parametrize("name", ["9dtact", "digit_360", "rtac"])
def test_picture(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / f"{name}.png"
    assert app.main(["sensors", "show", name, "--picture", str(path)]) == 0
    assert str(path.name) in capsys.readouterr().out.replace("\n", "")
    assert path.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("name", NAMES)
def test_sight_lines_of_a_picture_end_on_the_contact_face(name: str, axis: int) -> None:
    parameters = sensor_family(name).parameters()
    pad, design = parameters.pad(), parameters.optics()
    assert design is not None
    paths = sight_paths(pad, design, axis)
    assert len(paths) == 3
    for path in paths:
        assert path[0] == pytest.approx(design.camera.position_mm)
        end = path[-1]
        assert end[2] == pytest.approx(float(pad.top_mm(end[:2])), abs=0.1)
    outline = pad_section(pad, axis)
    low, high = pad.bounds_mm()
    assert outline.min(axis=0) == pytest.approx(low[[axis, 2]], abs=1e-3)
    assert outline.max(axis=0) == pytest.approx(high[[axis, 2]], abs=2e-2)


@pytest.mark.parametrize("name", ["gelsight_mini", "digit", "9dtact", "gelsight_wedge"])
def test_refracted_sight_lines_span_what_the_image_shows(name: str) -> None:
    """The lens, refracted by window and gel, sees the width that the image's scale states.

    To 6 %: the scale holds on the axis, and a calibrated lens distorts.
    """
    parameters = sensor_family(name).parameters()
    pad, design, grid = parameters.pad(), parameters.optics(), parameters.grid()
    assert design is not None
    left, _, right = sight_paths(pad, design, 0)
    width = grid.width_px * grid.mm_per_px_x
    assert right[-1][0] - left[-1][0] == pytest.approx(width, rel=0.06)
    assert np.hypot(*left[-1][:2]) < width
