# SPDX-License-Identifier: Apache-2.0
"""Words that mean the same for all commands: which one, --version, --quiet, --device auto."""

from __future__ import annotations

import difflib
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass

from taccel_lab.errors import InputError


def common_words(words: Sequence[str]) -> tuple[list[str], bool]:
    """The words without --quiet, and whether it was there; the device that ``auto`` stands for put
    in its place: the first GPU, or the CPU where there is none."""
    left = [word for word in words if word != "--quiet"]
    for i, word in enumerate(left):
        if word == "auto" and i > 0 and left[i - 1] == "--device":
            left[i] = _best_device()
        elif word == "--device=auto":
            left[i] = f"--device={_best_device()}"
    return left, len(left) < len(words)


def _best_device() -> str:
    import warp as wp

    from taccel_lab.processes.start_warp import start_warp

    start_warp()
    return "cuda:0" if wp.is_cuda_available() else "cpu"


def checked_words(words: Sequence[str], names: Mapping[str, Sequence[str]]) -> list[str]:
    """The words, --help added where a command is still to be chosen.

    ``names``: the commands, and those of each group (none for a plain command). Raises InputError
    for a command that is not there, with or without --help behind it, and says which may be meant;
    --version leaves through SystemExit.
    """
    if not words:
        return ["--help"]
    if words[0] == "--version":
        from taccel_lab.version import __version__

        sys.stdout.write(f"taccel-lab {__version__}\n")
        raise SystemExit(0)
    _require(words[0], tuple(names), "taccel-lab")
    group = names.get(words[0], ())
    if group:
        if len(words) == 1:
            return [*words, "--help"]
        _require(words[1], group, f"taccel-lab {words[0]}")
    return list(words)


def require_options(words: Sequence[str], command: type, prefix: str) -> None:
    """Raise InputError for options that ``command``, a dataclass, does not have, and say which may
    be meant. ``words``: those behind the command's name, ``prefix``.

    Said before the words are parsed, which would name only what is then missing.
    """
    left = list(words[: words.index("--")] if "--" in words else words)
    if {"-h", "--help"} & set(left):
        return
    known = tuple(_options(command))
    # An option or a name, not a negative number; what follows = is a value, whatever it is.
    found = [word.partition("=")[0] for word in left if re.match("-+[^\\W\\d]", word)]
    found = [word for word in found if not re.fullmatch("-(inf|infinity|nan)", word, re.IGNORECASE)]
    lines = []
    for word in dict.fromkeys(found):
        if word.startswith("--") and word.replace("_", "-") in known:
            continue
        close = difflib.get_close_matches("--" + word.lstrip("-"), (*known, *_COMMON), 1)
        if close:
            meant = f"; did you mean {close[0]}?"
        elif not word.startswith("--"):
            meant = f"; write a file or folder of that name as ./{word}"
        else:
            meant = ""
        lines.append(f"{prefix} has no option {word}{meant}")
    if lines:
        raise InputError("\n".join([*lines, f"{prefix} --help lists the options"]))


_COMMON = ("--help", "--quiet")


def _options(command: type) -> Iterator[str]:
    for field in fields(command):
        if isinstance(field.default_factory, type) and is_dataclass(field.default_factory):
            yield from _options(field.default_factory)
            continue
        name = field.name.replace("_", "-").strip("-")
        yield f"--{name}"
        if field.type in ("bool", bool):
            yield f"--no-{name}"


def _require(word: str, known: Sequence[str], prefix: str) -> None:
    if word.startswith("-") or word in known:
        return
    close = difflib.get_close_matches(word, known, 1)
    meant = f"; did you mean {prefix} {close[0]}?" if close else ""
    raise InputError(f"there is no command {word!r}{meant}\n{prefix} has: {', '.join(known)}")
