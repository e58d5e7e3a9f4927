# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab dataset``: usage, refusals and what it says when it is done."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from taccel_lab.cli.app import main
from taccel_lab.cli.dataset import with_make

SPEC = """
[dataset]
name = "one"
episodes = 1
view = 0.2
accuracy = "fast"
[[sensors]]
profile = "flat_pad"
[[objects]]
tool = "sphere:2"
[[motions]]
kind = "press"
depth_mm = [0.1, 0.1]
[output]
channels = ["depth_mm", "patch_forces_n"]
size_px = [32, 24]
"""


@pytest.fixture
def spec(tmp_path: Path) -> Path:
    path = tmp_path / "one.toml"
    path.write_text(SPEC)
    return path


def test_make_may_be_left_out() -> None:
    assert with_make(["dataset", "a.toml", "--out", "b"])[:3] == ["dataset", "make", "a.toml"]
    for words in (["dataset", "check", "b"], ["dataset", "--help"], ["dataset"], ["study", "a"]):
        assert with_make(words) == words


def test_made_checked_shown_and_gone_on_with(
    spec: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    command = ["dataset", str(spec), "--out", str(out), "--processes", "0"]
    assert main([*command, "--json"]) == 0
    said = capsys.readouterr()
    assert "2 images of 1 touches" in said.err
    assert json.loads(said.out)["images_per_s"] > 0
    assert main(command) == 0
    assert "0 images of 0 touches" in capsys.readouterr().err
    assert main(["dataset", "check", str(out)]) == 0
    assert "0 errors" in capsys.readouterr().err
    assert main(["dataset", "page", str(out), "--out", str(tmp_path / "page.html")]) == 0
    assert main(["dataset", "export", "univtac", str(out), "--out", str(tmp_path / "u")]) == 2
    assert "has no rgb" in capsys.readouterr().err
    next((out / "parts").rglob("steps.parquet")).write_bytes(b"half")
    with pytest.raises(SystemExit) as ended:
        main(["dataset", "check", str(out)])
    assert ended.value.code == 1
    assert "is not what was written" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--shard", "3/2"], "shard '3/2' is not understood"),
        (["--shard", "0/2"], "shard '0/2' is not understood"),
        (["--limit", "0"], "limit must be at least 1"),
        (["--device", "cuda:99"], "cuda:99"),
    ],
)
def test_bad_words(
    spec: Path, tmp_path: Path, words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["dataset", str(spec), "--out", str(tmp_path / "out"), *words]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_unknown_keys_are_named(
    spec: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    spec.write_text(SPEC + "sizes_px = [3, 4]\n")
    assert main(["dataset", str(spec), "--out", str(tmp_path / "out")]) == 2
    assert "output.sizes_px: unknown key; allowed: channels, size_px" in capsys.readouterr().err


def test_check_only_and_no_write_leave_nothing(spec: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert main(["dataset", str(spec), "--out", str(out), "--check-only"]) == 0
    assert main(["dataset", str(spec), "--out", str(out), "--no-write", "--processes", "0"]) == 0
    assert not out.exists()
