# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab profile``, ``sensors``, ``robot`` and ``export``."""

from __future__ import annotations

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


def test_show(folder: Path, tmp_path: Path, cli: Cli) -> None:
    text = cli("profile show", folder, "--full").out
    for expected in ("unit 3", "young_modulus_pa", "150000.0", "[bold]for[/]"):
        assert expected in text
    text = cli("profile show", folder).out
    assert len(text.splitlines()) <= 24  # One screen.
    for word in ("material", "assumed", "1.5e+05", "--full"):
        assert word in text
    assert "none" in cli.refusal("profile show", tmp_path / "none")
    blocks = cli.json("profile show", folder)
    assert list(blocks) == ["sensor", "gel", "material", "camera"]
    assert blocks["material"]["poisson_ratio"] == 0.48
    assert blocks["camera"]["provenance"]["kind"] == "assumed"


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
    settings, weights = (
        {**profile.color.architecture, **changes},
        {**profile.color_weights, **weights},
    )
    block = profile.color.replace(architecture=settings)
    with pytest.raises(InputError, match=words):
        profile.with_block(block, weights)
    swap_network(path, "color", settings, weights)
    _refused_by_all(path, words, cli)


def test_validate_and_press_judge_the_parameters(folder: Path, tmp_path: Path, cli: Cli) -> None:
    profile = load_profile(folder)
    parameters = {**profile.sensor.parameters, "thickness_mm": -5.0}
    path = tmp_path / "thin"
    save_profile(profile.with_block(profile.sensor.replace(parameters=parameters)), path)
    _refused_by_all(path, "sensor.parameters.thickness_mm = -5 is below its bound", cli)
    press = ["press", path, "--indenter", "sphere:4", "--depth-mm", "0.1", "--out", tmp_path / "o"]
    assert "thickness_mm = -5 is below its bound" in cli.refusal(*press)


def _refused_by_all(path: Path, words: str, cli: Cli) -> None:
    """What ``validate`` finds is what every reader says."""
    found = [str(one) for one in tl.validate_profile(path) if one.severity == "error"]
    assert re.search(words, "\n".join(found))
    for read in (load_profile, tl.load_profile, tl.load_sensor, sensor_family):
        with pytest.raises(InputError) as refused:
            read(str(path))
        assert str(refused.value).splitlines() == found
    told = cli.json("profile validate", path, code=2)
    assert [f"{one['where']}: {one['message']}" for one in told["findings"]] == found


def test_a_family_that_is_not_here_is_a_warning(folder: Path, cli: Cli) -> None:
    edit(folder, sensor={"family": "of_a_package", "parameters": {"width_mm": -5.0}})
    assert load_profile(folder).sensor.family == "of_a_package"
    assert "of_a_package is not in the catalogue" in cli("profile validate", folder).out


def test_report_writes_a_page(folder: Path, tmp_path: Path, cli: Cli) -> None:
    cli("profile report", folder, "--out", tmp_path / "page")
    html = (tmp_path / "page" / "report.html").read_text(encoding="utf-8")
    assert "Sensor profile unit 3" in html and "made up [bold]for[/] a test" in html


def test_missing_profiles_and_foreign_folders_are_refused(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli
) -> None:
    monkeypatch.chdir(tmp_path)
    command = ["profile", "report", "--out", "page"]
    assert "no such profile folder" in cli.refusal(*command, "nowhere")
    (tmp_path / "page").mkdir()
    (tmp_path / "page" / "mine.txt").write_text("keep")
    assert "did not write" in cli.refusal(*command, folder)
    assert (tmp_path / "page" / "mine.txt").read_text() == "keep"


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
    change = ["--set", "thickness_mm=3", "marker_pitch_mm=0"]
    shown = cli.json("sensors show", "gelsight_mini", *change)
    assert shown["parameters"]["thickness_mm"]["source"] == "set by the user"
    assert shown["derived"]["gel under the apex"]["value"] == 3.0
    assert shown["markers"] is None
    shown = cli("sensors show gelsight_mini", *change).out
    assert "set; the default is 4.0" in " ".join(shown.split())


