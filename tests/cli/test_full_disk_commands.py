# SPDX-License-Identifier: Apache-2.0
"""Commands that find no room: exit code 2, one sentence with the name that was given, and nothing
left but what the same command goes on with."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from taccel_lab.exporters import gs_sdk
from taccel_lab.exporters.export import EXPORTERS, export_profile
from taccel_lab.files.atomic_file import write_bytes
from taccel_lab.profile import save_profile
from tests.cli.conftest import Cli
from tests.exporters.profiles import mini_profile
from tests.support.fake_kit import METRICS, PRESSES, evaluate
from tests.support.short_files import files_at_most
from tests.support.small_captures import everything_below

PROBE_BYTES = 4096
"""What a command writes before any work; a smaller limit refuses it there."""


@pytest.fixture(scope="module")
def mini(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("mini") / "profile"
    save_profile(mini_profile(), folder)
    return folder


@pytest.fixture(autouse=True)
def quick_training(monkeypatch: pytest.MonkeyPatch) -> None:
    write = partial(gs_sdk.export_gs_sdk, steps=2, samples=200)
    monkeypatch.setitem(EXPORTERS, "gs-sdk", replace(EXPORTERS["gs-sdk"], write=write))


def largest(folder: Path) -> int:
    return max(path.stat().st_size for path in folder.rglob("*") if path.is_file())


@pytest.mark.thorough(cases=("gs-sdk", "isaac-lab", "onnx", "safetensors", "taccel", "taxim"))
@pytest.mark.parametrize("to", EXPORTERS)
def test_an_export_is_whole_or_not_at_all(to: str, mini: Path, tmp_path: Path, cli: Cli) -> None:
    if to == "onnx":
        pytest.importorskip("onnx")
    out = tmp_path / "out"
    cli("export", mini, "--to", to, "--out", out)
    before = everything_below(tmp_path)
    for size in {PROBE_BYTES // 2, max(largest(out) // 2, PROBE_BYTES), largest(out) - 1}:
        if size >= largest(out):
            continue
        with files_at_most(size):
            said = cli("export", mini, "--to", to, "--out", out, code=2).err
        assert said.splitlines()[-1] in (
            f"error: {out}: File too large",
            f"error: {out} cannot be written: File too large",
        )
        assert "Traceback" not in said and "ERR|" not in said
        assert everything_below(tmp_path) == before


@pytest.mark.parametrize("to", ["taccel", "urdf", "safetensors"])
def test_a_full_drive_takes_no_part_of_an_export(to: str, mini: Path, small_drive: Path) -> None:
    write_bytes(small_drive / "mine.txt", b"mine")
    with pytest.raises(OSError) as told:
        export_profile(mini_profile(), to, small_drive / "out")
    assert (told.value.errno, told.value.filename) == (errno.ENOSPC, str(small_drive / "out"))
    assert everything_below(small_drive) == {"mine.txt": b"mine"}


@pytest.mark.thorough
def test_a_block_stands_with_its_report_or_not_at_all(
    here: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ("calibrate background", "captures", "--out")
    cli(*words, "whole")
    # A second one may have the same text: files are compared by their times, too.
    before = everything_below(here), (here / "whole").stat().st_ino
    for out in ("new", "whole"):
        with monkeypatch.context() as patch:
            full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            patch.setattr("taccel_lab.report.page.page_html", raised(full))
            said = cli(*words, out, code=2).err
        assert f"error: {out}_report: No space left on device\n" in said
        assert (everything_below(here), (here / "whole").stat().st_ino) == before


@pytest.fixture
def study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A study whose presses are fakes; the second design can be spoilt."""
    from taccel_lab.studies.spec.study import Kit

    monkeypatch.setattr("taccel_lab.api.study.default_kit", lambda: Kit(PRESSES, METRICS, evaluate))
    monkeypatch.setattr("taccel_lab.studies.evaluate.runner.default_processes", lambda device: 0)
    path = tmp_path / "two.toml"
    path.write_text(
        '[study]\nname = "Two"\nsensor = "gelsight"\nmetrics = ["stiffness"]\n'
        '[parameters.thickness_mm]\nvalues = [4.0, 5.0]\n[sweep]\nkind = "grid"\n'
        "[output]\nmeshes = true\npictures = false\n"
    )
    monkeypatch.chdir(tmp_path)
    return path


@pytest.mark.thorough
def test_no_design_of_a_study_is_to_blame_for_a_full_disk(
    study: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A design whose files found no room is made again; it was kept without them."""
    with files_at_most(20_000):
        said = cli("study", study, "--out", "out", code=2).err.splitlines()[-1]
    assert (
        said.startswith("error: ") and ".vtu: File too large; what is finished stays in out" in said
    )
    assert said.endswith("go on with: taccel-lab study " + f"{study} --out out")
    assert not list((study.parent / "out").rglob(".*.vtu"))
    cli("study", study, "--out", "out")
    rows = [json.loads(path.read_text()) for path in study.parent.glob("out/designs/*/result.json")]
    assert len(rows) == 2
    assert all((study.parent / "out" / row["files"]["mesh"]).is_file() for row in rows)


def raised(error: BaseException) -> Callable[..., None]:
    def write(*_: object, **__: object) -> None:
        raise error

    return write


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("error", "code", "begins"),
    [
        (OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)), 2, "error: {}: No space left on device"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)
def test_rows_that_were_read_stay_and_it_is_said(
    error: BaseException,
    code: int,
    begins: str,
    places: dict[str, str],
    tmp_path: Path,
    cli: Cli,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    out, kept = tmp_path / "out", tmp_path / ".out.readings.jsonl"
    words = ("read", "gelsight_mini", photos(tmp_path), "--out", out)
    with monkeypatch.context() as patch:
        patch.setattr("taccel_lab.calibration.live.recorded.save_figure", raised(error))
        said = cli(*words, code=code).err.splitlines()[-1]
    stays = f"rows of 2 of 2 frames stay in {kept}, and the same command goes on with them"
    assert said == f"{begins.format(out)}; {stays}"
    assert kept.is_file() and not out.exists()
    cli(*words)
    assert out.is_dir() and not kept.exists()


def test_where_no_row_was_read_nothing_is_left(
    tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ("read", "gelsight_mini", photos(tmp_path), "--out", tmp_path / "new" / "out")
    before = everything_below(tmp_path)
    row = raised(KeyboardInterrupt())
    monkeypatch.setattr("taccel_lab.calibration.live.recorded._row", row)
    said = cli(*words, code=130).err.splitlines()[-1]
    assert said == "interrupted; no partial output is left"
    assert everything_below(tmp_path) == before


def photos(folder: Path) -> Path:
    from tests.support.real_data import real_data

    source = real_data("gsmini_gs_sdk/examples/data")
    target = folder / "photos"
    target.mkdir(exist_ok=True)
    for name in ("background.png", "bead.png"):
        (target / name).write_bytes((source / name).read_bytes())
    return target
