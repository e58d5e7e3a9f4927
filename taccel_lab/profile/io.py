# SPDX-License-Identifier: Apache-2.0
"""Reading, writing and checking profile folders. The format is described in docs/formats.md.

Arrays are files of their own: mesh and background as npz, weights as safetensors. Encoding is
deterministic (equal arrays give equal bytes), so that hashes can be compared between profiles.
Decoding refuses what it does not expect: missing or extra keys, wrong types, pickles.
"""

from __future__ import annotations

import hashlib
import io
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.files.arrays import MAX_ARRAY_BYTES, unpack_npz
from taccel_lab.files.documents import read_toml
from taccel_lab.files.inner_path import inner_path
from taccel_lab.files.output_folder import atomic_directory
from taccel_lab.files.regular_file import read_regular_file
from taccel_lab.geometry import TetMesh
from taccel_lab.geometry.tet_checks import check_connectivity
from taccel_lab.guards import unknown
from taccel_lab.profile.migrate import migrate
from taccel_lab.profile.schema import SCHEMA_VERSION, Block, SensorBlock, judge_parameters
from taccel_lab.profile.sensor_profile import ARRAY_FIELDS, SensorProfile
from taccel_lab.profile.sensor_view import (
    BLOCK_TYPES,
    OPTIONAL_BLOCKS,
    OWN_KEYS,
    VIEW_KEYS,
    SensorView,
    require_view_name,
)
from taccel_lab.typed import typed

MESH_KEYS = ("nodes_m", "tets", "faces", "face_regions")
LAYER_KEY = "tet_layers"
"""Stored beside them for a gel of several layers."""


def _encode_npz(arrays: Mapping[str, np.ndarray]) -> bytes:
    # numpy stamps zip members with a fixed date, hence the determinism.
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()


def _decode_npz(
    data: bytes, keys: tuple[str, ...], optional: tuple[str, ...] = ()
) -> dict[str, np.ndarray]:
    arrays = unpack_npz(data)
    if not set(keys) <= arrays.keys() <= {*keys, *optional}:
        raise InputError(f"must hold the arrays {sorted(keys)}, found {sorted(arrays)}")
    return arrays


def encode_mesh(mesh: TetMesh) -> bytes:
    """Bytes of ``mesh.npz``."""
    keys = (*MESH_KEYS, LAYER_KEY) if mesh.tet_layers.any() else MESH_KEYS
    return _encode_npz({key: getattr(mesh, key) for key in keys})


def decode_mesh(data: bytes) -> TetMesh:
    """The mesh in ``mesh.npz``; raises InputError when it is damaged or not a valid mesh."""
    arrays = _decode_npz(data, MESH_KEYS, (LAYER_KEY,))
    for key, array in arrays.items():
        kind = "f" if key == "nodes_m" else "i"
        if array.dtype.kind != kind:
            raise InputError(f"{key} has type {array.dtype}, which is not a {kind}-type")
    mesh = TetMesh(**arrays)
    check_connectivity(mesh, "the mesh")
    return mesh


def encode_background(rgb: np.ndarray) -> bytes:
    """Bytes of ``background.npz``; ``rgb`` has shape [H, W, 3], uint8 or float32."""
    return _encode_npz({"rgb": rgb})


def decode_background(data: bytes) -> np.ndarray:
    """The RGB image in ``background.npz``, shape [H, W, 3]."""
    return _decode_npz(data, ("rgb",))["rgb"]


def encode_weights(weights: Mapping[str, np.ndarray]) -> bytes:
    """Bytes of ``color_model.safetensors``."""
    from safetensors.numpy import save

    # safetensors writes the raw buffer: a transposed view would be stored scrambled.
    return save({name: np.ascontiguousarray(weights[name]) for name in sorted(weights)})


def decode_weights(data: bytes) -> dict[str, np.ndarray]:
    """The named weights in ``color_model.safetensors``."""
    from safetensors import SafetensorError
    from safetensors.numpy import load

    try:
        return load(data)
    except (SafetensorError, ValueError, KeyError) as error:
        raise InputError(f"is not a readable safetensors file ({error})") from None


