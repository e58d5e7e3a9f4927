# SPDX-License-Identifier: Apache-2.0
"""Commands that read many images: one that is rejected stops no other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any, TypeVar

from taccel_lab.errors import InputError

Found = TypeVar("Found")
"""What a command reads from one image."""


def require_images(paths: Sequence[Path]) -> None:
    """Refuse images that are not there, and such that would overwrite each other's files."""
    if not paths:
        raise InputError("no image was given; name at least one PNG or JPEG")
    for path in paths:
        if not path.is_file():
            raise InputError(f"{path} does not exist or is no file; an image is needed")
    stems = [path.stem for path in paths]
    twice = sorted({stem for stem in stems if stems.count(stem) > 1})
    if twice:
        raise InputError(
            f"images named alike would overwrite each other's files: {', '.join(twice)}"
        )


def each_image(
    paths: Sequence[Path],
    out: Path | None,
    read: Callable[[Path], Found],
    keep: Callable[[Found, Path, Path | None], dict[str, Any]],
    *,
    as_json: bool,
    lines: Callable[[Path, dict[str, Any]], Sequence[str]],
) -> dict[str, dict[str, Any]]:
    """Read images, write what they show and tell it; returns figures by name of the image.

    Args:
        paths: The images.
        out: Folder to write, or None.
        read: Gives what an image shows; an InputError refuses that image alone.
        keep: Writes it into the folder that is given, where there is one; returns its figures.
        as_json: Print all figures and refusals as JSON at the end, not lines as they come.
        lines: What to print of an image.

    Raises:
        InputError: With the reasons, when images were rejected; after the others' files are written
            and told. Where none could be read, nothing is written.
    """
    from taccel_lab.cli.console import print_json, results
    from taccel_lab.files.output_folder import atomic_directory

    console, figures = results(), {}
    refused: dict[str, str] = {}
    with nullcontext() if out is None else atomic_directory(out) as folder:
        for path in paths:
            try:
                found = read(path)
            except InputError as error:
                refused[path.stem] = str(error)
                continue
            figures[path.stem] = about = keep(found, path, folder)
            for line in () if as_json else lines(path, about):
                console.print(line, soft_wrap=True)
        if not figures:
            # Leaving with an error keeps what an earlier run wrote there.
            if as_json:
                print_json({"out": None, "images": {}, "refused": refused})
            raise InputError("\n".join(refused.values()))
    if as_json:
        folder = None if out is None else str(out)
        print_json({"out": folder, "images": figures, "refused": refused})
    elif out is not None:
        console.print(f"wrote {out}", soft_wrap=True)
    if refused:
        raise InputError("\n".join(refused.values()))
    return figures
