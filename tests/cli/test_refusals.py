# SPDX-License-Identifier: Apache-2.0
"""Bad captures, profiles, presses and designs: exit code 2, a sentence, no trace on the disk.

That damaged files are refused at all, `tests/fuzz` holds; here stand the sentences and the bounds.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import pyvista

from taccel_lab.profile import SCHEMA_VERSION
from tests.support.small_captures import background, refuse, write_image

Change = Callable[[Path], None]
Capsys = pytest.CaptureFixture[str]


def remove(name: str) -> Change:
    return lambda folder: (folder / name).unlink()


def cut(name: str, keep: float) -> Change:
    def change(folder: Path) -> None:
        data = (folder / name).read_bytes()
        (folder / name).write_bytes(data[: int(len(data) * keep)])

    return change


def rewrite(name: str, *changes: tuple[str, str]) -> Change:
    """Other words in the last place where the old ones stand in a file: in a profile, blocks come
    after the sensor's own parameters."""

    def change(folder: Path) -> None:
        text = (folder / name).read_text()
        for old, new in changes:
            assert old in text
            text = new.join(text.rsplit(old, 1))
        (folder / name).write_text(text)

    return change


# Captures ------------------------------------------------------------------------------------


def edit(old: str, new: str) -> Change:
    return rewrite("captures.toml", (old, new))


def empty(folder: Path) -> None:
    for path in folder.iterdir():
        path.unlink()


def other_size(folder: Path) -> None:
    write_image(folder / "p2.png", background()[:60])


def frame_without_contact(folder: Path) -> None:
    noise = np.random.default_rng(1).normal(0, 0.7, background().shape)
    write_image(folder / "p2.png", np.rint(background() + noise).clip(0, 255).astype(np.uint8))


THREE_TIMES_THE_SCALE = rewrite(
    "captures.toml",
    ("mm_per_px_x = 0.1", "mm_per_px_x = 0.3"),
    ("mm_per_px_y = 0.1", "mm_per_px_y = 0.3"),
    ("radius_mm = 2.0", "radius_mm = 6.0"),
)
CAPTURES: list[tuple[Change, list[str]]] = [
    (shutil.rmtree, ["captures does not exist", r"capture folder with captures\.toml"]),
    (empty, ["captures: an empty folder", r"holds captures\.toml"]),
    (remove("captures.toml"), ["captures: no manifest"]),
    (
        edit('background = "background.png"\n', ""),
        [r"captures\.toml: no background; give an image of the untouched sensor"],
    ),
    (
        other_size,
        [r"p2\.png is 96x60 px, the background .*background\.png is 96x72 px", "one size"],
    ),
    (frame_without_contact, [r"p2\.png: no contact found"]),
    (THREE_TIMES_THE_SCALE, [r"captures\.toml: at 0\.3 x 0\.3 mm/px", "pad of 24 x 20 mm"]),
    (edit('"gelsight"', '"gelsite"'), ["gelsite", "gelsight"]),
]


@pytest.mark.thorough(cases=("frame_without_contact-words5",))
@pytest.mark.parametrize(("change", "words"), CAPTURES)
def test_bad_captures(here: Path, capsys: Capsys, change: Change, words: list[str]) -> None:
    change(here / "captures")
    # The labelled circles as they are: fused with those found, a wrong label would be outvoted.
    command = ["calibrate", "color", "captures", "--circles", "labels"]
    refuse(command, words, capsys, ("earlier_profile",))


@pytest.mark.thorough(
    cases=("--holdout-every 6-captures\\\\.toml holds 5 presses, too few to hold out",)
)
@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--steps 0", "steps must be at least 1, got 0"),
        ("--holdout-every 1", "holdout_every must be 0 or at least 2, got 1"),
        ("--holdout-every 6", r"captures\.toml holds 5 presses, too few to hold out"),
        ("--base absent", "'absent' is neither a profile folder nor a sensor of the catalogue"),
    ],
)
def test_bad_options_of_calibrate(here: Path, capsys: Capsys, options: str, words: str) -> None:
    refuse(["calibrate", "color", "captures", *options.split()], [words], capsys, ("new/out",))


# Profiles ------------------------------------------------------------------------------------


def profile(old: str, new: str) -> Change:
    return rewrite("profile.toml", (old, new))