PROFILE_FILE = "profile.toml"
_VIEWS = "views"
"""Table of further cameras, and the folder that holds a folder of each."""

_DECODERS: dict[str, Callable[[bytes], Any]] = {
    "gel": decode_mesh,
    "background": decode_background,
    "color": decode_weights,
    "normals": decode_weights,
    "force": decode_weights,
}
_ENCODERS: dict[str, Callable[[Any], bytes]] = {
    "gel": encode_mesh,
    "background": encode_background,
    "color": encode_weights,
    "normals": encode_weights,
    "force": encode_weights,
}
_ARRAY_FILES = {
    block.key: block.model_fields["file"].default
    for block in BLOCK_TYPES
    if block.key in ARRAY_FIELDS
}
_HEADER = "# Sensor profile written by taccel-lab. The format is described in docs/formats.md.\n\n"


@dataclass(frozen=True)
class Finding:
    """One thing noticed about the folder of a profile or of a data set."""

    severity: Literal["error", "warning"]
    where: str
    """File, or file and key."""
    message: str

    def __str__(self) -> str:
        return f"{self.where}: {self.message}"


@typed
def save_profile(
    profile: SensorProfile, path: Path | str, only: Collection[str] | None = None
) -> None:
    """Write ``profile`` as the folder ``path``, which appears whole or not at all.

    An earlier profile there is replaced; a folder that holds anything else is rejected. With
    ``only``, blocks of these keys alone are written: ``load_profile`` needs ``onto`` for them.
    """
    with profile_saved(profile, path, only):
        pass


@contextmanager
def profile_saved(
    profile: SensorProfile, path: Path | str, only: Collection[str] | None = None
) -> Iterator[None]:
    """Write ``profile`` as ``save_profile`` does, where it stands when the block has ended without
    an error: what is written in the block stands with it, or neither does."""
    path = Path(path)
    require_profile_folder(path)
    with atomic_directory(path, check=require_profile_folder) as staging:
        _write(profile, staging, only)
        yield


def _write(profile: SensorProfile, folder: Path, only: Collection[str] | None) -> None:
    import tomli_w

    blocks = {key: b for key, b in profile.blocks().items() if only is None or key in only}
    files = {
        _ARRAY_FILES[key]: _ENCODERS[key](getattr(profile, ARRAY_FIELDS[key]))
        for key in blocks
        if key in ARRAY_FIELDS
    }
    document: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "files": {name: _sha256(data) for name, data in files.items()},
    }
    for key, block in blocks.items():
        document[key] = _toml_table(block)
    if only is None and profile.views:
        document[_VIEWS] = {}
        for name in profile.views:
            seen = folder / _VIEWS / name
            seen.mkdir(parents=True)
            _write(profile.seen_by(name), seen, VIEW_KEYS)
            document[_VIEWS][name] = _sha256((seen / PROFILE_FILE).read_bytes())
    for name, data in files.items():
        (folder / name).write_bytes(data)
    text = _HEADER + tomli_w.dumps(document)
    (folder / PROFILE_FILE).write_text(text, encoding="utf-8", newline="\n")


MOST_LINES = 12
"""Most lines of a refusal; ``validate`` lists all faults."""


def load_profile(path: Path | str, onto: SensorProfile | None = None) -> SensorProfile:
    """Read and check the profile folder ``path``; ``FOLDER@NAME`` is one of its views.

    Blocks that the folder lacks are those of ``onto``, where one is given. Raises InputError that
    names each wrong file and key: nothing is repaired or assumed.
    """
    path, view = split_view(path)
    profile, findings = _read(Path(path), onto)
    errors = [finding for finding in findings if finding.severity == "error"]
    if errors or profile is None:
        more = len(errors) - MOST_LINES
        lines = [str(finding) for finding in errors[:MOST_LINES]]
        raise InputError("\n".join([*lines, f"and {more} more"] if more > 0 else lines))
    return profile if view is None else profile.seen_by(view)