@pytest.mark.thorough
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
        ("digit --picture digit.svg", "digit.svg must end in .png"),
    ],
)
def test_bad_input(arguments: str, told: str, cli: Cli) -> None:
    assert told in cli.refusal("sensors show", *arguments.split())


@pytest.mark.thorough(cases=("9dtact", "rtac"))
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


def test_robots_are_listed(cli: Cli) -> None:
    text = cli("robot list").out
    assert all(name in text for name in names())
    listed = cli.json("robot list")
    assert list(listed) == names()
    assert listed["parallel_gripper"]["from"] == "taccel-lab"
    assert listed["panda"]["from"] == "example-robot-data"


def test_show_of_the_catalogue(cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "160")
    text = cli("robot show", "parallel_gripper").out
    for word in ("1 coordinates, base palm", "slide_right", "0 to 40 mm", "box 12 x 24 x 60 mm"):
        assert word in text
    assert "refused" not in text


@pytest.mark.thorough
def test_picture_of_a_robot(cli: Cli, tmp_path: Path) -> None:
    path = tmp_path / "hand.png"
    shown = cli("robot show three_finger_hand --picture", path).out
    assert "hand.png" in shown.replace("\n", "")
    pixels = np.asarray(Image.open(path).convert("RGB")).astype(int)
    covered = (pixels.min(axis=2) < 230).mean()
    assert 0.1 < covered < 0.9
    wrong = tmp_path / "hand.jpg"
    assert "must end in .png" in cli.refusal("robot show", "three_finger_hand", "--picture", wrong)


def test_show_of_a_file(cli: Cli, tmp_path: Path) -> None:
    shown = cli.json("robot show", str(write(tmp_path, CHAIN)))
    assert shown["coordinates"] == ["shoulder", "lift", "spin"]
    joints = shown["joints"]
    assert joints["lift"]["limits"] == pytest.approx([-50, 100])
    assert joints["shoulder"]["limits"] == pytest.approx([-114.59156, 85.94367])
    assert (joints["lift"]["unit"], joints["spin"]["unit"]) == ("mm", "deg")
    assert joints["spin"]["limits"] == [None, None] and joints["spin"]["kind"] == "continuous"
    assert joints["follow"]["mimics"] == "shoulder" and joints["shoulder"]["max_effort"] == 7
    assert shown["links"]["arm"] == {"mass_kg": 2.0, "shapes": ["box 20 x 30 x 200 mm"]}
    assert shown["links"]["slide"]["shapes"] == ["sphere r 10 mm"]
    assert shown["links"]["wheel"]["shapes"] == ["cylinder r 20, length 10 mm"]
    assert shown["refused"] == []


def test_what_is_refused_is_shown(cli: Cli, tmp_path: Path) -> None:
    # The second face is turned over.
    write(tmp_path, TETRAHEDRON.replace("f 1 2 4", "f 1 4 2"), "mesh.obj")
    path = write(tmp_path, with_mesh("mesh.obj"))
    assert "rejected: collision shape of link 'a': " in cli("robot show", path).out
    planar = write(tmp_path, CHAIN.replace('"continuous"', '"planar"'), "planar.urdf")
    assert "joint 'spin' is planar, which is not supported" in cli.refusal("robot show", planar)
    told = cli.refusal("robot show hand")
    assert "'hand' is neither a file nor a robot of the catalogue: par" in told


def test_an_export_says_what_it_wrote_and_left_out(folder: Path, tmp_path: Path, cli: Cli) -> None:
    out = tmp_path / "out"
    text = cli("export", folder, "--to", "urdf", "--out", out).out
    assert "left out" in text and "housing" in text
    assert (out / "sensor.urdf").is_file()
    files = cli.json("export", folder, "--to", "urdf", "--out", out)["files"]
    assert files == ["meshes/gel.stl", "sensor.urdf"]


def test_refusals(folder: Path, tmp_path: Path, cli: Cli) -> None:
    out = tmp_path / "out"
    told = cli.refusal("export", folder, "--to", "taxim", "--out", out)
    assert "block color" in told and "taccel-lab calibrate color" in told
    # The profile's own folder was not written by an export.
    assert "did not write" in cli.refusal("export", folder, "--to", "urdf", "--out", folder)
    assert (folder / "profile.toml").is_file() and not out.exists()
