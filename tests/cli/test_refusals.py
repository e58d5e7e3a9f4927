# SPDX-License-Identifier: Apache-2.0
"""Bad words, captures and profiles: exit code 2, a sentence, no work, no trace on the disk.

That damaged files are refused at all, `tests/fuzz` holds; here stand the sentences and the bounds.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.profile import SCHEMA_VERSION
from tests.cli.conftest import Cli, use
from tests.support.small_captures import background, write_image

PRESS = "press gelsight --depth-mm 0.3 --out earlier"
COLOR = "calibrate color captures --out new/out"
RECORD = "capture record flat_pad --camera set --out out"
FACTS = "--radius-mm 2 --mm-per-px-x 0.1 --no-page"
LIVE = "live bare --camera set --no-page --no-paced"
FOREIGN = "holds files that taccel-lab did not write"
REFUSALS = {
    PRESS: {
        "--at-mm 30 0": "for a press at (30, 0) mm ... outside the pad, which reaches over x [-12",
        "--at-mm 30 0 --mesh profile": "at (30, 0) mm the indenter sphere:2.0 misses the gel; "
        "x must lie in [-12, 12] mm",
        "--tolerance 0": "--tolerance: relative_tolerance must lie in [1e-12, 1]",
        "--dhat-mm 0": "--dhat-mm: dhat_m must lie in [1e-08, 0.01], got 0",
        "--indenter mesh:plane.stl": "mesh plane.stl is not closed: 40 edges belong to one face",
        "--texture none.png": "none.png",
        "--out captures": FOREIGN,
    },
    # On the flank of the dome the gel is thinner than at the apex: 5 mm less 0.63 mm.
    "press gelsight --depth-mm 4.2 --at-mm 6.5 4.5 --mesh profile --out new/out": {
        "": "depth 4.2 mm goes past the gel, which is 4. ... mm thick there; at most 3.9",
    },
    "press gelsite --depth-mm 0.3 --out earlier": {
        "": "'gelsite' is neither a profile folder nor a sensor of the catalogue ... gelsight",
    },
    "demo --captures captures --out out": {
        "--depth-mm 5.2": "demo has no option --depth-mm",
    },
    "design gelsight --out earlier --set": {
        "thickness_mm=-1": "thickness_mm = -1 is below its bound; allowed: 0.8 to 20 mm",
        "thickness_mm=2.0": "thickness_mm must be at least 2.54",
        "thickness_mm": "'thickness_mm' is not of the form name=value",
        "thickness_mm=4 thickness_mm=5": "thickness_mm is set twice",
    },
    COLOR: {
        "--steps 0": "steps must be at least 1, got 0",
        "--holdout-every 1": "--holdout-every must be 0 or at least 2, got 1",
        "--holdout-every 6": "captures.toml holds 5 presses, too few to hold out",
        "--base absent": "'absent' is neither a profile folder nor a sensor of the catalogue",
    },
    "calibrate": {
        "all captures --out unit --only markers": "nothing could be calibrated",
        "camera boardless --out out --base profile": "no board was found",
        "scale boardless --out out --base profile": "nothing of known length",
        "depth captures --out out --maps captures/p3.png": "not a readable .npz",
        "force plain --out out": "holds no data set",
        "material captures --out out": "[[records]]",
    },
    "calibrate material records --out out --fix": {
        "nu": "name=value",
        "stiffness=3": "cannot be held",
        "mooney_ratio=0.2": "--model mooney_rivlin",
        "friction=7": "friction must lie in [0, 5]",
    },
    "depth profile": {
        "captures/p3.png --out out": "neither a normals nor a depth_response",
        "nothing.png --out out": "does not exist",
        "captures/p3.png captures/p3.png --out out": "named alike",
        "captures --out out": "captures is a folder; name its images, as captures/*.png does",
    },
    "force": {
        "profile captures/p3.png": "no force block",
        "touch/profile none.png": "does not exist",
        "touch/profile plain/a.png": "64x48 px",
    },
    "live": {
        "bare --camera set --no-page --no-paced": "calibrate one first",
        "bare --camera set --no-page --no-paced --frames 0": "",
        "bare --camera set --no-page --no-paced --background profile": "has no background",
        "left=bare --camera left=set,right=set --no-page": "PROFILE has none for right; add right=",
        "left=bare,thumb=bare --camera left=set,right=set": "PROFILE names thumb, --camera does",
        "left=bare,thumb=bare --camera left=set,set": "left=A,right=B",
        "left=bare,thumb=bare --camera left=a,left=b": "may stand once",
    },
    "capture": {
        "check gone": "gone does not exist",
        "check empty": "follows none of the layouts known",
        "check captures --report captures": FOREIGN,
        "import gone out": "gone does not exist",
        "import captures out": "is a capture folder already",
        "import plain out --sensor gelsite": "gelsite",
        "import plain out --mm-per-px-y 0.1": "mm-per-px-x",
        "import plain out --background gone.png": "no such background image",
        "import plain captures": FOREIGN,
        "guide gelsite": "no sensor 'gelsite' (did you mean gelsight?)",
        "guide digit --out captures/captures.toml": "exists; name a file",
        "guide digit --out captures/captures.toml/x": "part of this path is a file",
    },
    RECORD: {
        "": "--radius-mm",
        f"{FACTS} --camera nowhere": "nowhere",
        f"{FACTS} --crop all": "--crop is 'all'",
        f"{FACTS} --scale later": "give one",
        "--radius-mm 0.001": "--radius-mm is 0.001",
        f"{FACTS} --presses 0": "--presses is 0",
        f"{FACTS} --mm-per-px-x 50": "mm/px is allowed",
    },
    "study": {
        "": "name a study file",
        "none.toml": "none.toml does not exist",
        "none": "no example has that name; known: design_track, digit_curvature,",
        "study.toml --limit 0": "limit must be at least 1",
        "study.toml --processes 0": "processes must lie in 1..1024",
        "study.toml --out .": "holds files and no study",
        "study.toml --out study.toml": "is a file",
        "study.toml --out new --report-only": "holds no study",
        "rang.toml": "no metric 'rang' (did you mean range?)",
    },
    "bench": {"sped": "taccel-lab bench has no command 'sped' (did you mean speed?)"},
    "dataset": {
        "chek set": "taccel-lab dataset has no command 'chek' (did you mean check?)",
        "set.toml --out out --shard 3/2": "shard '3/2' is not understood",
        "sizes.toml --out out --check-only": "output.sizes_px: unknown key (did you mean size_px?)",
    },
    "task": {
        "run juggle --out out": "no task 'juggle'; taccel-lab task list lists all",
        "run peg-insertion --out out --seeds 0": "seeds must lie in 1..100000, got 0",
        "run peg-insertion --out out --environments 0": "environments must lie in 1..100000",
        "record peg-insertion --out out --seed -1": "seed must lie in 0..99999, got -1",
        "run peg-insertion --out out --device tpu": "tpu",
        "run nowhere.toml --out out": "nowhere.toml",
    },
    "profile": {
        "show none": "none",
        "report nowhere --out page": "no such profile folder",
        "report profile --out mine": "did not write",
    },
    "export": {
        "bare --to taxim --out out": "block color ... taccel-lab calibrate color",
        # The profile's own folder was not written by an export.
        "profile --to urdf --out profile": "did not write",
    },
    "sensors show": {
        "gelsite": "gelsight",
        "digit --set mid_radius_mm=5": "mid_radius_mm = 5 is below its bound",
        "digit --picture digit.svg": "digit.svg must end in .png",
    },
    "robot show": {
        "hand": "'hand' is neither a file nor a robot of the catalogue (did you mean panda",
        "three_finger_hand --picture hand.jpg": "must end in .png",
    },
}
DEAR = {PRESS: {"--at-mm 30 0 --mesh profile"}, COLOR: {"--holdout-every 6"}}


@pytest.mark.thorough(cases=("press 0",))
@pytest.mark.parametrize(
    ("words", "says"),
    [
        pytest.param(
            f"{command} {more}",
            says,
            id=f"{command.split()[0]} {more}",
            marks=pytest.mark.thorough if more in DEAR.get(command, ()) else (),
        )
        for command, rows in REFUSALS.items()
        for more, says in rows.items()
    ],
)
@pytest.mark.usefixtures("no_work")
def test_bad_words(
    words: str, says: str, room: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(room)
    if words.startswith("study"):
        use(monkeypatch)
    cli.refuses(says.split(" ... "), words)


def test_bad_edge_length_of_a_design(here: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    # The solid comes first, and takes a second; the mesh, which is refused, does not need it.
    monkeypatch.setattr("taccel_lab.cad.parts.pad_solid.labelled_solid", lambda pad: None)
    cli.refuses(["edge_mm must lie in "], "design gelsight --edge-mm 1000 --out earlier")


Change = Callable[[Path], object]


def empty(folder: Path) -> None:
    for path in folder.iterdir():
        path.unlink()


def other_size(folder: Path) -> None:
    write_image(folder / "p2.png", background()[:60])


def no_contact(folder: Path) -> None:
    noise = np.random.default_rng(1).normal(0, 0.7, background().shape)
    write_image(folder / "p2.png", np.rint(background() + noise).clip(0, 255).astype(np.uint8))


def edit(*changes: tuple[str, str], name: str = "captures.toml") -> Change:
    """Other words in the last place where the old ones stand in a file: in a profile, blocks come
    after the sensor's own parameters."""

    def change(folder: Path) -> None:
        text = (folder / name).read_text()
        for old, new in changes:
            assert old in text
            text = new.join(text.rsplit(old, 1))
        (folder / name).write_text(text)

    return change


