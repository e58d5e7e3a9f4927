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


def _add_optics_and_layers(document: Document) -> Document:
    """Version 2 adds optional blocks of the optics, layers of the gel and their mesh array: a
    profile of version 1 has none of them and stays as it is."""
    return {**document, "schema_version": 2}


def _add_responses(document: Document) -> Document:
    """Version 3 adds optional blocks (normals, depth_response, perturbation), laws of the material
    and more evidence in the provenance: a profile of version 2 has none of them."""
    return {**document, "schema_version": 3}


def _add_position_bands(document: Document) -> Document:
    """Version 4 gives the networks of colours and normals a positional encoding, and those of
    normals a radius that 95 % of errors were found in; those of version 3 take the position as it
    is, and errors as normal deviates."""
    document = {**document, "schema_version": 4}
    for key in ("color", "normals"):
        block = document.get(key)
        # What is no table with a table in it is rejected by the schema, in its own words.
        if isinstance(block, dict) and isinstance(block.get("architecture"), dict):
            settings = {**block["architecture"], "position_bands": 0}
            if key == "normals":
                settings["radius95_sigmas"] = math.sqrt(-2.0 * math.log(0.05))
            document[key] = {**block, "architecture": settings}
    return document


def _add_fitted_with(document: Document) -> Document:
    """Version 5 adds to the material what it was fitted with, which a profile of version 4 does not
    know."""
    return {**document, "schema_version": 5}


def _add_height_errors(document: Document) -> Document:
    """Version 6 has networks of normals say how uncertain heights are, and how steep the balls
    were; those of version 5 do not know."""
    document = {**document, "schema_version": 6}
    block = document.get("normals")
    if isinstance(block, dict) and isinstance(block.get("architecture"), dict):
        unknown = {"cone_deg": 90.0, "error_length_px": 0.0, "height_factor": 0.0}
        document["normals"] = {**block, "architecture": {**block["architecture"], **unknown}}
    return document


def _add_force(document: Document) -> Document:
    """Version 7 adds the optional block force: a profile of version 6 has none."""
    return {**document, "schema_version": 7}


def _add_sessions(document: Document) -> Document:
    """Version 8 adds to the sensor how its captures were recorded, which a profile of version 7
    does not know."""
    return {**document, "schema_version": 8}


def _add_absolute_errors(document: Document) -> Document:
    """Version 9 has networks of normals and curves of grey sensors say how uncertain absolute
    depths are; those of version 8 do not know."""
    document = {**document, "schema_version": 9}
    block = document.get("normals")
    if isinstance(block, dict) and isinstance(block.get("architecture"), dict):
        unknown = {"along_factor": 0.0, "depth_share": 0.0}
        document["normals"] = {**block, "architecture": {**block["architecture"], **unknown}}
    return document


def _add_views(document: Document) -> Document:
    """Version 10 adds further cameras and bent light guides: a profile of version 9 has neither."""
    return {**document, "schema_version": 10}


def _one_light(document: Document) -> Document:
    """Version 11 has every image read in the profile's light and knows where presses were fitted;
    version 10 chose, and does not know."""
    document = {**document, "schema_version": 11}
    block = document.get("normals")
    if isinstance(block, dict) and isinstance(block.get("architecture"), dict):
        kept = {k: v for k, v in block["architecture"].items() if k != "light_drift"}
        document["normals"] = {**block, "architecture": {**kept, "presses_px": []}}
    return document


def _branches_alone(document: Document) -> Document:
    """Version 12 has Maxwell branches alone where version 11 had a Kelvin-Voigt damping time
    beside them; a time that is not zero is refused, as no branch acts alike at all rates."""
    document = {**document, "schema_version": 12}
    block = document.get("material")
    if isinstance(block, dict) and "damping_time_s" in block:
        if block["damping_time_s"] != 0:
            raise InputError(
                f"material.damping_time_s: must be 0 (found {block['damping_time_s']!r}); gels are "
                "damped by branches, see [[material.branches]] in docs/formats.md"
            )
        kept = {k: v for k, v in block.items() if k != "damping_time_s"}
        document["material"] = kept
    return document


STEPS: Mapping[int, Step] = {
    1: _add_optics_and_layers,
    2: _add_responses,
    3: _add_position_bands,
    4: _add_fitted_with,
    5: _add_height_errors,
    6: _add_force,
    7: _add_sessions,
    8: _add_absolute_errors,
    9: _add_views,
    10: _one_light,
    11: _branches_alone,
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
        document = steps[version](document)
        version += 1
        if document.get("schema_version") != version:
            raise RuntimeError(f"migration step {version - 1} did not set schema_version {version}")
    return document
