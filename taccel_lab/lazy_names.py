# SPDX-License-Identifier: Apache-2.0
"""Public names of a package that load their modules on first use (PEP 562).

The stub beside the package's ``__init__.py`` says which module each name comes from; type checkers
read the same file, so each name stands in one place. As ``lazy_loader.attach_stub`` of Scientific
Python does it, without being one more library that even a machine with nothing but Warp needs.
"""

from __future__ import annotations

import ast
import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any


def lazy_names(
    package: str, init_file: str
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """``__getattr__``, ``__dir__`` and ``__all__`` of ``package``, whose file is ``init_file``."""
    stub = ast.parse(Path(init_file).with_suffix(".pyi").read_text(encoding="utf-8"))
    homes = {
        alias.name: str(node.module)
        for node in stub.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }

    def load(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(importlib.import_module(homes[name]), name)

    return load, lambda: sorted(homes), sorted(homes)