def unlabelled(folder: Path) -> None:
    path = folder / "captures.toml"
    path.write_text(path.read_text().replace("contact = {", "# contact = {"))


LARGER = ("mm_per_px_x = 0.1", "mm_per_px_x = 0.3"), ("mm_per_px_y = 0.08", "mm_per_px_y = 0.24")
profile = partial(edit, name="profile.toml")
# The labelled circles as they are: fused with those found, a wrong label would be outvoted.
LABELS = "calibrate color captures --circles labels --out earlier_profile"
NORMALS = "calibrate normals captures --circles labels --out out"
PRESSED = "press profile --depth-mm 0.3 --out new/out"
CHANGES: list[tuple[str, Change, list[str]]] = [
    (LABELS, shutil.rmtree, ["captures does not exist", "capture folder with captures.toml"]),
    (LABELS, empty, ["captures: an empty folder", "holds captures.toml"]),
    (LABELS, lambda folder: (folder / "captures.toml").unlink(), ["captures: no manifest"]),
    (
        LABELS,
        edit(('background = "background.png"\n', "")),
        ["captures.toml: no background; give an image of the untouched sensor"],
    ),
    (LABELS, other_size, ["p2.png is 96x60 px, the background ", "is 96x72 px", "one size"]),
    (LABELS, no_contact, ["p2.png: no contact found"]),
    (
        LABELS,
        edit(*LARGER, ("radius_mm = 2.0", "radius_mm = 6.0")),
        ["captures.toml: at 0.3 x 0.24 mm/px", "pad of 24 x 20 mm"],
    ),
    (LABELS, edit(('"gelsight"', '"gelsite"')), ["gelsite", "gelsight"]),
    (NORMALS, unlabelled, ["presses come without"]),
    (PRESSED, lambda f: (f / "mesh.npz").write_bytes(b"PK"), ["profile/mesh.npz: SHA-256"]),
    (PRESSED, lambda f: (f / "profile.toml").unlink(), ["profile.toml: no such file"]),
    (
        PRESSED,
        profile((f"schema_version = {SCHEMA_VERSION}", f"schema_version = {SCHEMA_VERSION + 1}")),
        ["profile.toml: schema_version", "newer version of taccel-lab"],
    ),
    (
        PRESSED,
        profile(("hidden = [\n    8,\n]", "hidden = [\n    9,\n]")),
        ["color model weights do not fit its settings", "expected"],
    ),
    (
        PRESSED,
        profile(('family = "gelsight"', 'family = "gelsite"')),
        ["profile cannot be meshed", "gelsite", "did you mean gelsight?"],
    ),
    (
        PRESSED,
        profile(("length_x_mm = 24.0", "length_x_mm = -24.0")),
        ["sensor.parameters.length_x_mm = -24 is below its bound; allowed: 10 to 60"],
    ),
]


@pytest.mark.thorough(cases=("no_contact",))
@pytest.mark.parametrize(
    ("words", "change", "says"),
    CHANGES,
    ids=[getattr(change, "__name__", "") or says[0] for _, change, says in CHANGES],
)
@pytest.mark.usefixtures("no_work")
def test_bad_files(words: str, change: Change, says: list[str], here: Path, cli: Cli) -> None:
    change(here / words.split()[1 if words == PRESSED else 2])
    cli.refuses(says, words)
