# SPDX-License-Identifier: Apache-2.0
"""Outputs that cannot be written and paths that lead nowhere: refused before any work, by all."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest

from taccel_lab.cli.calibration_outputs import report_folder
from taccel_lab.datasets.folder import ABOUT
from taccel_lab.errors import InputError
from taccel_lab.files.inner_path import WHOLES, require_outside
from taccel_lab.profile import save_profile
from taccel_lab.profile.io import PROFILE_FILE
from taccel_lab.studies.evaluate.study_folder import STUDY_MARKER
from tests.cli.conftest import Cli
from tests.support.small_captures import everything_below
from tests.support.synthetic_presses import GRID, flat_profile

FILES = {
    "capture guide": "capture guide gelsight --out OUT/x.toml",
    "sensors show": "sensors show flat_pad --picture OUT/x.png",
}
"""Commands whose output is a file, which lies anywhere by its own name."""
COMMANDS = {
    "press": "press gelsight --depth-mm 0.5 --out OUT",
    "preview": "preview gelsight --out OUT",
    "design": "design gelsight --out OUT",
    "study": "study STUDY --processes 1 --out OUT",
    "calibrate color": "calibrate color CAPTURES --out OUT",
    "calibrate color's profile": "calibrate color CAPTURES --report FREE --out OUT",
    "calibrate all": "calibrate all CAPTURES --out OUT",
    "export": "export PROFILE --to taxim --out OUT",
    "capture check": "capture check CAPTURES --report OUT",
    "capture import": "capture import CAPTURES OUT --layout plain",
    "profile report": "profile report PROFILE --out OUT",
    "depth": "depth PROFILE IMAGE --out OUT",
    "demo": "demo --captures CAPTURES --out OUT",
    "task run": "task run touch-insertion --out OUT",
    **FILES,
}


def words_of(command: str, places: dict[str, str], out: Path | str, tmp_path: Path) -> list[str]:
    """A command's words, with what it reads and where it writes."""
    words = COMMANDS[command]
    for name, value in {**places, "OUT": str(out), "FREE": str(tmp_path / "free")}.items():
        words = words.replace(name, value)
    return words.split()


@pytest.mark.thorough(cases=("press-/proc/x",))
@pytest.mark.parametrize("bad", ["/proc/x", "FILE", "FILE/inside", "FOREIGN"])
@pytest.mark.parametrize("command", COMMANDS)
def test_it_is_refused_before_any_work(
    command: str,
    bad: str,
    places: dict[str, str],
    tmp_path: Path,
    cli: Cli,
    forbid: Callable[[str], None],
) -> None:
    if bad == "FOREIGN" and command in FILES:
        pytest.skip("a file may lie among others")
    for name in ("sensors.profile.load_sensor", "sensors.design.gel_mesh"):
        forbid(f"taccel_lab.{name}")
    (tmp_path / "file").write_text("mine")
    (tmp_path / "foreign").mkdir()
    (tmp_path / "foreign" / "notes.txt").write_text("mine")
    before = everything_below(tmp_path)
    out = bad if bad.startswith("/") else str(tmp_path / bad.lower())
    started = time.process_time()
    noted = cli(*words_of(command, places, out, tmp_path), code=2).err
    assert time.process_time() - started < 15
    assert out.partition("/inside")[0] in noted.replace("\n", ""), noted
    assert everything_below(tmp_path) == before


@pytest.mark.parametrize("command", ["export", "capture check", "depth"])
def test_a_link_to_itself_is_no_folder(
    command: str, places: dict[str, str], tmp_path: Path, cli: Cli
) -> None:
    (tmp_path / "loop").symlink_to("loop")
    told = cli.refusal(*words_of(command, places, tmp_path / "loop", tmp_path))
    assert "a link that leads back to itself" in told


@pytest.mark.parametrize("sign", WHOLES)
@pytest.mark.parametrize("command", sorted({*COMMANDS} - {*FILES}))
def test_nothing_is_written_into_another_product(
    command: str, sign: str, places: dict[str, str], tmp_path: Path, cli: Cli
) -> None:
    (tmp_path / "product").mkdir()
    what, says = WHOLES[sign]
    (tmp_path / "product" / sign).write_bytes(says)
    (tmp_path / "link").symlink_to("product")
    told = cli.refusal(*words_of(command, places, tmp_path / "link" / "in" / "out", tmp_path))
    assert f"lies inside the {what}" in told
    assert [path.name for path in (tmp_path / "product").iterdir()] == [sign]


def test_products_are_known_by_their_own_files_and_files_of_others_with_their_names_are_not(
    tmp_path: Path,
) -> None:
    assert list(WHOLES) == [PROFILE_FILE, ABOUT, STUDY_MARKER]
    save_profile(flat_profile(GRID), tmp_path / "profile")
    with pytest.raises(InputError, match="lies inside the profile"):
        require_outside(tmp_path / "profile" / "out")
    for name, text in (("profile.toml", "[tool]\nx = 1\n"), ("dataset.json", '{"kind": "other"}')):
        (tmp_path / name).write_text(text)
        require_outside(tmp_path / "out")


def test_report_of_the_current_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "unit3" / "deep").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "unit3" / "deep")
    for profile, report, found in (
        (".", None, tmp_path / "unit3" / "deep_report"),
        ("..", None, tmp_path / "unit3_report"),
        ("a/b", None, Path("a/b_report")),
        (".", Path("r"), Path("r")),
    ):
        assert report_folder(Path(profile), report) == found
    with pytest.raises(InputError, match="cannot be a profile folder"):
        report_folder(Path("/"), None)


@pytest.mark.parametrize("report", ["profile", "profile/report", "x/../profile"])
def test_a_report_inside_the_profile_is_refused_before_any_work(
    tmp_path: Path, cli: Cli, report: str
) -> None:
    words = [tmp_path / "captures", "--out", tmp_path / "profile", "--report", tmp_path / report]
    assert "would be inside the profile" in cli.refusal("calibrate background", *words)
    assert not (tmp_path / "profile").exists()


READERS = [
    "capture check BAD",
    "capture import BAD OUT",
    "calibrate color BAD --out OUT",
    "calibrate force BAD --out OUT",
    "dataset check BAD",
    "dataset BAD --check-only",
    "dataset export univtac BAD --out OUT",
    "study BAD --out OUT",
    "view BAD --no-browser",
    "profile show BAD",
    "export BAD --to taxim --out OUT",
    "robot show BAD",
    "import-gel BAD",
]
BAD = {"a link to itself": "loop", "below one": "loop/x", "too long": "x" * 300, "NUL": "a\0b"}


@pytest.mark.parametrize("bad", BAD)
@pytest.mark.parametrize("command", READERS)
def test_a_path_that_leads_nowhere_is_refused(
    command: str, bad: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("loop").symlink_to("loop")
    words = [BAD[bad] if word == "BAD" else word.replace("OUT", "out") for word in command.split()]
    assert cli(*words, code=2).err
    assert [path.name for path in tmp_path.iterdir()] == ["loop"]


def test_a_file_that_is_no_text_is_named_once(tmp_path: Path, cli: Cli) -> None:
    assert cli.refusal("study", tmp_path / "\udcff.toml").count("udcff") == 1
