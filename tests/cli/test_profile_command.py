# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab profile``, ``sensors``, ``robot`` and ``export``."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import taccel_lab as tl
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import load_profile, save_profile
from taccel_lab.robots import names
from taccel_lab.sensors.registry import sensor_families, sensor_family
from taccel_lab.sensors.sensor_picture import pad_section, sight_paths
from tests.cli.conftest import Cli
from tests.robots.test_urdf import TETRAHEDRON, with_mesh
from tests.support.edited_profiles import edit, swap_network
from tests.support.robot_files import CHAIN, write
from tests.support.small_captures import write_profile
from tests.support.synthetic_presses import tiny_profile


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    profile = tiny_profile(PixelGrid(12, 9, 0.03, 0.03))
    made_up = profile.gel.provenance.replace(method="made up [bold]for[/] a test")
    profile = profile.with_block(profile.sensor.replace(name="unit 3", provenance=made_up))
    profile = profile.with_block(profile.material.replace(provenance=made_up))
    save_profile(profile, tmp_path / "p")
    return tmp_path / "p"


def test_show_and_report(folder: Path, tmp_path: Path, cli: Cli) -> None:
    text = cli("profile show", folder, "--full").out
    assert all(word in text for word in ("unit 3", "young_modulus_pa", "150000.0", "[bold]for[/]"))
    text = cli("profile show", folder).out
    assert len(text.splitlines()) <= 24  # One screen.
    assert all(word in text for word in ("material", "assumed", "1.5e+05", "--full"))
    blocks = cli.json("profile show", folder)
    assert list(blocks) == ["sensor", "gel", "material", "camera"]
    assert blocks["material"]["poisson_ratio"] == 0.48
    assert blocks["camera"]["provenance"]["kind"] == "assumed"
    cli("profile report", folder, "--out", tmp_path / "page")
    html = (tmp_path / "page" / "report.html").read_text(encoding="utf-8")
    assert "Sensor profile unit 3" in html and "made up [bold]for[/] a test" in html


def test_validate(folder: Path, cli: Cli) -> None:
    assert "is a sound profile" in cli("profile validate", folder).out
    (folder / "mesh.npz").write_bytes(b"PK")
    (folder / "notes.txt").write_text("mine")
    captured = cli("profile validate", folder, code=2)
    assert "mesh.npz: SHA-256" in captured.out and "warning" in captured.out
    assert "is not a sound profile: 1 error" in captured.err
    result = cli.json("profile validate", folder, code=2)
    assert result["valid"] is False
    assert [finding["severity"] for finding in result["findings"]] == ["error", "warning"]


@pytest.mark.parametrize(
    ("changes", "weights", "words"),
    [
        ({"foo": 3}, {}, "unknown \\['foo'\\]"),
        ({"hidden": [1_000_000_000]}, {}, "have shapes"),
        ({"hidden": "abc"}, {}, "wrong type"),
        ({}, {"extra": np.zeros(3, dtype=np.float32)}, "have shapes"),
        ({"output_scale": 5e3}, {}, "color model answers up to"),
        ({"width_px": 97}, {}, "97x72 px, the camera block says 96x72"),
    ],
)
def test_every_way_in_refuses_a_network_as_validate_does(
    changes: dict[str, object], weights: dict, words: str, tmp_path: Path, cli: Cli
) -> None:
    path = write_profile(tmp_path / "colored")
    cli("profile validate", path)
    profile = load_profile(path)
    assert profile.color is not None and profile.color_weights is not None
    settings = {**profile.color.architecture, **changes}
    weights = {**profile.color_weights, **weights}
    with pytest.raises(InputError, match=words):
        profile.with_block(profile.color.replace(architecture=settings), weights)
    swap_network(path, "color", settings, weights)
    _refused_by_all(path, words, cli)


