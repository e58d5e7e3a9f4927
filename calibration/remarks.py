# SPDX-License-Identifier: Apache-2.0
"""What calibrations and checks can remark: each kind has a code, a severity and one sentence.

The kinds of a block are in its own table, ``calibration/<block>/remarks.py``; code that
finds something calls the kind with the figures of its sentence::

    FEW_FRAMES = warning("few_frames", "{count} frames: ...")
    remarks.append(FEW_FRAMES(count=3))

``remark_table`` lists them all, for docs/remarks.md.
"""

from __future__ import annotations

import importlib
import importlib.util
import pkgutil
import re
from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

from taccel_lab.report.remark import Remark, Severity

_LAST_STOP = re.compile(r"(?<!\.)\.$")
_FIELD = re.compile(r"\{(\w+)[^}]*\}")


@dataclass(frozen=True)
class RemarkKind:
    """One thing that a calibration or a check can remark."""

    code: str
    """Stable name for programs, such as ``scale_disagrees``."""
    severity: Severity
    text: str
    """A sentence with named figures, as for ``str.format``: what was found, and what to do."""
    blocks: tuple[str, ...] = ()
    """Blocks that a finding about captures concerns; empty for a remark about one calibration."""
    graver: Severity | None = None
    """Its severity where the figures are bad enough, as the caller judges."""

    def __call__(
        self,
        *,
        frames: Sequence[str] = (),
        blocks: Sequence[str] | None = None,
        grave: bool = False,
        **figures: Any,
    ) -> Remark:
        """The remark with its figures.

        Args:
            frames: Names of the images it is about.
            blocks: Blocks it concerns, where these depend on the captures.
            grave: Take the graver severity.
            figures: By the names of the sentence; sentences among them without their last stop,
                which the sentence has where another one follows.
        """
        figures = {
            name: _LAST_STOP.sub("", value) if isinstance(value, str) else value
            for name, value in figures.items()
        }
        severity = self.graver if grave and self.graver is not None else self.severity
        return Remark(
            severity,
            self.code,
            self.text.format(**figures).strip(),
            tuple(frames),
            self.blocks if blocks is None else tuple(blocks),
        )


def info(
    code: str, text: str, blocks: tuple[str, ...] = (), graver: Severity | None = None
) -> RemarkKind:
    """Kind that leaves the verdict as it is."""
    return RemarkKind(code, Severity.INFO, text, blocks, graver)


def warning(
    code: str, text: str, blocks: tuple[str, ...] = (), graver: Severity | None = None
) -> RemarkKind:
    """Kind that makes a verdict at most usable."""
    return RemarkKind(code, Severity.WARNING, text, blocks, graver)


def error(code: str, text: str, blocks: tuple[str, ...] = ()) -> RemarkKind:
    """Kind that makes a verdict weak."""
    return RemarkKind(code, Severity.ERROR, text, blocks)


def remark_kinds(*packages: ModuleType) -> list[tuple[str, RemarkKind]]:
    """All kinds with the one of ``packages`` whose table holds them, in the order of the tables.

    Kinds of a package's ``shared_remarks`` come first, under "several".
    """
    tables: list[tuple[str, ModuleType]] = []
    for package in packages:
        if importlib.util.find_spec(shared := f"{package.__name__}.shared_remarks"):
            tables.append(("several", importlib.import_module(shared)))
        for module in pkgutil.iter_modules(package.__path__):
            name = f"{package.__name__}.{module.name}.remarks"
            if module.ispkg and importlib.util.find_spec(name) is not None:
                tables.append((module.name, importlib.import_module(name)))
    found = [(block, kind) for block, table in tables for kind in vars(table).values()]
    kinds: list[tuple[str, RemarkKind]] = []
    for block, kind in found:  # A table may import what another one holds.
        if isinstance(kind, RemarkKind) and all(kind is not known for _, known in kinds):
            kinds.append((block, kind))
    return kinds


def remark_table(*packages: ModuleType) -> str:
    """docs/remarks.md: a list for each block, an item for each kind."""
    lines = [
        "# Remarks of calibrations and checks",
        "",
        "<!-- Made by `tools/list_remarks.py`; edit the tables in `calibration/<block>/remarks.py`",
        "and `taccel_lab/learning/force/remarks.py` instead. -->",
        "",
        "Look up a remark of a calibration or a finding of a check, by its code.",
        "",
        "```sh",
        "taccel-lab capture check captures --json     # `remarks` with their codes",
        "```",
        "",
        "Codes in `report.json` and `--json` are stable. Errors make a verdict `weak`, warnings at",
        "most `usable`. Brackets hold the severity and the blocks concerned. *Words in italics*",
        "stand for figures and names.",
    ]
    block = ""
    for name, kind in remark_kinds(*packages):
        if name != block:
            block = name
            lines += ["", f"## {name}", ""]
        severities = [kind.severity] if kind.graver is None else [kind.severity, kind.graver]
        meaning = _FIELD.sub(lambda field: f"*{field[1].replace('_', ' ')}*", kind.text)
        meaning = meaning.replace("**", "* *")
        about = "; ".join(filter(None, [" or ".join(severities), ", ".join(kind.blocks)]))
        lines.append(f"- `{kind.code}` ({about}): {meaning}")
    return "\n".join(lines) + "\n"
