# SPDX-License-Identifier: Apache-2.0
"""Commands that end early or find no room: a sentence with the name that was given, and nothing
left but what the same command goes on with."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from taccel_lab.exporters import gs_sdk
from taccel_lab.exporters.export import EXPORTERS
from taccel_lab.profile import save_profile
from tests.cli.conftest import Cli
from tests.exporters.profiles import mini_profile
from tests.support.real_data import real_data
from tests.support.short_files import files_at_most
from tests.support.small_captures import everything_below

PROBE_BYTES = 4096
"""What a command writes before any work; a smaller limit refuses it there."""


@pytest.fixture(scope="module")
def mini(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("mini") / "profile"
    save_profile(mini_profile(), folder)
    return folder


@pytest.mark.thorough(cases=("gs-sdk", "isaac-lab", "onnx", "safetensors", "taccel", "taxim"))
@pytest.mark.parametrize("to", EXPORTERS)
def test_an_export_is_whole_or_not_at_all(
    to: str, mini: Path, tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    if to == "onnx":
        pytest.importorskip("onnx")
    quick = partial(gs_sdk.export_gs_sdk, steps=2, samples=200)
    monkeypatch.setitem(EXPORTERS, "gs-sdk", replace(EXPORTERS["gs-sdk"], write=quick))
    out = tmp_path / "out"
    cli("export", mini, "--to", to, "--out", out)
    before = everything_below(tmp_path)
    largest = max(path.stat().st_size for path in out.rglob("*") if path.is_file())
    for size in {PROBE_BYTES // 2, max(largest // 2, PROBE_BYTES), largest - 1}:
        if size >= largest:
            continue
        with files_at_most(size):
            said = cli("export", mini, "--to", to, "--out", out, code=2).err
        assert said.splitlines()[-1] in (
            f"error: {out}: File too large",
            f"error: {out} cannot be written: File too large",
        )
        assert "Traceback" not in said and "ERR|" not in said
        assert everything_below(tmp_path) == before


def raised(error: BaseException) -> Callable[..., None]:
    def write(*_: object, **__: object) -> None:
        raise error

    return write


NO_ROOM = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


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
            patch.setattr("taccel_lab.report.page.page_html", raised(NO_ROOM))
            said = cli(*words, out, code=2).err
        assert f"error: {out}_report: No space left on device\n" in said
        assert (everything_below(here), (here / "whole").stat().st_ino) == before


@pytest.fixture
def read(tmp_path: Path) -> tuple[object, ...]:
    """Words that read two frames of a stranger's sensor into ``new/out``."""
    source, target = real_data("gsmini_gs_sdk/examples/data"), tmp_path / "photos"
    target.mkdir()
    for name in ("background.png", "bead.png"):
        shutil.copy(source / name, target)
    return "read", "gelsight_mini", target, "--out", tmp_path / "new" / "out"


@pytest.mark.thorough
def test_rows_that_were_read_stay_and_it_is_said(
    read: tuple[str, ...], tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, kept = tmp_path / "new" / "out", tmp_path / "new" / ".out.readings.jsonl"
    with monkeypatch.context() as patch:
        patch.setattr("taccel_lab.calibration.live.recorded.save_figure", raised(NO_ROOM))
        said = cli(*read, code=2).err.splitlines()[-1]
    stays = f"rows of 2 of 2 frames stay in {kept}, and the same command goes on with them"
    assert said == f"error: {out}: No space left on device; {stays}"
    assert kept.is_file() and not out.exists()
    cli(*read)
    assert out.is_dir() and not kept.exists()


def test_where_no_row_was_read_nothing_is_left(
    read: tuple[str, ...], tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = everything_below(tmp_path)
    row = raised(KeyboardInterrupt())
    monkeypatch.setattr("taccel_lab.calibration.live.recorded._row", row)
    said = cli(*read, code=130).err.splitlines()[-1]
    assert said == "interrupted; no partial output is left"
    assert everything_below(tmp_path) == before
