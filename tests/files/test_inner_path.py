# SPDX-License-Identifier: Apache-2.0
"""Whatever a file names lies in its folder, or is refused with a sentence."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.errors import InputError
from taccel_lab.files.inner_path import copy_inner, inner_files, inner_path, real_path
from tests.support.strangers import LURES, REFUSED, SECRET, lure
from tests.test_architecture import SOURCES

PARTS = st.sampled_from(
    ["..", ".", "a", "b c", "", "~", "*", "..a", "a..", "C:", "\\", "é", "\ud800", "\0"]
)


@given(parts=st.lists(PARTS, max_size=6), separator=st.sampled_from(["/", "//", "\\"]))
def test_no_name_leads_out(parts: list[str], separator: str) -> None:
    folder = Path("/some/folder")
    try:
        path = inner_path(folder, separator.join(parts))
    except InputError as error:
        assert str(error).startswith("/some/folder: ")
    else:
        assert path.resolve().is_relative_to(folder.resolve())


def test_names_that_no_file_can_have(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot be followed: .*too long"):
        inner_path(tmp_path, "x" * 5000)
    with pytest.raises(InputError, match=r"file names cannot have '\\ud800'"):
        inner_path(tmp_path, "a\ud800b.png")


@pytest.mark.parametrize("name", ["a.png", "a/b.png", "..a", "a..b/c", "./a", "~", "a b"])
def test_ordinary_names_are_fine(tmp_path: Path, name: str) -> None:
    assert inner_path(tmp_path, name) == tmp_path / name


def test_links(tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    (tmp_path / "secret").write_text("not yours")
    (folder / "out").symlink_to(tmp_path / "secret")
    (folder / "up").symlink_to(tmp_path)
    (folder / "round").symlink_to(folder / "round")
    (folder / "within").symlink_to(folder / "file")
    for name in ("out", "up/secret", "up"):
        with pytest.raises(InputError, match="is a link out of"):
            inner_path(folder, name)
    with pytest.raises(InputError, match="cannot be followed"):
        inner_path(folder, "round")
    assert inner_path(folder, "within") == folder / "within"
    # The folder itself may be reached by a link.
    (tmp_path / "shortcut").symlink_to(folder)
    assert inner_path(tmp_path / "shortcut", "within").name == "within"


@pytest.mark.parametrize("kind", LURES)
@pytest.mark.parametrize("place", ["x", "sub/x", "sub/below/x"])
def test_nothing_that_leads_elsewhere_is_among_a_folders_files(
    tmp_path: Path, kind: str, place: str
) -> None:
    folder = tmp_path / "folder"
    (folder / "sub" / "below").mkdir(parents=True)
    (folder / "sub" / "file").write_text("own")
    assert list(inner_files(folder)) == list(inner_files(folder, "sub")) == [folder / "sub/file"]
    secret = lure(folder / place, kind, tmp_path / "outside")
    with pytest.raises(InputError, match=REFUSED):
        list(inner_files(folder))
    with pytest.raises(InputError, match=REFUSED):
        copy_inner(folder, "sub" if "/" in place else place, tmp_path / "copy")
    assert not (tmp_path / "copy" / place).exists() and secret.read_text() == SECRET
    # Places that are not looked at are not judged.
    shallow = list(inner_files(folder, levels=1)) if "/" in place else []
    assert shallow == []


def test_a_folder_is_copied_with_what_its_own_links_name(tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    (folder / "sub").mkdir(parents=True)
    (folder / "file").write_text("own")
    (folder / "sub" / "link").symlink_to("../file")
    copy_inner(folder, "sub", tmp_path / "copy")
    assert not (tmp_path / "copy/sub/link").is_symlink()
    assert (tmp_path / "copy/sub/link").read_text() == "own"
    with pytest.raises(InputError, match="does not exist"):
        copy_inner(folder, "absent", tmp_path / "copy")


def test_where_a_path_leads(tmp_path: Path) -> None:
    (tmp_path / "one").symlink_to(tmp_path / "other")
    assert real_path(tmp_path / "one" / "x") == tmp_path / "other" / "x"
    (tmp_path / "other").symlink_to(tmp_path / "one")
    assert not real_path(tmp_path / "one").exists()
    for name in ("a\0b", "a\ud800b"):
        with pytest.raises(InputError, match="file name"):
            real_path(tmp_path / name)


def test_links_are_followed_by_real_path_alone() -> None:
    """``Path.resolve`` raises for a circle of links, which a user's folder may hold."""
    own = ("Path(__file__).resolve()", "link.resolve()", "place.resolve()")  # Of ours, of Linux's.
    for source in SOURCES:
        lines = source.read_text(encoding="utf-8").splitlines()
        calls = [line for line in lines if ".resolve(" in line and "``" not in line]
        left = [line for line in calls if not any(call in line for call in own)]
        assert not left, f"{source}: {left}"
