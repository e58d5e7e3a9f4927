# SPDX-License-Identifier: Apache-2.0
"""The text of a ``captures.toml``, as importers and recordings write it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from taccel_lab.printable import printable

_FIRST = ("schema_version", "sensor", "unit", "background", "untouched", "mask")
_THEN = ("mm_per_px_x", "mm_per_px_y", "source", "license")
_FREE = ("unit", "source", "license", "assumed", "recorded")
"""Free text, which may quote anything."""


def manifest_text(manifest: Mapping[str, Any], notes: Sequence[str] = ()) -> str:
    """TOML of the keys of ``CaptureManifest``, what is read first at its head, under ``notes`` as
    comments. Free text is made printable."""
    import tomli_w

    keys = [*(key for key in (*_FIRST, *_THEN) if key in manifest)]
    keys += [key for key in manifest if key not in keys]
    # File names stay as they are, since files are found by them.
    values = {key: _printable(manifest[key]) if key in _FREE else manifest[key] for key in keys}
    lines = (line for note in notes for line in note.splitlines())
    return "".join(f"# {printable(line)}\n" for line in lines) + tomli_w.dumps(values)


def _printable(value: Any) -> Any:
    if isinstance(value, str):
        return printable(value)
    if isinstance(value, Mapping):
        return {key: _printable(inner) for key, inner in value.items()}
    return [_printable(inner) for inner in value] if isinstance(value, list) else value
