# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab sensors list`` and ``show``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from taccel_lab.sensors.registry import sensor_families, sensor_family
from taccel_lab.studies.sensor_picture import pad_section, sight_paths
from tests.cli.conftest import Cli

NAMES = sorted(sensor_families())


def test_list(cli: Cli) -> None:
    text = cli("sensors list").out
    for name in NAMES:
        assert name in text
    listed = cli.json("sensors list")
    assert listed["broken"] == {}
    assert sorted(listed["sensors"]) == NAMES
    mini = listed["sensors"]["gelsight_mini"]
    assert mini["size_mm"] == "25.25 x 20.75 x 4"
    shown = (mini["image_px"], mini["mm_per_px"], mini["markers"])
    assert shown == ("320 x 240", "0.0634", "9 x 7")
    assert listed["sensors"]["9dtact"]["young_modulus_mpa"].count(",") == 1


@pytest.mark.parametrize("name", NAMES)
def test_show_every_family(name: str, cli: Cli) -> None:
    text = cli("sensors show", name).out
    for word in ("gel volume", "field of view", "LEDs", "housing", "young_modulus_mpa"):
        assert word in text
    shown = cli.json("sensors show", name)
    assert all(parameter["source"] for parameter in shown["parameters"].values())
    family = sensor_family(name)
    assert set(shown["parameters"]) == set(family.parameters_type.parameters())
    assert shown["optics"]["camera"]["width_px"] == family.parameters().grid().width_px
    assert list(shown["layers"]) == list(family.parameters().pad().layer_names)
    assert shown["housing"] and shown["references"]


def test_show_with_other_values(cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    change = ["--set", "thickness_mm=3", "marker_pitch_mm=0"]
    shown = cli.json("sensors show", "gelsight_mini", *change)
    assert shown["parameters"]["thickness_mm"]["source"] == "set by the user"
    assert shown["derived"]["gel under the apex"]["value"] == 3.0
    assert shown["markers"] is None
    shown = cli("sensors show gelsight_mini", *change).out
    assert "set; the default is 4.0" in " ".join(shown.split())


def test_camera_distance_moves_the_scale(cli: Cli) -> None:
    """Further away by 20 mm in air, with the same lens."""
    scales = []
    for distance in (20.8, 40.8):
        change = ["--set", "scale_from=focal_px", f"camera_distance_mm={distance}"]
        scales.append(cli.json("sensors show digit", *change)["image"]["mm_per_px_x"])
    assert scales[1] - scales[0] == pytest.approx(20.0 / 328.57, rel=1e-9)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ("gelsite", "gelsight"),
        ("digit --set mid_radius_mm=5", "mid_radius_mm = 5 is below its bound"),
        ("digit --set mid_radius_mm", "name=value"),
        ("digit --set crown=5", "no parameter 'crown'"),
        ("digit --picture digit.svg", "digit.svg must end in .png"),
    ],
)
def test_bad_input(arguments: str, told: str, cli: Cli) -> None:
    assert told in cli.refusal("sensors show", *arguments.split())


@pytest.mark.parametrize("name", ["9dtact", "digit_360", "rtac"])
def test_picture(name: str, tmp_path: Path, cli: Cli) -> None:
    path = tmp_path / f"{name}.png"
    assert path.name in cli("sensors show", name, "--picture", path).out.replace("\n", "")
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
