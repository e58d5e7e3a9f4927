# SPDX-License-Identifier: Apache-2.0
"""Folders of profiles with parts that no profile can hold, and the hashes that belong to them."""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from taccel_lab.profile.io import encode_weights


def edit(folder: Path, **tables: Any) -> None:
    """Overwrite parts of profile.toml; None removes a table."""
    path = folder / "profile.toml"
    document = tomllib.loads(path.read_text(encoding="utf-8"))
    for key, value in tables.items():
        if value is None:
            del document[key]
        elif isinstance(value, dict):
            document[key] = {**document.get(key, {}), **value}
        else:
            document[key] = value
    path.write_text(tomli_w.dumps(document), encoding="utf-8")


def rehash(folder: Path, name: str, data: bytes) -> None:
    """Write an array file and list its true hash, so that only its content can be wrong."""
    (folder / name).write_bytes(data)
    edit(folder, files={name: hashlib.sha256(data).hexdigest()})


def swap_network(
    folder: Path,
    key: str,
    architecture: Mapping[str, Any] | None = None,
    weights: Mapping[str, np.ndarray] | None = None,
) -> None:
    """Give a block other settings or weights than those that it was written with."""
    if architecture is not None:
        edit(folder, **{key: {"architecture": dict(architecture)}})
    if weights is not None:
        name = {"normals": "normal"}.get(key, key) + "_model.safetensors"
        rehash(folder, name, encode_weights(weights))
