# SPDX-License-Identifier: Apache-2.0
"""Makes docs/images/gallery: runs the commands of docs/gallery.md and keeps what they draw.

python docs/gallery_pictures.py out/gallery            # all; ten minutes of two cores
python docs/gallery_pictures.py out/gallery press      # those whose picture has this name

Each picture holds the command that made it, which a test compares with the page.
"""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from PIL import Image
from PIL.PngImagePlugin import PngInfo

DOCS = Path(__file__).parent
WIDTH_PX = 720
COMMAND = "Command"
_ENTRY = re.compile(
    r"!\[[^\]]+\]\((?P<picture>images/gallery/[\w-]+\.png)\)\n\n"
    r"```sh\n(?P<command>taccel-lab [^#\n]+?) +# (?P<made>out/\S+)\n```"
)


@dataclass(frozen=True)
class Entry:
    """A picture of the gallery."""

    picture: Path
    """In docs/."""
    command: str
    made: Path
    """What the command writes, in the folder where it runs."""


def entries() -> list[Entry]:
    """The pictures of the page, in its order."""
    text = (DOCS / "gallery.md").read_text(encoding="utf-8")
    return [
        Entry(DOCS / found["picture"], found["command"], Path(found["made"]))
        for found in _ENTRY.finditer(text)
    ]


def keep(entry: Entry, folder: Path) -> None:
    """Write the gallery's picture from what the command has written."""
    picture = Image.open(folder / entry.made).convert("RGB")
    if picture.width > WIDTH_PX:
        height = round(picture.height * WIDTH_PX / picture.width)
        picture = picture.resize((WIDTH_PX, height), Image.Resampling.LANCZOS)
    about = PngInfo()
    about.add_text(COMMAND, entry.command)
    entry.picture.parent.mkdir(parents=True, exist_ok=True)
    picture.save(entry.picture, pnginfo=about, optimize=True)


def main(folder: Path, *names: str) -> None:
    """Run the commands in a folder and keep their pictures."""
    folder.mkdir(parents=True, exist_ok=True)
    for entry in entries():
        if names and entry.picture.stem not in names:
            continue
        words = [sys.executable, "-m", "taccel_lab.cli.app", *shlex.split(entry.command)[1:]]
        subprocess.run([*words, "--quiet"], cwd=folder, check=True)
        keep(entry, folder)


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
