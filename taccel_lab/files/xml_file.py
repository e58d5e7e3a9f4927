# SPDX-License-Identifier: Apache-2.0
"""XML files, without their own entities: those can name other files, and grow."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

from taccel_lab.errors import InputError
from taccel_lab.files.regular_file import read_text

XML_LIMIT_BYTES = 16 << 20
"""The largest robot description at hand has 0.2 MiB."""
MAX_DEPTH = 100
"""A robot description has six levels."""
MAX_ELEMENTS = 500_000
"""Each takes some 200 bytes for four of a file; a mesh of 100,000 polygons has as many."""


def read_xml(path: Path, what: str) -> ElementTree.Element:
    """The root element of an XML file.

    Args:
        path: The file.
        what: What it should be, with its article: "a URDF file".

    Raises InputError with the path: no file, too large, no text, no XML, nested deeper than
    ``MAX_DEPTH``, of more than ``MAX_ELEMENTS``, or with a document type, which may define
    entities.
    """
    text = read_text(path, XML_LIMIT_BYTES, what)
    if "<!DOCTYPE" in text:
        raise InputError(f"{path} has a document type (<!DOCTYPE>), which is not read: remove it")
    parser = ElementTree.XMLParser(target=_ShallowTree(path))
    try:
        # As text: what the file says of its encoding no longer matters.
        parser.feed(text)
        return parser.close()
    except ElementTree.ParseError as error:
        raise InputError(f"{path} is not valid XML: {error}") from None


class _ShallowTree(ElementTree.TreeBuilder):
    """Builds the tree, unless it is vast, or deep: elements are freed by recursion."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._path, self._depth, self._count = path, 0, 0

    def start(self, tag: str, attrs: dict[str, str], /) -> ElementTree.Element:
        self._depth += 1
        self._count += 1
        if self._depth > MAX_DEPTH:
            raise InputError(f"{self._path} is nested more than {MAX_DEPTH} deep")
        if self._count > MAX_ELEMENTS:
            raise InputError(f"{self._path} has more than {MAX_ELEMENTS:,} elements")
        return super().start(tag, attrs)

    def end(self, tag: str, /) -> ElementTree.Element:
        self._depth -= 1
        return super().end(tag)