def split_view(name: Path | str) -> tuple[str, str | None]:
    """``out/profile@left`` as the name of a sensor and of its view; no view where nothing is said
    of one, or a file or folder has that very name."""
    text = str(name)
    sensor, at, view = text.rpartition("@")
    if not (at and sensor and view) or "/" in view or Path(text).exists():
        return text, None
    return sensor, view


@typed
def validate_profile(path: Path | str) -> list[Finding]:
    """Everything wrong (errors) or odd (warnings) with the profile folder; empty when sound."""
    return _read(Path(split_view(path)[0]))[1]


def _toml_table(block: Block) -> dict[str, Any]:
    """The block's values without empty lists and what is not known, then its provenance without
    empty tables."""
    table = block.model_dump(mode="python")
    provenance = table.pop("provenance")
    table = {key: value for key, value in table.items() if value not in ((), None)}
    if sessions := table.get("recorded"):
        table["recorded"] = [_known(session) for session in sessions]
    table["provenance"] = _known(provenance)
    return table


def _known(table: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in table.items() if value not in ({}, (), None)}


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def require_profile_folder(path: Path | str) -> None:
    """Refuse a target of ``save_profile`` that is a file or holds anything but a profile.

    Saving replaces the folder, so it must not hold somebody's other files. Commands call this
    first, before any long work.
    """
    path = Path(path)
    if path.exists() and not path.is_dir():
        raise InputError(f"{path} is a file; a profile is a folder")
    if not path.is_dir():
        return
    foreign = sorted(str(entry.relative_to(path)) for entry in _foreign(path))
    if foreign:
        shown = ", ".join(foreign[:3]) + (" ..." if len(foreign) > 3 else "")
        raise InputError(f"{path} holds files that are not part of a profile ({shown}); not saved")


def _foreign(path: Path, *, view: bool = False) -> list[Path]:
    """What is no part of a profile in a folder, or in that of a view."""
    known = {PROFILE_FILE, *_ARRAY_FILES.values()}
    found = [entry for entry in path.iterdir() if entry.name not in known]
    views = path / _VIEWS
    if view or not views.is_dir():
        return found
    found = [entry for entry in found if entry != views]
    for entry in views.iterdir():
        found += _foreign(entry, view=True) if entry.is_dir() else [entry]
    return found


def _read(
    path: Path, onto: SensorProfile | None = None, keys: Collection[str] | None = None
) -> tuple[SensorProfile | None, list[Finding]]:
    findings: list[Finding] = []

    def error(where: str | Path, problem: object) -> None:
        for line in str(problem).splitlines():
            line = line.removeprefix(str(where)).lstrip(": ")
            findings.append(Finding("error", str(where), line))

    toml_path = path / PROFILE_FILE
    try:
        document = migrate(_read_toml(path))
    except InputError as problem:
        error(toml_path, problem)
        return None, findings

    hashes = document.get("files")
    if not isinstance(hashes, dict):
        error(toml_path, "files: the table of file hashes is missing")
        hashes = {}
    parts: dict[str, Any] = {}
    try:
        _refuse_unknown_tables(document, keys)
    except InputError as problem:
        error(toml_path, problem)
    for block_type in BLOCK_TYPES:
        needed = onto is None if keys is None else block_type.key in OWN_KEYS
        try:
            block = _read_block(block_type, document, optional=not needed)
        except InputError as problem:
            error(toml_path, problem)
            continue
        if block is not None:
            parts[block_type.key] = block
    used = {}
    for key, name in _ARRAY_FILES.items():
        if key not in document:
            continue
        used[name] = key
        try:
            data = _read_file(inner_path(path, name), hashes.get(name))
            parts[ARRAY_FIELDS[key]] = _DECODERS[key](data)
        except InputError as problem:
            error(path / name, problem)
    for name in hashes:
        if name not in used:
            error(toml_path, f"files.{name}: no block refers to this file")
    for entry in sorted(path.iterdir()):
        read = entry.name in (PROFILE_FILE, *used) or (entry.name == _VIEWS in document)
        if not read:
            findings.append(Finding("warning", str(entry), "not part of the profile; not read"))

    if SensorBlock.key in parts:
        verdict = judge_parameters(parts[SensorBlock.key])
        for fault in verdict.faults:
            error(path, fault)
        if verdict.unjudged:
            findings.append(Finding("warning", str(toml_path), verdict.unjudged))
    if any(finding.severity == "error" for finding in findings):
        return None, findings
    try:
        profile = SensorProfile(**parts) if onto is None else replace(onto, **parts)
        seen, more = _read_views(path, document.get(_VIEWS, {}), profile)
        findings += more
        if any(finding.severity == "error" for finding in more):
            return None, findings
        return replace(profile, views=seen) if seen else profile, findings
    except InputError as problem:
        error(path, problem)
        return None, findings


