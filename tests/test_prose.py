# SPDX-License-Identifier: Apache-2.0
"""Pages, help, messages and docstrings are short, and in the English that an engineer speaks."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import pytest

from taccel_lab.cli.app import DESCRIPTION, Group, command_tree
from tests.support.prose import (
    HISTORY,
    begins_with_a_verb,
    faults,
    help_of,
    messages,
    notebook_markdown,
    prepositions,
    public_docstrings,
    sentences,
)
from tests.support.quoted_names import Names

ROOT = Path(__file__).parents[1]
REMARKS = "remarks.md"
"""Made from tables of messages: their wording is not held here."""
PAGES = sorted(
    path
    for path in (ROOT / "docs").rglob("*.md")
    if "generated" not in path.parts and path.name != "changelog.md"
)
EVIDENCE = {"scores", "verification", "task_results", "ablations", "benchmarks"}
"""Pages that may state commits and dates: they tell of measurements."""
MOST_WORDS, MOST_WORDS_OF_A_TASK = 60_000, 800
MESSAGE_WORDS = 25
PACKAGES = ("taccel_lab", "cad", "calibration", "sensors", "tools/bench")
CODE_AND_TABLES = re.compile(r"^```.*?^```|^\|[^\n]*$", flags=re.DOTALL | re.MULTILINE)
GROUPS = [entry for entry in command_tree().values() if isinstance(entry, Group)]
COMMANDS = {
    f"{name} {word}".strip(): command
    for name, entry in command_tree().items()
    for word, command in (entry.commands if isinstance(entry, Group) else {"": entry}).items()
}


def of_sources(told: Callable[[str], Iterable[str]]) -> list[str]:
    """Findings about each file of ours."""
    found = ((path, word) for path in sources("py") for word in told(read(path)))
    return [f"{path.relative_to(ROOT)}: {word}" for path, word in found]


def sources(suffix: str) -> list[Path]:
    """Files of ours with a suffix."""
    return [path for folder in PACKAGES for path in (ROOT / folder).rglob(f"*.{suffix}")]


def read(path: Path) -> str:
    return path.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "page",
    [path for path in (ROOT / "README.md", *PAGES) if path.name != REMARKS],
    ids=lambda path: path.name,
)
def test_pages_are_plain(page: Path) -> None:
    history = () if page.stem in EVIDENCE else HISTORY
    assert not faults(read(page), *history)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_is_plain(command: str) -> None:
    assert not [fault for text in help_of(COMMANDS[command]) for fault in faults(text)]


def test_help_of_groups_is_plain() -> None:
    texts = (DESCRIPTION, *(group.help for group in GROUPS))
    assert not [fault for text in texts for fault in faults(text)]


def test_messages_are_plain() -> None:
    """What is wrong, and what is allowed: each a sentence."""

    def wrong(source: str) -> Iterator[str]:
        for message in messages(source):
            yield from faults(re.sub(r"[;:] ", ".\n\n", message), words=MESSAGE_WORDS)

    assert not of_sources(wrong)


@pytest.mark.thorough
def test_docstrings_of_public_names_are_plain() -> None:
    documented = list(public_docstrings(ROOT / "taccel_lab"))
    assert len(documented) > 100
    found = [f"{name}: {fault}" for name, text, _ in documented for fault in faults(text)]
    assert not found
    bare = [name for name, text, is_function in documented if is_function and text
            and not begins_with_a_verb(text)]  # fmt: skip
    assert not bare


@pytest.mark.thorough
def test_docstrings_begin_with_a_noun_or_a_verb() -> None:
    assert not of_sources(prepositions)


@pytest.mark.thorough
def test_names_that_docstrings_quote_exist() -> None:
    files = (path for end in ("py", "pyi") for path in sources(end))
    names = Names(ROOT, files)
    assert len(names.quoted) > 3000
    assert not [f"{path.relative_to(ROOT)}: {name}" for path, name in names.missing()]


def test_quoted_names_are_looked_for_where_they_should_be(tmp_path: Path) -> None:
    quoted = "``Press.depth`` ``press.Press`` ``room`` ``wp.array`` ``Press.gone`` ``old.Press``"
    code = f'"""{quoted}"""\nimport warp as wp\nclass Press:\n    depth: float = 1.0\n'
    (tmp_path / "taccel_lab" / "room").mkdir(parents=True)
    path = tmp_path / "taccel_lab" / "room" / "press.py"
    path.write_text(code)
    assert [name for _, name in Names(tmp_path, [path]).missing()] == ["Press.gone", "old.Press"]


@pytest.mark.parametrize("path", sorted((ROOT / "notebooks").glob("*.py")), ids=lambda p: p.name)
def test_notebooks_are_plain(path: Path) -> None:
    assert not faults(notebook_markdown(read(path)), *HISTORY)


def test_pages_are_short() -> None:
    assert sum(len(read(path).split()) for path in PAGES) <= MOST_WORDS
    index = read(ROOT / "docs" / "index.md")
    (names,) = re.findall(r":caption: How to\n:maxdepth: 1\n\n(.*?)\n```", index, flags=re.DOTALL)
    for name in names.split():
        text = re.sub(CODE_AND_TABLES, "", read(ROOT / "docs" / f"{name}.md"))
        assert len(text.split()) <= MOST_WORDS_OF_A_TASK, name


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_pages_begin_with_a_command_and_a_picture(page: Path) -> None:
    without = ("install", "notebooks", "python", "remarks")
    if page.parent.name == "docs" and page.stem not in without:
        head = " ".join(read(page).split()[:250])
        assert "```" in head and re.search(r"!\[.*?\]\(images/", head)


def test_the_linter_finds_what_it_should() -> None:
    assert faults("The number of pixels is told.\n")
    assert faults("- " + "word " * 36 + "end.\n")
    assert not faults("```sh\n# what it is told goes with " + "word " * 40 + "\n```\n")
    assert not faults("See [this page](goes_with.md).\n")
    raised = 'raise InputError(\n    f"{name} is told, "\n    "twice"\n)'
    assert list(messages(raised)) == ["VALUE is told, twice"]
    assert notebook_markdown("# %% [markdown]\n# # Title\n# Text.\n\n# %%\nx = 1\n") == (
        "# Title\nText.\n"
    )
    said = '"""As JSON."""\nN = 3\n"""Of a press."""\nM = 4\n"""Most presses, of any kind."""\n'
    assert list(prepositions(said)) == ["As JSON.", "Of a press."]
    assert begins_with_a_verb("Return it.") and not begins_with_a_verb("The image.")
    assert sentences("One `a. B` here. Two, e.g. three.") == ["One CODE here.", "Two, e.g. three."]
