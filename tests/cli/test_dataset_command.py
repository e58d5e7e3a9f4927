# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab dataset``: usage, refusals and what it says when it is done."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from taccel_lab.cli.dataset import with_make
from tests.cli.conftest import Cli

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


def test_made_checked_shown_and_gone_on_with(spec: Path, tmp_path: Path, cli: Cli) -> None:
    out = tmp_path / "out"
    cli("dataset", spec, "--out", out, "--check-only")
    command = ["dataset", spec, "--out", out, "--processes", "0"]
    cli(*command, "--no-write")
    assert not out.exists()
    said = cli(*command, "--json")
    assert "2 images of 1 touches" in said.err
    assert json.loads(said.out)["images_per_s"] > 0
    assert "0 images of 0 touches" in cli(*command).err
    assert "0 errors" in cli("dataset check", out).err
    cli("dataset page", out, "--out", tmp_path / "page.html")
    assert "has no rgb" in cli.refusal("dataset export", "univtac", out, "--out", tmp_path / "u")
    next((out / "parts").rglob("steps.parquet")).write_bytes(b"half")
    assert "is not what was written" in cli("dataset check", out, code=1).err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--shard", "3/2"], "shard '3/2' is not understood"),
        (["--shard", "0/2"], "shard '0/2' is not understood"),
        (["--limit", "0"], "limit must be at least 1"),
        (["--device", "cuda:99"], "cuda:99"),
        (["--check-only"], "output.sizes_px: unknown key; allowed: channels, size_px"),
    ],
)
def test_bad_words(spec: Path, tmp_path: Path, words: list[str], message: str, cli: Cli) -> None:
    if "unknown key" in message:
        spec.write_text(SPEC + "sizes_px = [3, 4]\n")
    assert message in cli.refusal("dataset", spec, "--out", tmp_path / "out", *words)
    assert not (tmp_path / "out").exists()
