# SPDX-License-Identifier: Apache-2.0
"""Names of code that docstrings quote, looked for in the code."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from itertools import pairwise
from pathlib import Path

_QUOTED = re.compile(r"``([A-Za-z_][\w.]*)(?:\(\))?``")
_FILE = re.compile(
    r"\.(?:pyi?|js|toml|ya?ml|csv|np[yz]|png|jpg|html|stl|urdf|onnx|pth|parquet|safetensors)$"
)
_ELSEWHERE = set(
    # Others' code; then formulas, and what files hold.
    "CALIB_CB_LARGER ModelBuilder.replicate labelled_solid.register lazy_loader.attach_stub "
    "mma.sync mma.sync.m16n8k16 slurm_partition solid.volume "
    "Phi WIDTHxDEPTHxHEIGHT camera_2 camera_optical_frame fc4.bias frame_2 frame_10 ftyp m_ij "
    "sensor.pixmm".split()
)


class Names:
    """Names that the files of a tree define and use, and those that their docstrings quote."""

    def __init__(self, root: Path, paths: Iterable[Path]) -> None:
        self.used: set[str] = set()
        """Words of the code, docstrings left out."""
        self.members: dict[str, set[str]] = defaultdict(set)
        """Names defined in a package or a module, by its own name."""
        self.attributes: set[str] = set()
        """Names that any class has."""
        self.others: set[str] = set()
        """Modules of others, and what is imported of them."""
        self.quoted: list[tuple[Path, str]] = []
        for path in paths:
            parts = path.relative_to(root).with_suffix("").parts
            # Three packages stand beside the one that they belong to.
            parts = parts if parts[0] == "taccel_lab" else ("taccel_lab", *parts)
            for owner, name in pairwise(parts):
                self.members[owner].add(name)
            self.used.update(parts)
            tree = ast.parse(path.read_text(encoding="utf-8"))
            self.members[parts[-2] if parts[-1] == "__init__" else parts[-1]] |= _defined(tree)
            self._read(path, tree)

    def _read(self, path: Path, tree: ast.Module) -> None:
        docstrings: set[ast.AST] = set()
        for node in ast.walk(tree):
            match node:
                case ast.Expr(value=ast.Constant(value=str(text)) as docstring):
                    docstrings.add(docstring)
                    self.quoted += [(path, name) for name in _QUOTED.findall(text)]
                case ast.Constant(value=str(text)) if node not in docstrings:
                    self.used.update(re.findall(r"\w+", text))
                case ast.ClassDef():
                    self.attributes |= _defined(node)
                case ast.Attribute(value=ast.Name(id="self"), attr=name):
                    self.attributes.add(name)
                case ast.Import(names=names) | ast.ImportFrom(names=names):
                    for alias in names:
                        first = (getattr(node, "module", None) or alias.name).split(".")[0]
                        self.used.update({first, *alias.name.split(".")})
                        if first != "taccel_lab":
                            self.others.update({first, alias.asname or alias.name})
            words = (
                getattr(node, field, None) for field in ("id", "attr", "name", "arg", "asname")
            )
            self.used.update(word for word in words if isinstance(word, str))

    def missing(self) -> Iterator[tuple[Path, str]]:
        """Quoted names that are nowhere, with the files that quote them."""
        anywhere = self.attributes | self.others
        for path, name in self.quoted:
            first, *rest = parts = [part for part in name.split(".") if part]
            if name in _ELSEWHERE or "NAME" in name or _FILE.search(name) or first in self.others:
                continue
            if first not in self.used or any(
                inner not in anywhere and inner not in self.members.get(owner, ())
                for owner, inner in zip(parts, rest, strict=False)
            ):
                yield path, name


def _defined(owner: ast.Module | ast.ClassDef) -> set[str]:
    """Names that a module or a class defines or imports, those within conditions too."""
    waiting, found = [*owner.body], set()
    while waiting:
        match waiting.pop():
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
                found.add(name)
            case ast.If(body=body, orelse=other) | ast.Try(body=body, orelse=other):
                waiting += [*body, *other]
            case ast.Import(names=names) | ast.ImportFrom(names=names):
                found.update(alias.asname or alias.name for alias in names)
            case statement:
                inside = (one for one in ast.walk(statement) if isinstance(one, ast.Name))
                found.update(one.id for one in inside if isinstance(one.ctx, ast.Store))
    return found