PROFILES: list[tuple[Change, list[str]]] = [
    (cut("mesh.npz", 0.7), [r"profile/mesh\.npz: SHA-256"]),
    (remove("profile.toml"), [r"profile\.toml: no such file"]),
    (
        profile(f"schema_version = {SCHEMA_VERSION}", f"schema_version = {SCHEMA_VERSION + 1}"),
        [r"profile\.toml: schema_version", "newer version of taccel-lab"],
    ),
    (
        profile("hidden = [\n    8,\n]", "hidden = [\n    9,\n]"),
        ["color model weights do not fit its settings", "expected"],
    ),
    (
        profile('family = "gelsight"', 'family = "gelsite"'),
        ["profile cannot be meshed", "gelsite", "known: ", "gelsight"],
    ),
    (
        profile("length_x_mm = 24.0", "length_x_mm = -24.0"),
        [r"sensor\.parameters\.length_x_mm = -24 is below its bound; allowed: 10 to 60"],
    ),
]


@pytest.mark.parametrize(("change", "words"), PROFILES)
def test_bad_profile(here: Path, capsys: Capsys, change: Change, words: list[str]) -> None:
    change(here / "profile")
    refuse(["press", "profile", "--depth-mm", "0.3"], words, capsys, ("new/out", "earlier"))


# Presses -------------------------------------------------------------------------------------

PRESSES = [
    # On the flank of the dome the gel is thinner than at the apex: 5 mm less 0.63 mm.
    (
        "--depth-mm 4.2 --at-mm 6.5 4.5 --mesh profile",
        r"depth 4\.2 mm goes past the gel, which is 4\.\d+ mm thick there; at most 3\.9",
    ),
    (
        "--at-mm 30 0",
        r"gelsight .* a press at \(30, 0\) mm.*outside the pad, which reaches over x \[-1",
    ),
    (
        "--at-mm 30 0 --mesh profile",
        r"at \(30, 0\) mm the indenter sphere:2\.0 misses the gel; x must lie in \[-12, 12\] mm",
    ),
    ("--tolerance 0", r"--tolerance: relative_tolerance must lie in \[1e-12, 1\]"),
    ("--dhat-mm 0", r"--dhat-mm: dhat_m must lie in \[1e-08, 0\.01\], got 0"),
    ("--indenter mesh:plane.stl", r"mesh plane\.stl is not closed: 40 edges belong to one face"),
]


@pytest.mark.thorough
@pytest.mark.parametrize(("options", "words"), PRESSES)
def test_bad_press(here: Path, capsys: Capsys, options: str, words: str) -> None:
    if "plane" in options:
        pyvista.Plane(i_size=3, j_size=3).triangulate().save(here / "plane.stl")
    words_of = options if "--depth" in options else f"--depth-mm 0.3 {options}"
    refuse(["press", "gelsight", *words_of.split()], [words], capsys)


def test_unknown_sensor(here: Path, capsys: Capsys) -> None:
    words = ["'gelsite' is neither a profile folder nor a sensor of the catalogue.*gelsight"]
    refuse(["press", "gelsite", "--depth-mm", "0.3"], words, capsys)


# Designs -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ("thickness_mm=-1", "thickness_mm = -1 is below its bound; allowed: 0.8 to 20 mm"),
        ("thickness_mm=2.0", r"thickness_mm must be at least 2\.54"),
        ("thickness_mm", "'thickness_mm' is not of the form name=value"),
        ("thickness_mm=4 thickness_mm=5", "thickness_mm is set twice"),
    ],
)
def test_bad_design(here: Path, capsys: Capsys, values: str, words: str) -> None:
    command = ["design", "gelsight", "--set", *values.split()]
    refuse(command, [words], capsys, ("new/out", "earlier"))


def test_bad_edge_length_of_a_design(
    here: Path, capsys: Capsys, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The solid comes first, and takes a second; the mesh, which is refused, does not need it.
    monkeypatch.setattr("taccel_lab.cad.parts.pad_solid.labelled_solid", lambda pad: None)
    refuse(["design", "gelsight", "--edge-mm", "1000"], ["edge_mm must lie in "], capsys)


# Outputs -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "command",
    [
        "press gelsight --depth-mm 0.3",
        "design gelsight",
        "calibrate color captures",
        "demo --captures captures",
    ],
)
@pytest.mark.parametrize("out", ["mine", "captures", "profile", "mine/notes.txt"])
def test_foreign_outputs_are_refused_before_any_work(
    here: Path, capsys: Capsys, forbid: Callable[[str], None], command: str, out: str
) -> None:
    (here / "mine").mkdir()
    (here / "mine" / "notes.txt").write_text("mine")
    if out == "profile" and command.startswith("calibrate"):
        pytest.skip("a calibration may replace a profile")
    for name in (
        "taccel_lab.calibration.capture.load_captures",
        "taccel_lab.sensors.profile.load_sensor",
        "taccel_lab.sensors.design.gel_mesh",
    ):
        forbid(name)
    words = r"notes\.txt is a file" if "notes" in out else f"{out} holds files that"
    refuse(command.split(), [words], capsys, (out,))
