# SPDX-License-Identifier: Apache-2.0
"""USD files of others, with the layers that they are made of: all lie in their own folder.

Each layer is looked at by itself before a stage, which would open all that they name, is made.
https://openusd.org/release/glossary.html#usdglossary-composition
"""

from __future__ import annotations

import gc
import os
import re
import shutil
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path, PurePosixPath
from typing import Any

from taccel_lab.errors import InputError
from taccel_lab.files.inner_path import inner_path, named_path
from taccel_lab.files.regular_file import require_regular_file, shown
from taccel_lab.newton_bridge.usd_prims import require_few_prims
from taccel_lab.newton_bridge.usd_schemas import check_prim
from taccel_lab.printable import words_of

LAYERS = (".usd", ".usda", ".usdc")
PACKAGE = ".usdz"
MAX_LAYERS = 1000
_PLACE = re.compile(r"Error in '[^']*' at line \d+ in file \S+ : ")
"""What an error of USD begins with: where in its own source it comes from."""
MAX_BYTES = 1 << 30
"""Most bytes of a layer, and of all that a package holds."""


def unpacked(package: Path, scratch: Path) -> Path:
    """The first layer of a USDZ package, whose files are put into the folder ``scratch``.

    Raises InputError for what is no such package. https://openusd.org/release/spec_usdz.html
    """
    require_regular_file(package, MAX_BYTES, "a USDZ package")
    try:
        with zipfile.ZipFile(package) as archive:
            members = [member for member in archive.infolist() if not member.is_dir()]
            if len(members) > MAX_LAYERS:
                raise InputError(f"{package} holds more than {MAX_LAYERS:,} files")
            if sum(member.file_size for member in members) > MAX_BYTES:
                raise InputError(f"{package} holds more than {MAX_BYTES >> 30} GiB")
            if any(member.compress_type for member in members):
                raise InputError(f"{package} is compressed, which no USDZ package is")
            if not members or PurePosixPath(members[0].filename).suffix.lower() not in LAYERS:
                raise InputError(f"{package}: the first file of a package has to be a USD layer")
            if len({member.filename for member in members}) < len(members):
                raise InputError(f"{package} holds two files of one name")
            for member in members:
                path = inner_path(scratch, member.filename)
                path.parent.mkdir(parents=True, exist_ok=True)
                with archive.open(member) as source, path.open("xb") as copy:
                    shutil.copyfileobj(source, copy)
    except InputError as error:
        raise InputError(str(error).replace(str(scratch), str(package))) from None
    except Exception as error:  # Python's reader of archives follows what a damaged one says.
        raise InputError(f"{package} is no USDZ package: {words_of(error)}") from None
    return scratch / members[0].filename


def checked_layers(path: Path) -> list[Any]:
    """All layers that a USD file is made of, as ``Sdf.Layer``; to hold them keeps them as read.

    Raises InputError for a layer or other file that is named and lies outside the folder of
    ``path``, for a layer that is not there, cannot be read or is a package, for names that are
    computed, prims that are not understood, and more of them than are read.
    """
    from pxr import Sdf

    # What the user names may be a link, as tools that version data leave them.
    folder, waiting, seen, layers = path.parent, [(path.name, path)], {path.name}, []
    # What this process read before is out of date, and its stages would open what is read now.
    gc.collect()
    gc.freeze()  # Newton's own objects, of which each collection would look at a million again.
    if any(not layer.anonymous for layer in Sdf.Layer.GetLoadedLayers()):
        os._exit(1)  # The file is read again in a fresh process.
    # A name that is not beside its layer is looked for where the process is.
    os.chdir(folder)
    while waiting:
        name, file = waiting.pop()
        require_regular_file(file, MAX_BYTES, "a USD layer")
        if file.suffix.lower() not in LAYERS:
            raise InputError(
                f"{file} is a layer of a kind that is not read; allowed are {', '.join(LAYERS)}, "
                f"and {PACKAGE} as the file that is loaded"
            )
        layer, names = _read(file)
        layers.append(layer)
        at = os.path.dirname(name)
        for other, is_layer in names:
            try:
                found = named_path(folder, at, other)
            except InputError as error:
                raise InputError(f"{file} names {shown(other)}: {error}") from None
            suffix = PurePosixPath(other).suffix.lower()
            if not is_layer and not (suffix in (*LAYERS, PACKAGE) and found.exists()):
                continue
            inside = os.path.relpath(found, folder)
            if inside not in seen:
                seen.add(inside)
                waiting.append((inside, found))
            if len(seen) > MAX_LAYERS:
                raise InputError(f"{path} is made of more than {MAX_LAYERS:,} layers")
    require_few_prims(path, layers)
    return layers


def _read(file: Path) -> tuple[Any, list[tuple[str, bool]]]:
    """A layer, and the files that it names."""
    from pxr import Sdf

    try:
        layer = Sdf.Layer.FindOrOpen(str(file))
        if layer is not None:
            return layer, list(_names(layer))  # Values of a .usdc are read when they are asked for.
    except (InputError, MemoryError):
        raise
    except Exception as error:
        words = _PLACE.sub("", words_of(error))
        raise InputError(f"{file} is no readable USD layer: {words}") from None
    raise InputError(f"{file} is no readable USD layer")


def _names(layer: Any) -> Iterator[tuple[str, bool]]:
    """Files that a layer names, and whether they are layers of the stage."""
    from pxr import Sdf, UsdUtils

    composed = set(layer.GetCompositionAssetDependencies())
    others: set[str] = set()

    def note(name: str) -> str:
        others.add(name)
        return name

    # On a copy: what it takes for changed is no longer what the file says.
    copy = Sdf.Layer.CreateAnonymous()
    copy.TransferContent(layer)
    UsdUtils.ModifyAssetPaths(copy, note)
    layer.Traverse(layer.pseudoRoot.path, lambda path: _look_at(layer.GetObjectAtPath(path), note))
    for name in sorted(composed | others):
        if name.startswith("`") or "SDF_FORMAT_ARGS" in name:
            raise InputError(f"{layer.realPath} names {shown(name)}, which is computed: not read")
        if name:
            yield name, name in composed


def _look_at(spec: Any, note: Callable[[str], str]) -> None:
    """Note patterns that name files of value clips; refuse what is not understood."""
    from pxr import Sdf

    if isinstance(spec, Sdf.VariantSpec):
        spec = spec.primSpec
    if not isinstance(spec, Sdf.PrimSpec) or spec.path.isEmpty or spec.path == "/":
        return
    if spec.HasInfo("clips"):
        for clip in dict(spec.GetInfo("clips")).values():
            note(str(dict(clip).get("templateAssetPath", "")))
    check_prim(spec)
