# SPDX-License-Identifier: Apache-2.0
"""MJCF files of others, with all that they include: nothing is opened outside their own folder.

Newton's reader would follow any path. It gets one text without includes instead, in which meshes
are absolute paths that were looked at.
https://mujoco.readthedocs.io/en/stable/XMLreference.html
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from taccel_lab.errors import InputError
from taccel_lab.files.inner_path import named_path, real_path
from taccel_lab.files.regular_file import read_text, require_regular_file, shown
from taccel_lab.files.triangle_file import MAX_BYTES
from taccel_lab.files.xml_file import MAX_DEPTH, XML_LIMIT_BYTES, read_xml
from taccel_lab.newton_bridge.mjcf_understood import understood

MAX_ELEMENTS = 50_000
"""Most elements of the robot with all that it includes; a humanoid with hands and muscles has
4,000."""
MAX_FILES = 1000
"""Most files that are included, each as often as it is."""
_ROOTS = ("mujoco", "mujocoinclude")
_MESHES = (".stl", ".obj", ".msh")
"""MuJoCo's own."""
_OPENED = "mesh"
"""The element whose file newton opens."""
_GEOMETRY = ("v", "f", "g", "o", "l", "p", "s", "usemtl")
"""How lines of an OBJ file begin that are no comment and name no other file."""


def whole_mjcf(path: Path, scratch: Path, fixed: bool) -> tuple[str, int]:
    """The robot of an MJCF file as one XML text of what is understood, and the bytes of all files
    that it is made of.

    Args:
        path: The file.
        scratch: Folder for copies of meshes that would name further files.
        fixed: Whether something takes the place of the joints of its first bodies.

    Raises InputError: as ``understood``; no MJCF, a file that is named and lies outside the folder
    of ``path``, or is no regular file of bounded size, includes in a ring, and more or deeper than
    ``MAX_ELEMENTS`` and ``MAX_DEPTH``.
    """
    expansion = _Expansion(path, scratch)
    root = expansion.expand(path, (), _Folders())
    level, depth = [root], 0
    while level:
        depth += 1
        if depth > MAX_DEPTH:
            raise InputError(f"{path} is nested more than {MAX_DEPTH} deep with what it includes")
        level = [child for element in level for child in element]
    found = understood(root, expansion.included, fixed)
    return ElementTree.tostring(found, encoding="unicode"), expansion.bytes


@dataclass(frozen=True)
class _Folders:
    """Where a file says that what it names lies."""

    mesh: str = ""
    texture: str = ""
    strip: bool = False
    """Whether folders in names are left out."""

    def within(self, root: Element) -> _Folders:
        """Folders of a file that is included here, or that begins here."""
        found = self
        for compiler in root.iter("compiler"):
            taken = {key: compiler.attrib.pop(key, None) for key in _SETTINGS}
            shared = taken["assetdir"]
            mesh = shared if taken["meshdir"] is None else taken["meshdir"]
            texture = shared if taken["texturedir"] is None else taken["texturedir"]
            strip = taken["strippath"]
            found = replace(
                found,
                mesh=found.mesh if mesh is None else mesh,
                texture=found.texture if texture is None else texture,
                strip=found.strip if strip is None else strip.lower() in ("true", "1"),
            )
        return found


_SETTINGS = ("assetdir", "meshdir", "texturedir", "strippath")


