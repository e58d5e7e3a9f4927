# SPDX-License-Identifier: Apache-2.0
"""What happens to a file as a whole: gone, a link, a folder, a pipe, enormous, or not alone."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from tests.fuzz.mutations.draw import Draw, Surroundings

ENORMOUS = 5 << 28
_NAMES = (
    b"\xff\xfe.png", b"a\nb.png", b"-rf.csv", b"[red]x[bold].png", b"z" * 250 + b".csv", b".png",
    b"\xf0\x9f\x98\x80.png", b" .png", b"a\x1b[2J.csv", b"mask.png", b"bg.png",
    b"shape_config.yaml", b"..png", b"CON.csv", b"labels.csv", b"0x10.png", b"\xd9\xa3.png",
    b"\xc2\xb2.png", b"a;b.toml",
    b"x.avi", b"metadata.json", b"catalog.csv", b"contacts.toml", b"captures.toml", b"x.yaml",
)  # fmt: skip


def missing(path: Path, draw: Draw, around: Surroundings) -> None:
    """Not there."""
    path.unlink()


def a_folder(path: Path, draw: Draw, around: Surroundings) -> None:
    """A folder of the same name."""
    path.unlink()
    path.mkdir()


def link_out(path: Path, draw: Draw, around: Surroundings) -> None:
    """A link to a file elsewhere."""
    path.unlink()
    path.symlink_to(draw.pick((around.outside, Path("/dev/null"), around.outside.parent)))


def broken_link(path: Path, draw: Draw, around: Surroundings) -> None:
    """A link to nothing, to itself, or to what is no file name at all."""
    path.unlink()
    path.symlink_to(draw.pick(("nowhere", path.name, "n" * 300, ".")))


def pipe(path: Path, draw: Draw, around: Surroundings) -> None:
    """A named pipe that nobody writes to."""
    path.unlink()
    os.mkfifo(path)


def enormous(path: Path, draw: Draw, around: Surroundings) -> None:
    """More than an example may take into memory, all zero."""
    os.truncate(path, ENORMOUS)


def one_more(path: Path, draw: Draw, around: Surroundings) -> None:
    """The file once more under an odd name; nothing where that is its own."""
    name = draw.pick(_NAMES)
    if name != os.fsencode(path.name):
        shutil.copyfile(path, os.path.join(os.fsencode(path.parent), name))


def renamed(path: Path, draw: Draw, around: Surroundings) -> None:
    """Under another name, in capitals or an odd one."""
    new = draw.pick((os.fsencode(path.name.upper()), *_NAMES))
    os.replace(os.fsencode(path), os.path.join(os.fsencode(path.parent), new))


def other_suffix(path: Path, draw: Draw, around: Surroundings) -> None:
    """What one kind of file holds under the name of another."""
    suffixes = (".png", ".csv", ".npz", ".toml", ".avi", ".json", ".txt", ".jpg", ".yaml", ".mp4")
    data = path.read_bytes()
    path.with_suffix(draw.pick(suffixes)).write_bytes(data)


def deeper(path: Path, draw: Draw, around: Surroundings) -> None:
    """A folder below with the file in it, or with a link back to the top."""
    below = path.parent / draw.pick(("sub", "0", "labels", "gelsight", ".hidden"))
    if below.is_file():  # Chunks of arrays are called like this.
        return
    if not below.exists():
        below.mkdir()
    if draw.chance(0.5):
        place = below / f"again{path.suffix}"
        if not place.exists():
            shutil.copyfile(path, place)
    elif not (below / "round").is_symlink():
        (below / "round").symlink_to("..")


MUTATORS = (
    missing, missing, a_folder, link_out, broken_link, pipe, enormous, one_more, one_more, renamed,
    other_suffix, deeper,
)  # fmt: skip