def _read_views(
    path: Path, stated: object, profile: SensorProfile
) -> tuple[dict[str, SensorView], list[Finding]]:
    """Further cameras of a profile, and what is wrong with them."""
    if not isinstance(stated, dict):
        raise InputError(f"views: must be a table of names and SHA-256 (found {stated!r})")
    # What a view lacks it has not from the main camera.
    bare = profile.without(*(key for key in VIEW_KEYS if key not in OWN_KEYS))
    views: dict[str, SensorView] = {}
    findings: list[Finding] = []
    for name, digest in stated.items():
        folder = path / _VIEWS / require_view_name(name)
        try:
            _read_file(inner_path(path, f"{_VIEWS}/{name}/{PROFILE_FILE}"), digest)
        except InputError as problem:
            findings.append(Finding("error", str(folder / PROFILE_FILE), str(problem)))
            continue
        seen, more = _read(folder, bare, VIEW_KEYS)
        findings += more
        if seen is not None:
            views[name] = SensorView.of(seen)
    if (path / _VIEWS).is_dir() and stated:
        for entry in sorted((path / _VIEWS).iterdir()):
            if entry.name not in stated:
                findings.append(Finding("warning", str(entry), "not part of the profile; not read"))
    return views, findings


def _read_toml(path: Path) -> dict[str, Any]:
    if not path.is_dir():
        raise InputError("no such profile folder" if not path.exists() else "is not a folder")
    toml_path = inner_path(path, PROFILE_FILE)
    if not toml_path.is_file():
        raise InputError("no such file; a profile is a folder with profile.toml in it")
    return read_toml(toml_path)


def _refuse_unknown_tables(document: dict[str, Any], keys: Collection[str] | None) -> None:
    allowed = ["schema_version", "files", *(keys or (block.key for block in BLOCK_TYPES))]
    if keys is None:
        allowed.append(_VIEWS)
    strange = [key for key in document if key not in allowed]
    if strange:
        raise InputError(
            "\n".join(
                f"{key}: unknown key{unknown(key, allowed, they_are='allowed')}" for key in strange
            )
        )


def _read_block(
    block_type: type[Block], document: dict[str, Any], *, optional: bool
) -> Block | None:
    key = block_type.key
    if key not in document:
        if optional or key in OPTIONAL_BLOCKS:
            return None
        raise InputError(f"{key}: the table is missing")
    if not isinstance(document[key], dict):
        raise InputError(f"{key}: must be a table (found {document[key]!r})")
    return block_type(**document[key])


def _read_file(path: Path, stated: object) -> bytes:
    if not (isinstance(stated, str) and re.fullmatch("[0-9a-f]{64}", stated)):
        raise InputError(f"{PROFILE_FILE} lists no SHA-256 of it under files (found {stated!r})")
    if not path.is_file():
        raise InputError("no such file, though profile.toml lists it")
    data = read_regular_file(path, MAX_ARRAY_BYTES, "a file of arrays")
    found = _sha256(data)
    if found != stated:
        raise InputError(
            f"SHA-256 is {found[:12]}..., profile.toml says {stated[:12]}...: the file was changed "
            "or damaged after the profile was written"
        )
    return data
