# SPDX-License-Identifier: Apache-2.0
"""Bad profiles, presses, designs and outputs: exit code 2, a message, no trace on the disk."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from taccel_lab.profile import SCHEMA_VERSION
from tests.support.small_captures import GRID, refuse

Change = Callable[[Path], None]


def remove(name: str) -> Change:
    return lambda folder: (folder / name).unlink()


# Profiles ------------------------------------------------------------------------------------


def cut(name: str, keep: float) -> Change:
    def change(folder: Path) -> None:
        data = (folder / name).read_bytes()
        (folder / name).write_bytes(data[: int(len(data) * keep)])

    return change


def rewrite(old: str, new: str) -> Change:
    def change(folder: Path) -> None:
        text = (folder / "profile.toml").read_text()
        assert old in text
        # The last one: the blocks come after the sensor's own parameters.
        (folder / "profile.toml").write_text(new.join(text.rsplit(old, 1)))

    return change


PROFILES: dict[str, tuple[Change, list[str]]] = {
    "truncated mesh": (cut("mesh.npz", 0.7), [r"profile/mesh\.npz: SHA-256"]),
    "truncated weights": (
        cut("color_model.safetensors", 0.5),
        [r"profile/color_model\.safetensors: SHA-256"],
    ),
    "truncated TOML": (cut("profile.toml", 0.4), [r"profile/profile\.toml"]),
    "empty TOML": (cut("profile.toml", 0.0), [r"profile\.toml: schema_version"]),
    "no mesh": (remove("mesh.npz"), [r"profile/mesh\.npz: .*(missing|no such file)"]),
    "no TOML": (remove("profile.toml"), [r"profile\.toml: no such file"]),
    "newer schema": (
        rewrite(f"schema_version = {SCHEMA_VERSION}", f"schema_version = {SCHEMA_VERSION + 1}"),
        [r"profile\.toml: schema_version", "newer version of taccel-lab"],
    ),
    "unknown key": (
        rewrite("[gel]\n", '[gel]\ncolour = "red"\n'),
        [r"profile\.toml: gel\.colour: unknown key"],
    ),
    "incompressible": (
        rewrite("poisson_ratio = 0.46", "poisson_ratio = 0.5"),
        [r"material\.poisson_ratio: must be below 0\.5"],
    ),
    "negative modulus": (
        rewrite("young_modulus_pa = 150000.0", "young_modulus_pa = -150000.0"),
        [r"material\.young_modulus_pa: must lie in .* Pa, got -150000"],
    ),
    "NaN friction": (
        rewrite("friction_coefficient = 1.0", "friction_coefficient = nan"),
        [r"material\.friction_coefficient is nan.* finite"],
    ),
    "no thickness": (
        rewrite("thickness_mm = 5.0", "thickness_mm = 0.0"),
        [r"gel\.thickness_mm: must lie in"],
    ),
    "colour model of another network": (
        rewrite("hidden = [\n    8,\n]", "hidden = [\n    9,\n]"),
        ["color model weights have shapes", "expected"],
    ),
    "colour model of another image": (
        lambda folder: (
            rewrite("    8,\n]", "    8,\n]")(folder)
            or rewrite(
                f"[color.architecture]\nwidth_px = {GRID.width_px}",
                f"[color.architecture]\nwidth_px = {GRID.width_px + 1}",
            )(folder)
        ),
        [r"color\.architecture is for 97x72 px, the camera block says 96x72 px"],
    ),
}


@pytest.mark.parametrize("case", PROFILES)
def test_bad_profile(here: Path, capsys: pytest.CaptureFixture[str], case: str) -> None:
    change, words = PROFILES[case]
    change(here / "profile")
    refuse(["press", "profile", "--depth-mm", "0.3"], words, capsys, ("new/out", "earlier"))


def test_bad_profile_of_another_family(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rewrite('family = "gelsight"', 'family = "gelsite"')(here / "profile")
    words = ["profile cannot be meshed", "gelsite", "known: ", "gelsight"]
    refuse(["press", "profile", "--depth-mm", "0.3"], words, capsys)


def test_bad_design_parameter_in_a_profile(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rewrite("length_x_mm = 24.0", "length_x_mm = -24.0")(here / "profile")
    words = [r"sensor\.parameters\.length_x_mm = -24 is below its bound; allowed: 10 to 60"]
    refuse(["press", "profile", "--depth-mm", "0.3"], words, capsys)


# Presses -------------------------------------------------------------------------------------

PRESSES: list[tuple[list[str], list[str]]] = [
    (["--depth-mm", "0"], ["depth must be above 0 mm, got 0 mm"]),
    (["--depth-mm", "-0.5"], ["depth must be above 0 mm, got -0.5 mm"]),
    (["--depth-mm", "5"], ["depth 5 mm goes past the gel, which is 5 mm thick.*4.5 mm"]),
    (["--depth-mm", "4.6"], ["depth 4.6 mm goes past the gel.*at most 4.5 mm"]),
    (["--depth-mm", "1e300"], [r"depth must be at most 100 mm, got 1e\+300 mm"]),
    # On the flank of the dome the gel is thinner than at the apex: 5 mm less 0.63 mm.
    (
        ["--depth-mm", "4.2", "--at-mm", "6.5", "4.5", "--mesh", "profile"],
        [r"depth 4\.2 mm goes past the gel, which is 4\.\d+ mm thick there; at most 3\.9"],
    ),
    (
        ["--depth-mm", "0.3", "--at-mm", "30", "0"],
        [r"gelsight .* a press at \(30, 0\) mm", r"outside the pad, which reaches over x \[-1"],
    ),
    (
        ["--depth-mm", "0.3", "--at-mm", "30", "0", "--mesh", "profile"],
        [r"at \(30, 0\) mm the indenter sphere:2\.0 misses the gel; x must lie in \[-12, 12\] mm"],
    ),
    (
        ["--depth-mm", "0.3", "--at-mm", "1e308", "0"],
        [r"at_mm = \(1e\+308, 0\) lies outside the pad"],
    ),
    (["--depth-mm", "0.3", "--at-mm", "11.5", "0"], ["at_mm", "at least 1.5 mm"]),
    (["--depth-mm", "0.3", "--shear-mm", "50", "0"], [r"shear must lie within \+-20 mm"]),
    (["--depth-mm", "0.3", "--twist-deg", "400"], [r"twist must lie within \+-180 deg, got 400"]),
    (["--depth-mm", "0.3", "--step-mm", "0"], ["step_mm and step_deg must be above 0, got 0"]),
    (["--depth-mm", "0.3", "--step-mm", "1e-9"], ["step_mm 1e-09.*more than 10000 steps"]),
    (["--depth-mm", "0.3", "--step-deg", "-2"], ["step_mm and step_deg must be above 0"]),
    (["--depth-mm", "0.3", "--friction", "-1"], [r"--friction: friction .* \[0, 10\], got -1"]),
    (
        ["--depth-mm", "0.3", "--tolerance", "0"],
        [r"--tolerance: relative_tolerance must lie in \[1e-12, 1\]"],
    ),
    (
        ["--depth-mm", "0.3", "--dhat-mm", "0"],
        [r"--dhat-mm: dhat_m must lie in \[1e-08, 0\.01\], got 0"],
    ),
    (["--depth-mm", "0.3", "--dhat-mm", "-0.1"], ["dhat_m must lie in"]),
    (["--depth-mm", "0.3", "--device", "cuda:7"], ["device 'cuda:7' is not there.*has: cpu"]),
    (["--depth-mm", "0.3", "--indenter", "sphere:-2"], [r"sphere:-2.*\[0\.05, 100\] mm, got -2"]),
    (["--depth-mm", "0.3", "--indenter", "sphere:0"], [r"\[0\.05, 100\] mm, got 0 mm"]),
    (
        ["--depth-mm", "0.3", "--indenter", "cube:2"],
        ["'cube:2' is not understood; allowed: sphere"],
    ),
    (
        ["--depth-mm", "0.3", "--indenter", "mesh:a.stl"],
        [r"a\.stl does not exist; expected a triangle mesh"],
    ),
]


@pytest.mark.parametrize(("options", "words"), PRESSES)
def test_bad_press(
    here: Path, capsys: pytest.CaptureFixture[str], options: list[str], words: list[str]
) -> None:
    refuse(["press", "gelsight", *options], words, capsys)


def test_unknown_sensor(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["'gelsite' is neither a profile folder nor a sensor of the catalogue.*gelsight"]
    refuse(["press", "gelsite", "--depth-mm", "0.3"], words, capsys)


def test_mesh_indenter_that_is_not_closed(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import pyvista

    pyvista.Plane(i_size=3, j_size=3).triangulate().save(here / "plane.stl")
    command = ["press", "gelsight", "--depth-mm", "0.3", "--indenter", "mesh:plane.stl"]
    refuse(
        command, [r"indenter mesh plane\.stl is not closed: 40 edges belong to one face"], capsys
    )


def test_indenter_that_starts_inside_the_gel(
    here: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """No input is known that leads there; were first touch found too deep, it would be refused."""
    monkeypatch.setattr("taccel_lab.envs.press.first_touch_m", lambda *_: 1.5e-3)
    refuse(["press", "gelsight", "--depth-mm", "0.3"], ["'sphere:2.0' starts inside 'gel'"], capsys)


# Designs -------------------------------------------------------------------------------------

DESIGNS: list[tuple[list[str], list[str]]] = [
    (
        ["--set", "thickness_mm=-1"],
        [r"thickness_mm = -1 is below its bound; allowed: 0.8 to 20 mm"],
    ),
    (["--set", "thickness_mm=0"], ["thickness_mm", "0.8"]),
    (["--set", "thickness_mm=nan"], ["thickness_mm = 'nan' is not a number"]),
    (["--set", "thickness_mm=1e9"], ["thickness_mm", "20"]),
    (["--set", "thickness_mm=thick"], ["thickness_mm = 'thick' is not a number"]),
    (["--set", "thickness_mm=2.0"], [r"thickness_mm must be at least 2\.54"]),
    (["--set", "poisson_ratio=0.5"], ["poisson_ratio", r"0\.499"]),
    (["--set", "poisson_ratio=0.7"], ["poisson_ratio", r"0\.499"]),
    (["--set", "young_modulus_mpa=0"], ["young_modulus_mpa", r"0\.005"]),
    (["--set", "young_modulus_mpa=-0.15"], ["young_modulus_mpa", r"0\.005"]),
    (["--set", "young_modulus_mpa=150000"], ["young_modulus_mpa", "5 MPa"]),
    (["--set", "friction=-0.1"], ["friction"]),
    (["--set", "density_kg_m3=inf"], ["density_kg_m3"]),
    (["--set", "width_px=640.5"], ["width_px = 640.5 is not a whole number"]),
    (["--set", "colour=red"], ["no parameter 'colour'; known: .*thickness_mm"]),
    (["--set", "thickness_mm"], ["'thickness_mm' is not of the form name=value"]),
    (["--set", "thickness_mm=4", "thickness_mm=5"], ["thickness_mm is set twice"]),
]


@pytest.mark.parametrize(("options", "words"), DESIGNS)
def test_bad_design(
    here: Path, capsys: pytest.CaptureFixture[str], options: list[str], words: list[str]
) -> None:
    refuse(["design", "gelsight", *options], words, capsys, ("new/out", "earlier"))


@pytest.mark.parametrize("edge", ["0", "-1", "1000"])
def test_bad_edge_length_of_a_design(
    here: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, edge: str
) -> None:
    # The solid comes first, and takes a second; the mesh, which is refused, does not need it.
    monkeypatch.setattr("taccel_lab.cad.parts.pad_solid.labelled_solid", lambda pad: None)
    refuse(["design", "gelsight", "--edge-mm", edge], ["edge_mm = .* is not allowed; use"], capsys)


# Outputs -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "command",
    [
        ["press", "gelsight", "--depth-mm", "0.3"],
        ["design", "gelsight"],
        ["calibrate", "color", "captures"],
        ["demo", "--captures", "captures"],
    ],
)
@pytest.mark.parametrize(
    ("out", "words"),
    [
        ("mine", [r"mine holds files that"]),
        ("captures", [r"captures holds files that"]),
        ("mine/notes.txt", [r"notes\.txt is a file"]),
    ],
)
def test_foreign_outputs_are_refused_before_any_work(
    here: Path,
    capsys: pytest.CaptureFixture[str],
    forbid: Callable[[str], None],
    command: list[str],
    out: str,
    words: list[str],
) -> None:
    (here / "mine").mkdir()
    (here / "mine" / "notes.txt").write_text("mine")
    for name in (
        "taccel_lab.calibration.capture.load_captures",
        "taccel_lab.sensors.profile.load_sensor",
        "taccel_lab.sensors.design.gel_mesh",
    ):
        forbid(name)
    refuse(command, words, capsys, (out,))


def test_a_profile_is_not_overwritten_by_a_press(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["press", "gelsight", "--depth-mm", "0.3"]
    refuse(command, ["profile holds files that taccel-lab did not write"], capsys, ("profile",))
