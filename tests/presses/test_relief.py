# SPDX-License-Identifier: Apache-2.0
"""Relief that is finer than the gel's elements is said before anything is solved."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import pyvista

from taccel_lab.errors import InputError
from taccel_lab.presses import parse_indenter
from taccel_lab.presses.run import PressRun
from taccel_lab.scene import TriangleMesh
from tests.support.commands import done


def said(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, out: Path, *words: object
) -> str:
    """Notes of the command on a relief before it solves."""

    def unsolved(run: PressRun, *_: object) -> None:
        raise InputError("as far as this test goes")

    monkeypatch.setattr(PressRun, "run", unsolved)
    given = ("--depth-mm", 0.2, "--out", out / "out", *words)
    found = done(capsys, "press", "flat_pad", *given)
    assert found.code == 2 and "as far as this test goes" in found.err
    text = " ".join((found.out + found.err).split())
    return text if "finer than the gel's elements" in text else ""


def saved(path: Path, tool: str) -> str:
    """A tool as a user's file in mm."""
    shape = parse_indenter(tool).shape
    assert isinstance(shape, TriangleMesh)
    pyvista.PolyData.from_regular_faces(1e3 * shape.vertices_m, shape.faces).save(path)
    return f"mesh:{path}"


@pytest.mark.parametrize(
    ("tool", "width"),
    [("cylinder:2", ""), ("box:4x3", ""), ("grating:2x4x6", "about 1.2 mm"), ("grating:8x3x6", "")],
)
def test_meshes_with_fine_ridges_are_named(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    tool: str,
    width: str,
) -> None:
    words = ("--indenter", saved(tmp_path / "tool.stl", tool))
    text = said(capsys, monkeypatch, tmp_path, *words)
    assert bool(text) == bool(width) and width in text


@pytest.mark.parametrize(("stripes", "named"), [(16, True), (2, False)])
def test_textures_with_fine_stripes_are_named(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    stripes: int,
    named: bool,
) -> None:
    """Of 16 mm: stripes of half a millimetre, and of four."""
    row = np.repeat(np.arange(2 * stripes) % 2, 128 // (2 * stripes)).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "map.png"), 255 * np.tile(row, (128, 1)))
    texture = ("--texture", tmp_path / "map.png", "--texture-mm", 0.02, 16)
    words = (*texture, "--indenter", "sphere:4")
    text = said(capsys, monkeypatch, tmp_path, *words)
    assert bool(text) == named
    assert not named or "the texture's relief is about 0.5 mm wide" in text