class _Expansion:
    """One robot that is put together."""

    def __init__(self, path: Path, scratch: Path) -> None:
        self._folder, self._path = path.parent, path
        self._scratch = scratch
        self._files = self._elements = 0
        self.bytes = 0
        """Bytes of all files that it is made of."""
        self.included: dict[Element, Path] = {}
        """The file of each element that an <include> stands for."""
        self._settled: dict[Path, str] = {}

    def expand(self, path: Path, above: tuple[Path, ...], outer: _Folders) -> Element:
        """The root of a file, with what it includes in place; ``above``: files that include it."""
        real = real_path(path)
        if real in above:
            raise InputError(f"{path} includes itself, by way of {len(above)} files")
        if len(above) >= MAX_DEPTH:
            raise InputError(f"{path} is included by more than {MAX_DEPTH} files in each other")
        self._files += 1
        self.bytes += require_regular_file(path, XML_LIMIT_BYTES, "an MJCF file").stat().st_size
        if self._files > MAX_FILES or self.bytes > XML_LIMIT_BYTES:
            raise InputError(
                f"{self._path} includes too much: up to {MAX_FILES:,} files and "
                f"{XML_LIMIT_BYTES >> 20} MiB are read"
            )
        root = read_xml(path, "an MJCF file")
        if root.tag not in _ROOTS[: 1 + bool(above)]:
            raise InputError(
                f"{path}: its root element is <{root.tag}>; an MJCF file's is <mujoco>"
            )
        folders = outer.within(root)
        at = path.parent.relative_to(self._folder).as_posix()
        for parent in list(root.iter()):
            children: list[Element] = []
            for child in parent:
                self._elements += 1
                if self._elements > MAX_ELEMENTS:
                    raise InputError(f"{self._path} has more than {MAX_ELEMENTS:,} elements")
                if child.tag == "include":
                    children += self._included(child, at, (*above, real), folders)
                else:
                    self._settle(child, at, folders)
                    children.append(child)
            parent[:] = children
        return root

    def _included(
        self, include: Element, at: str, above: tuple[Path, ...], folders: _Folders
    ) -> list[Element]:
        if not (name := include.get("file")):
            raise InputError(f"{self._path}: an <include> has no 'file'")
        # MuJoCo counts from the first file, newton from the one that includes.
        path = self._find(include, name, (at, ""))
        found = list(self.expand(path, above, folders))
        self.included |= {child: self.included.get(child, path) for child in found}
        return found

    def _find(self, element: Element, name: str, places: tuple[str, ...]) -> Path:
        """The first of the places, sub-folders, where the file is; the first one where none is."""
        missing, refusal = None, None
        for place in dict.fromkeys(places):
            try:
                path = named_path(self._folder, place, name)
            except InputError as error:
                refusal = InputError(f"<{element.tag}> names {shown(name)}: {error}")
                continue
            if path.exists():
                return path
            missing = missing or path
        if refusal is not None or missing is None:
            raise refusal or InputError(f"<{element.tag}> names no file")
        return missing

    def _settle(self, element: Element, at: str, folders: _Folders) -> None:
        """Make files of an element absolute paths, or leave them out where they are looks."""
        for key in [key for key in element.attrib if key.startswith("file")]:
            name = element.attrib.pop(key)
            if not name:
                continue
            if folders.strip:
                name = PurePosixPath(name.replace("\\", "/")).name
            own = folders.mesh if element.tag == _OPENED else folders.texture
            # The order of newton.
            path = self._find(element, name, (own, at, str(PurePosixPath(at, own))))
            if key == "file" and element.tag == _OPENED:
                element.set(key, self._opened(element, path))

    def _opened(self, element: Element, path: Path) -> str:
        """The path that newton gets. A file that is not there may be one that it does not need."""
        if path not in self._settled:
            self._settled[path] = str(path.absolute())
            if path.suffix.lower() not in _MESHES:
                raise InputError(
                    f"mesh {shown(path.name)} is of a kind that is not read; allowed are "
                    f"{', '.join(_MESHES)}"
                )
            if path.exists():
                what = f"what a <{element.tag}> names"
                self.bytes += require_regular_file(path, MAX_BYTES, what).stat().st_size
                if path.suffix.lower() == ".obj":
                    self._settled[path] = str(self._plain_obj(path))
        return self._settled[path]

    def _plain_obj(self, path: Path) -> Path:
        """A copy of an OBJ file without materials: these are further files, with images."""
        text = read_text(path, MAX_BYTES, "an OBJ file", latin_1=True)
        lines = text.replace("\r\n", "\n").replace("\\\n", " ").split("\n")
        kept = [
            line
            for line in lines
            # trimesh takes the name of materials wherever it finds the word, in other names too.
            if line.lstrip().startswith(_GEOMETRY) and "mtllib" not in line
        ]
        # newton calls a mesh without a name as its file.
        copy = self._scratch / str(len(self._settled)) / path.name
        copy.parent.mkdir()
        copy.write_text("\n".join(kept), encoding="utf-8")
        return copy
