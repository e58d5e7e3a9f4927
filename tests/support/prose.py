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
    r"\bhangs? on\b",
    r"\b(?:is|are) through\b",
    r"\bso many\b",
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


def faults(markdown: str, *more: str, words: int = WORDS) -> list[str]:
    """What is wrong: a line for each turn of ``BANNED`` or ``more`` and each sentence of more than
    so many words."""
    found = []
    for paragraph in paragraphs(markdown):
        for turn in (*BANNED, *more):
            hit = re.search(turn, paragraph, flags=re.IGNORECASE)
            if hit:
                found.append(f"'{hit[0]}' in: {paragraph[:120]}")
        for sentence in sentences(paragraph):
            count = sum(bool(re.search(r"[A-Za-z]", word)) for word in sentence.split())
            if count > words:
                found.append(f"{count} words: {sentence[:160]}")
    return found


_MESSAGE = re.compile(
    r'\b(?:InputError|SimulationError)\(\s*((?:f?r?"(?:[^"\\]|\\.)*"\s*)+)', flags=re.DOTALL
)
_LITERAL = re.compile(r'f?r?"((?:[^"\\]|\\.)*)"')
_CELL = re.compile(r"^# %% \[markdown\]\n((?:#.*\n)+)", flags=re.MULTILINE)
_NO_VERBS = frozenset(
    "the a an of what where as that whether how one all each every at in no none two".split()
)


_NO_BEGINNINGS = frozenset(
    "about above across after against along among around as at because before behind below beside "
    "besides between beyond by during except for from in inside into like of on onto outside over "
    "per since than that those through to told towards under until upon with within without".split()
)


def prepositions(source: str) -> Iterator[str]:
    """First lines of the docstrings of a file of Python that begin with no noun and no verb."""
    for node in ast.walk(ast.parse(source)):
        body = getattr(node, "body", None)
        for item in body if isinstance(body, list) else ():
            if isinstance(item, ast.Expr) and isinstance(item.value, ast.Constant):
                text = item.value.value
                first = re.match(r"\W*(\w+)", text) if isinstance(text, str) else None
                if first and first[1].lower() in _NO_BEGINNINGS:
                    yield text.splitlines()[0]


def messages(source: str) -> Iterator[str]:
    """Messages of the errors that a file of Python raises; values count as one word."""
    for found in _MESSAGE.finditer(source):
        text = "".join(literal[1] for literal in _LITERAL.finditer(found[1]))
        yield re.sub(r"\{[^{}]*\}", "VALUE", text)


def notebook_markdown(source: str) -> str:
    """The Markdown of a notebook that is kept as Python."""
    cells = (re.sub(r"^# ?", "", cell[1], flags=re.MULTILINE) for cell in _CELL.finditer(source))
    return "\n\n".join(cells)


def public_docstrings(root: Path) -> Iterator[tuple[str, str, bool]]:
    """Name, docstring and whether it is a function: of public names and their public members."""
    for module, name in _imported(root / "__init__.pyi"):
        node = _definition(root.parent, module, name)
        yield name, ast.get_docstring(node) or "", isinstance(node, ast.FunctionDef)
        for inner in node.body if isinstance(node, ast.ClassDef) else ():
            if isinstance(inner, ast.FunctionDef) and not inner.name.startswith("_"):
                marks = {ast.unparse(mark).split(".")[-1] for mark in inner.decorator_list}
                is_value = bool(marks & {"property", "cached_property"})
                yield f"{name}.{inner.name}", ast.get_docstring(inner) or "", not is_value


def begins_with_a_verb(docstring: str) -> bool:
    """Whether a docstring may begin with an imperative: no article, no plural, no participle."""
    first = docstring.split(maxsplit=1)[0].strip(",.:;`").lower() if docstring else ""
    return bool(first) and first not in _NO_VERBS and not re.search(r"(?<!s)s$|ed$", first)


def _imported(path: Path) -> list[tuple[str, str]]:
    """Module and name of each ``from module import name`` of a file."""
    nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    return [
        (node.module, one.name)
        for node in nodes
        if isinstance(node, ast.ImportFrom) and node.module
        for one in node.names
        if not one.name.startswith("_")
    ]


def _definition(root: Path, module: str, name: str) -> ast.ClassDef | ast.FunctionDef:
    """The class or function that a module defines, or takes from another one."""
    place = root / module.replace(".", "/")
    files = (place.with_suffix(".py"), place / "__init__.pyi", place / "__init__.py")
    path = next(path for path in files if path.is_file())
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, (ast.ClassDef, ast.FunctionDef)) and node.name == name:
            return node
    (found,) = {m for m, n in _imported(path) if n == name}
    return _definition(root, found, name)


def help_of(command: type) -> Iterator[str]:
    """Docstrings that ``--help`` of a command shows: its own, its options' and theirs."""
    for kind in command.__mro__:
        if not dataclasses.is_dataclass(kind) or kind.__module__ == "types":
            continue  # A command that is made of others says what they say.
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
