# SPDX-License-Identifier: Apache-2.0
"""A small linter of prose: turns that no engineer says, sentences that are too long.

``python -m tests.support.prose FILE.md ...`` lists what is wrong in pages at hand.
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
import re
import sys
import textwrap
import typing
from collections.abc import Iterator
from pathlib import Path

WORDS = 35
"""Most words of a sentence; code counts as one."""
BANNED = (
    r"\b(?:is|are|be|was|were) told\b",
    r"\bwhat it is\b",
    r"\bso manyth\b",
    r"\bof (?:its|their|one's) own\b",
    r"\b(?:goes|go) with\b",
    r"\bby itself\b",
    r"\bsays nothing but\b",
    r"\b(?:is|are) waited for\b",
    r"\b(?:is|are) refused\b",
    r"\b(?:is|are) asked (?:of|for)\b",
    r"\bhas not (?:are|is)\b",
    r"\bwhat is where\b",
    r"\bwhat comes of\b",
    r"\bfound out by\b",
    r"\bpractice press",
    r"\bskirts?\b",
    r"\bdoor to\b",
    r"\beven tiles, odd scored\b",
)
HISTORY = (
    r"\bcommit `?[0-9a-f]{7}",
    r"\b20\d\d-\d\d-\d\d\b",
    r"\((?:before|formerly)[:,]",
    r"\bas before\b",
)
"""What belongs into the changelog, or beside a measurement."""

_FENCE = re.compile(r"^(\s*)(```|~~~).*?^\1?\2", flags=re.DOTALL | re.MULTILINE)
_GENERATED = re.compile(r"<!--.*?-->", flags=re.DOTALL)
_ITEM = re.compile(r"^\s*(?:[-*+]|\d+\.)\s+|^\w[\w-]*: ")
_END = re.compile(r"(?<=[.!?])[)*\"]*\s+(?=[A-Z`*(\d-])")


def paragraphs(markdown: str) -> Iterator[str]:
    """Paragraphs, list items and cells of tables, without code."""
    text = _GENERATED.sub("", _FENCE.sub("\n", markdown))
    held: list[str] = []
    for line in [*text.splitlines(), ""]:
        is_new = not line.strip() or line.startswith(("#", "|", "    ")) or _ITEM.match(line)
        if is_new and held:
            yield " ".join(held)
            held = []
        if line.lstrip().startswith("|"):
            yield from (cell.strip() for cell in line.strip().strip("|").split("|"))
        elif line.strip() and not line.startswith("#") and (held or not line.startswith("    ")):
            held.append(_ITEM.sub("", line.strip()))


def sentences(paragraph: str) -> list[str]:
    """Sentences of a paragraph, with code as one word and links as their text."""
    plain = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", re.sub(r"``?[^`]*``?", "CODE", paragraph))
    return [sentence for sentence in _END.split(plain) if sentence.strip()]


def faults(markdown: str, *more: str) -> list[str]:
    """What is wrong: a line for each turn of ``BANNED`` or ``more`` and each long sentence."""
    found = []
    for paragraph in paragraphs(markdown):
        for turn in (*BANNED, *more):
            hit = re.search(turn, paragraph, flags=re.IGNORECASE)
            if hit:
                found.append(f"'{hit[0]}' in: {paragraph[:120]}")
        for sentence in sentences(paragraph):
            count = sum(bool(re.search(r"[A-Za-z]", word)) for word in sentence.split())
            if count > WORDS:
                found.append(f"{count} words: {sentence[:160]}")
    return found


def help_of(command: type) -> Iterator[str]:
    """Docstrings that ``--help`` of a command shows: its own, its options' and theirs."""
    for kind in command.__mro__:
        if not dataclasses.is_dataclass(kind):
            continue
        (tree,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
        assert isinstance(tree, ast.ClassDef)
        for node in tree.body:
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
                yield inspect.cleandoc(str(node.value.value))
    hints = typing.get_type_hints(command)
    for field in dataclasses.fields(command):
        for kind in (hints[field.name], *typing.get_args(hints[field.name])):
            if isinstance(kind, type) and dataclasses.is_dataclass(kind):
                yield from help_of(kind)


if __name__ == "__main__":
    for name in sys.argv[1:]:
        for fault in faults(Path(name).read_text(encoding="utf-8")):
            print(f"{name}: {fault}")
