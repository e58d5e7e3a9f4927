# SPDX-License-Identifier: Apache-2.0
"""Every file of a source is imported, read, or told with the reason why it is not."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from taccel_lab.calibration.capture.schema import MANIFEST_NAME

MAX_SHOWN = 8
"""Names, or patterns of names, that a sentence lists."""
MAX_REASONS = 20


def capture_folders(folder: Path) -> frozenset[Path]:
    """Folders below this one that are capture folders already: what an import has written."""
    return frozenset(path.parent for path in folder.rglob(MANIFEST_NAME)) - {folder}


def files_of(source: Path) -> Iterator[Path]:
    """Files of a folder and of those below it, without hidden ones; none of a single file."""
    if not source.is_dir():
        return
    for path in sorted(source.rglob("*")):
        hidden = any(part[0] == "." for part in path.relative_to(source).parts)
        if path.is_file() and not hidden:
            yield path


def left_out_sentences(left_out: Mapping[Path, str], root: Path) -> list[str]:
    """One sentence a reason: how many files, their names, and why; most files first."""
    by_reason: dict[str, list[Path]] = {}
    for path, why in left_out.items():
        by_reason.setdefault(why, []).append(path)
    ordered = sorted(by_reason.items(), key=lambda item: -len(item[1]))
    sentences = [
        f"left out, {len(paths)} file{'s' if paths[1:] else ''} ({_named(paths, root)}): {why}"
        for why, paths in ordered[:MAX_REASONS]
    ]
    if rest := ordered[MAX_REASONS:]:
        count = sum(len(paths) for _, paths in rest)
        sentences.append(f"left out, {count} more files for {len(rest)} more reasons")
    return sentences


def _named(paths: Iterable[Path], root: Path) -> str:
    """Their paths below ``root``, those that differ in numbers alone as ``frame_<n>.png, 12 x``."""
    names = [path.relative_to(root).as_posix() if root in path.parents else str(path)
             for path in paths]  # fmt: skip
    patterns = Counter(re.sub(r"[0-9]+", "<n>", name) for name in names)
    shown = [
        f"{pattern}, {count} x"
        if count > 1
        else next(name for name in names if re.sub(r"[0-9]+", "<n>", name) == pattern)
        for pattern, count in patterns.most_common(MAX_SHOWN)
    ]
    more = sum(count for _, count in patterns.most_common()[MAX_SHOWN:])
    return "; ".join(shown) + (f"; and {more} more" if more else "")
