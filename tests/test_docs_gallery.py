# SPDX-License-Identifier: Apache-2.0
"""The gallery's pictures are those that its commands write; that these parse, test_docs holds."""

from __future__ import annotations

import importlib.util
import shlex
import sys
from pathlib import Path
from types import ModuleType

import pytest
from PIL import Image

ROOT = Path(__file__).parents[1]
MOST_BYTES = 200_000


def gallery() -> ModuleType:
    """docs/gallery_pictures.py."""
    spec = importlib.util.spec_from_file_location("gallery", ROOT / "docs" / "gallery_pictures.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # Where dataclasses look for their module.
    spec.loader.exec_module(module)
    return module


GALLERY = gallery()
ENTRIES = GALLERY.entries()


def test_every_picture_of_the_page_has_its_command() -> None:
    page = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    assert len(ENTRIES) == page.count("![") == page.count("\n## ") == 10
    kept = {path.name for path in (ROOT / "docs" / "images" / "gallery").iterdir()}
    assert {entry.picture.name for entry in ENTRIES} == kept


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry.picture.stem)
def test_a_picture_is_made_by_the_command_below_it(entry: object) -> None:
    assert isinstance(entry, GALLERY.Entry)
    with Image.open(entry.picture) as picture:
        assert picture.info[GALLERY.COMMAND] == entry.command
        assert picture.width <= GALLERY.WIDTH_PX
    assert entry.picture.stat().st_size <= MOST_BYTES
    # It lies where the command writes.
    words = shlex.split(entry.command)
    assert Path(words[-1]) in (entry.made, *entry.made.parents)


def test_a_kept_picture_is_small_and_holds_its_command(tmp_path: Path) -> None:
    Image.new("RGB", (900, 300)).save(tmp_path / "made.png")
    made = GALLERY.Entry(tmp_path / "kept.png", "taccel-lab press", Path("made.png"))
    GALLERY.keep(made, tmp_path)
    with Image.open(made.picture) as kept:
        assert kept.size == (720, 240) and kept.info[GALLERY.COMMAND] == "taccel-lab press"