def test_validate_and_press_judge_the_parameters(folder: Path, tmp_path: Path, cli: Cli) -> None:
    profile = load_profile(folder)
    parameters = {**profile.sensor.parameters, "thickness_mm": -5.0}
    path, words = tmp_path / "thin", "thickness_mm = -5 is below its bound"
    save_profile(profile.with_block(profile.sensor.replace(parameters=parameters)), path)
    _refused_by_all(path, f"sensor.parameters.{words}", cli)
    press = ["press", path, "--indenter", "sphere:4", "--depth-mm", "0.1", "--out", tmp_path / "o"]
    assert words in cli.refusal(*press)


def _refused_by_all(path: Path, words: str, cli: Cli) -> None:
    """What ``validate`` finds is what every reader says."""
    found = [str(one) for one in tl.validate_profile(path) if one.severity == "error"]
    assert re.search(words, "\n".join(found))
    for read in (load_profile, tl.load_sensor, sensor_family):
        with pytest.raises(InputError) as refused:
            read(str(path))
        assert str(refused.value).splitlines() == found
    told = cli.json("profile validate", path, code=2)
    assert [f"{one['where']}: {one['message']}" for one in told["findings"]] == found


def test_a_family_that_is_not_here_is_a_warning(folder: Path, cli: Cli) -> None:
    edit(folder, sensor={"family": "of_a_package", "parameters": {"width_mm": -5.0}})
    assert load_profile(folder).sensor.family == "of_a_package"
    assert "of_a_package is not in the catalogue" in cli("profile validate", folder).out


NAMES = sorted(sensor_families())


def test_lists(cli: Cli) -> None:
    text = cli("sensors list").out
    assert all(name in text for name in NAMES)
    listed = cli.json("sensors list")
    assert listed["broken"] == {} and sorted(listed["sensors"]) == NAMES
    mini = listed["sensors"]["gelsight_mini"]
    shown = [mini[key] for key in ("size_mm", "image_px", "mm_per_px", "markers")]
    assert shown == ["25.25 x 20.75 x 4", "320 x 240", "0.0634", "9 x 7"]
    assert listed["sensors"]["9dtact"]["young_modulus_mpa"].count(",") == 1

    text = cli("robot list").out
    assert all(name in text for name in names())
    listed = cli.json("robot list")
    assert list(listed) == names()
    assert listed["parallel_gripper"]["from"] == "taccel-lab"
    assert listed["panda"]["from"] == "example-robot-data"


@pytest.mark.thorough(cases=("digit",))
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
    command = "sensors show gelsight_mini --set thickness_mm=3 marker_pitch_mm=0"
    shown = cli.json(command)
    assert shown["parameters"]["thickness_mm"]["source"] == "set by the user"
    assert shown["derived"]["gel under the apex"]["value"] == 3.0
    assert shown["markers"] is None
    assert "set; the default is 4.0" in " ".join(cli(command).out.split())


@pytest.mark.thorough
def test_camera_distance_moves_the_scale(cli: Cli) -> None:
    """Further away by 20 mm in air, with the same lens."""
    command = "sensors show digit --set scale_from=focal_px camera_distance_mm"
    near, far = (cli.json(f"{command}={mm}")["image"]["mm_per_px_x"] for mm in (20.8, 40.8))
    assert far - near == pytest.approx(20.0 / 328.57, rel=1e-9)


@pytest.mark.thorough(cases=("9dtact", "rtac"))
@pytest.mark.parametrize("name", ["9dtact", "digit_360", "rtac"])
def test_picture(name: str, tmp_path: Path, cli: Cli) -> None:
    path = tmp_path / f"{name}.png"
    assert path.name in cli("sensors show", name, "--picture", path).out.replace("\n", "")
    assert path.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("name", NAMES)
