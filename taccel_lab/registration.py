# SPDX-License-Identifier: Apache-2.0
"""Tasks as environments that gymnasium knows by name, whichever of both packages loads first.

>>> import gymnasium, taccel_lab
>>> env = gymnasium.make("taccel_lab/PegInsertion-v0")    # doctest: +SKIP
>>> envs = gymnasium.make_vec("taccel_lab/PegInsertion-v0", num_envs=64)    # doctest: +SKIP

gymnasium has read no entry points of packages since 1.1; nothing here loads it.
"""

from __future__ import annotations

import sys
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any

KINDS = ("grasp-lift", "peg-insertion")
"""Kinds of tasks that can be learned."""
FILES = Path(__file__).parent / "tasks" / "files"
_HERE = "taccel_lab.learning"


def names() -> list[str]:
    """Tasks of the package that can be learned."""
    from taccel_lab.files.documents import read_toml

    found = {path.stem: read_toml(path) for path in FILES.glob("*.toml")}
    return sorted(name for name, table in found.items() if table.get("kind") in KINDS)


def env_id(task: str) -> str:
    """``taccel_lab/PegInsertion-v0`` of ``peg-insertion``."""
    return f"taccel_lab/{''.join(word.capitalize() for word in task.split('-'))}-v0"


def register_envs() -> None:
    """Register every task that can be learned."""
    from gymnasium import register

    for task in names():
        register(
            env_id(task),
            entry_point=f"{_HERE}.single_env:TactileEnv",
            vector_entry_point=f"{_HERE}.catalogue:make_vec",
            kwargs={"task": task},
        )


class _Finder(MetaPathFinder):
    """Finds gymnasium as the other finders do, until somebody has loaded it."""

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> ModuleSpec | None:
        if fullname != "gymnasium":
            return None
        for finder in sys.meta_path:
            spec = None if finder is self else finder.find_spec(fullname, path, target)
            if spec is not None:
                if spec.loader is not None:
                    self._note(spec.loader)
                return spec
        return None

    def _note(self, loader: Any) -> None:
        """Have the tasks registered once the loader has run; it stays what it is, since data files
        and sources are asked of it."""
        run = loader.exec_module

        def exec_module(module: ModuleType) -> None:
            del loader.exec_module
            run(module)
            sys.meta_path.remove(self)
            register_envs()

        loader.exec_module = exec_module


def register_with_gymnasium() -> None:
    """Register the tasks now, or as soon as gymnasium is imported."""
    if sys.modules.get("gymnasium") is not None:
        register_envs()
    else:
        sys.meta_path.insert(0, _Finder())
