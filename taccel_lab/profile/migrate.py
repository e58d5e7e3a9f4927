# SPDX-License-Identifier: Apache-2.0
"""Old profiles brought to the current schema, one function per version step.

``STEPS[n]`` takes the parsed ``profile.toml`` of version n and returns that of version n + 1,
without changing its argument. Version 1 is the first. Each step comes with a stored profile of the
old version in ``tests/profile/old``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from taccel_lab.errors import InputError
from taccel_lab.profile.schema import SCHEMA_VERSION

Document = dict[str, Any]
Step = Callable[[Document], Document]


def _as_it_is(document: Document) -> Document:
    """A version that adds optional blocks and keys: older profiles have none of them."""
    return document


def _with_settings(document: Document, key: str, dropped: str = "", **added: Any) -> Document:
    """The document with other settings of the network of block ``key``."""
    block = document.get(key)
    # What is no table with a table in it is rejected by the schema, in its own words.
    if not isinstance(block, dict) or not isinstance(block.get("architecture"), dict):
        return document
    kept = {name: value for name, value in block["architecture"].items() if name != dropped}
    return {**document, key: {**block, "architecture": {**kept, **added}}}


def _add_position_bands(document: Document) -> Document:
    """Version 4 gives the networks of colours and normals a positional encoding, and those of
    normals a radius that 95 % of errors were found in; those of version 3 take the position as it
    is, and errors as normal deviates."""
    document = _with_settings(document, "color", position_bands=0)
    radius = math.sqrt(-2.0 * math.log(0.05))
    return _with_settings(document, "normals", position_bands=0, radius95_sigmas=radius)


def _add_height_errors(document: Document) -> Document:
    """Version 6 has networks of normals say how uncertain heights are, and how steep the balls
    were; those of version 5 do not know."""
    return _with_settings(
        document, "normals", cone_deg=90.0, error_length_px=0.0, height_factor=0.0
    )


def _add_absolute_errors(document: Document) -> Document:
    """Version 9 has networks of normals and curves of grey sensors say how uncertain absolute
    depths are; those of version 8 do not know."""
    return _with_settings(document, "normals", along_factor=0.0, depth_share=0.0)


def _one_light(document: Document) -> Document:
    """Version 11 has every image read in the profile's light and knows where presses were fitted;
    version 10 chose, and does not know."""
    return _with_settings(document, "normals", dropped="light_drift", presses_px=[])


def _branches_alone(document: Document) -> Document:
    """Version 12 has Maxwell branches alone where version 11 had a Kelvin-Voigt damping time
    beside them; a time that is not zero is refused, as no branch acts alike at all rates."""
    block = document.get("material")
    if not isinstance(block, dict) or "damping_time_s" not in block:
        return document
    if block["damping_time_s"] != 0:
        raise InputError(
            f"material.damping_time_s: must be 0 (found {block['damping_time_s']!r}); gels are "
            "damped by branches, see [[material.branches]] in docs/formats.md"
        )
    kept = {name: value for name, value in block.items() if name != "damping_time_s"}
    return {**document, "material": kept}


def _ensembles_alone(document: Document) -> Document:
    """Version 13 has a small network beside the ensemble of normals; in version 12 that reads
    all."""
    return _with_settings(document, "normals", small_hidden=[])


def _own_unit(document: Document) -> Document:
    """Version 14 has networks of normals say how far slopes of other units are off; those of
    version 13 are taken to be read on the unit that was captured."""
    return _with_settings(document, "normals", unit_share=0.0)


STEPS: Mapping[int, Step] = {
    1: _as_it_is,  # Blocks of the optics, layers of the gel and their mesh array.
    2: _as_it_is,  # Normals, depth_response, perturbation, laws of the material, more evidence.
    3: _add_position_bands,
    4: _as_it_is,  # What the material was fitted with.
    5: _add_height_errors,
    6: _as_it_is,  # The block force.
    7: _as_it_is,  # How captures were recorded.
    8: _add_absolute_errors,
    9: _as_it_is,  # Further cameras and bent light guides.
    10: _one_light,
    11: _branches_alone,
    12: _ensembles_alone,
    13: _own_unit,
}


def migrate(
    document: Document, *, current: int = SCHEMA_VERSION, steps: Mapping[int, Step] = STEPS
) -> Document:
    """Return ``document`` in the ``current`` schema version."""
    version = document.get("schema_version")
    if isinstance(version, bool) or not isinstance(version, int):
        raise InputError(f"schema_version: must be a whole number (found {version!r})")
    if version > current:
        raise InputError(
            f"schema_version: {version} was written by a newer version of taccel-lab; this one "
            f"reads versions up to {current}. Upgrade taccel-lab to read it"
        )
    while version < current:
        if version not in steps:
            raise InputError(f"schema_version: version {version} is not known")
        document = {**steps[version](document), "schema_version": version + 1}
        version += 1
    return document