def test_sight_lines_of_a_picture_end_on_the_contact_face(name: str) -> None:
    """Refracted by window and gel, they span the width that the image's scale states.

    To 6 %: the scale holds on the axis, and a calibrated lens distorts.
    """
    parameters = sensor_family(name).parameters()
    pad, design, grid = parameters.pad(), parameters.optics(), parameters.grid()
    assert design is not None
    for axis in (0, 1):
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
    if name in ("gelsight_mini", "digit", "9dtact", "gelsight_wedge"):
        left, _, right = sight_paths(pad, design, 0)
        width = grid.width_px * grid.mm_per_px_x
        assert right[-1][0] - left[-1][0] == pytest.approx(width, rel=0.06)
        assert np.hypot(*left[-1][:2]) < width


def test_show_of_a_robot_of_the_catalogue(cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "160")
    text = cli("robot show", "parallel_gripper").out
    for word in ("1 coordinates, base palm", "slide_right", "0 to 40 mm", "box 12 x 24 x 60 mm"):
        assert word in text
    assert "refused" not in text


@pytest.mark.thorough
def test_picture_of_a_robot(cli: Cli, tmp_path: Path) -> None:
    path = tmp_path / "hand.png"
    assert "hand.png" in cli("robot show three_finger_hand --picture", path).out.replace("\n", "")
    pixels = np.asarray(Image.open(path).convert("RGB")).astype(int)
    assert 0.1 < (pixels.min(axis=2) < 230).mean() < 0.9


def test_show_of_a_robots_file(cli: Cli, tmp_path: Path) -> None:
    shown = cli.json("robot show", write(tmp_path, CHAIN))
    assert shown["coordinates"] == ["shoulder", "lift", "spin"]
    joints, links = shown["joints"], shown["links"]
    assert joints["lift"]["limits"] == pytest.approx([-50, 100])
    assert joints["shoulder"]["limits"] == pytest.approx([-114.59156, 85.94367])
    assert (joints["lift"]["unit"], joints["spin"]["unit"]) == ("mm", "deg")
    assert joints["spin"]["limits"] == [None, None] and joints["spin"]["kind"] == "continuous"
    assert joints["follow"]["mimics"] == "shoulder" and joints["shoulder"]["max_effort"] == 7
    assert links["arm"] == {"mass_kg": 2.0, "shapes": ["box 20 x 30 x 200 mm"]}
    assert links["slide"]["shapes"] == ["sphere r 10 mm"]
    assert links["wheel"]["shapes"] == ["cylinder r 20, length 10 mm"]
    assert shown["refused"] == []
    # The second face is turned over.
    write(tmp_path, TETRAHEDRON.replace("f 1 2 4", "f 1 4 2"), "mesh.obj")
    path = write(tmp_path, with_mesh("mesh.obj"))
    assert "rejected: collision shape of link 'a': " in cli("robot show", path).out
    planar = write(tmp_path, CHAIN.replace('"continuous"', '"planar"'), "planar.urdf")
    assert "joint 'spin' is planar, which is not supported" in cli.refusal("robot show", planar)


def test_an_export_says_what_it_wrote_and_left_out(folder: Path, tmp_path: Path, cli: Cli) -> None:
    command = ("export", folder, "--to", "urdf", "--out", tmp_path / "out")
    text = cli(*command).out
    assert "left out" in text and "housing" in text
    assert (tmp_path / "out" / "sensor.urdf").is_file()
    assert cli.json(*command)["files"] == ["meshes/gel.stl", "sensor.urdf"]


def test_a_sensor_of_the_catalogue_stands_for_its_profile(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli
) -> None:
    """Where no folder has that name: a profile of one's own comes first."""
    monkeypatch.chdir(tmp_path)
    cli("export 9dtact --to urdf --out out")
    cli("profile report 9dtact --out page")
    assert "9dtact" in (tmp_path / "page" / "report.html").read_text(encoding="utf-8")
    folder.rename(tmp_path / "9dtact")
    cli("export 9dtact --to urdf --out mine")
    designed, own = (
        json.loads((tmp_path / name / "export.json").read_text()) for name in ("out", "mine")
    )
    assert designed["sensor"] == "9dtact" != own["sensor"]
