# SPDX-License-Identifier: Apache-2.0
"""Importers: captures in the layouts of other projects become capture folders."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.capture.importers import markers, ninedtact, plain, taxim
from taccel_lab.calibration.capture.importers.draft import Draft, ImportOptions
from taccel_lab.calibration.capture.importers.layout import CaptureLayout
from taccel_lab.calibration.capture.importers.left_out import capture_folders, files_of
from taccel_lab.calibration.capture.importers.origin import UNKNOWN, read_origin
from taccel_lab.calibration.capture.importers.recipe_layout import RECIPES, recipe_layout
from taccel_lab.calibration.capture.load import load_capture_folder
from taccel_lab.calibration.capture.schema import MANIFEST_NAME
from taccel_lab.calibration.capture.split import HOLDOUT_EVERY
from taccel_lab.errors import InputError
from taccel_lab.files.inner_path import real_path, require_inner_links
from taccel_lab.files.output_folder import atomic_directory

LAYOUTS: dict[str, CaptureLayout] = {
    layout.name: layout
    # The most telling first: any folder of images is a plain one.
    for layout in (
        *(part.LAYOUT for part in (taxim, ninedtact)),
        *(recipe_layout(path) for path in sorted(RECIPES.glob("*.toml"))),
        *(part.LAYOUT for part in (markers, plain)),
    )
}
AUTO = "auto"
RECIPE_SUFFIX = ".toml"

__all__ = [
    "AUTO",
    "LAYOUTS",
    "CaptureLayout",
    "Draft",
    "ImportOptions",
    "Imported",
    "detect_layout",
    "import_captures",
    "import_folders",
    "read_drafts",
]


def detect_layout(source: Path | str) -> CaptureLayout:
    """The layout that ``source`` follows.

    Raises:
        InputError: None of them; the message names all.
    """
    source = _own_files_alone(Path(source))
    for layout in LAYOUTS.values():
        if layout.recognises(source):
            return layout
    known = "; ".join(f"{layout.name} ({layout.title})" for layout in LAYOUTS.values())
    raise InputError(f"{source} follows none of the layouts known: {known}")


def named_layout(name: str) -> CaptureLayout:
    """The layout of that name, or that of a recipe's file, ``mine.toml``.

    Raises InputError for another name, and for a recipe with a fault.
    """
    if name.endswith(RECIPE_SUFFIX):
        return recipe_layout(Path(name))
    if name not in LAYOUTS:
        raise InputError(
            f"no layout {name!r}; known: {AUTO}, {', '.join(LAYOUTS)}, or the file of a recipe, "
            f"which ends in {RECIPE_SUFFIX}"
        )
    return LAYOUTS[name]


def read_drafts(
    source: Path | str, layout: str = AUTO, options: ImportOptions | None = None
) -> tuple[CaptureLayout, list[Draft]]:
    """What ``source`` holds, one draft for each sensor or set, with the options applied.

    Raises:
        InputError: Unknown or wrong layout, or a file that cannot be used.
    """
    source, options = _own_files_alone(Path(source)), options or ImportOptions()
    chosen = detect_layout(source) if layout == AUTO else named_layout(layout)
    drafts = chosen.read(source, options)
    if not drafts:
        raise InputError(f"{source} is not of the layout {chosen.name}: {chosen.title}")
    require_effect(options, drafts, source, chosen.name)
    origin = read_origin(source)
    for draft in drafts:
        draft.apply(options, source if source.is_dir() else source.parent)
        of = f"imported from {real_path(source).name}, layout {chosen.name}" + (
            f", part {draft.part}" if draft.part else ""
        )
        draft.root = source
        known = draft.source if draft.source != UNKNOWN else origin.source
        draft.source = f"{options.origin or known}; {of}"
        known = draft.license if draft.license != UNKNOWN else origin.license
        draft.license = options.license or known
        draft.used |= origin.files
    _leave_out_the_rest(source, drafts, chosen.name)
    return chosen, drafts


def _own_files_alone(source: Path) -> Path:
    """``source``, which is there and from which no link leads out: what such a one names would be
    read, and copied into a folder for others."""
    if not source.exists():
        raise InputError(f"{source} does not exist")
    if source.is_dir():
        require_inner_links(source)
    return source


def require_effect(options: ImportOptions, drafts: list[Draft], source: Path, layout: str) -> None:
    """Refuse options that nothing in the source is changed by."""
    for option, key in (("edge_mm", "edges"), ("board", "boards")):
        given = getattr(options, option) is not None
        if given and not any(key in draft.manifest for draft in drafts):
            raise InputError(
                f"--{option.replace('_', '-')} was given, but {source}, read as {layout}, has no "
                f"{key}; leave it away"
            )


def _leave_out_the_rest(source: Path, drafts: list[Draft], layout: str) -> None:
    """Say of every file of the source that no draft mentions that it is not imported."""
    mentioned = {real_path(path) for d in drafts for path in (*d.used, *d.left_out)}
    written = capture_folders(source)
    for path in files_of(source):
        if real_path(path) not in mentioned:
            other = not written.isdisjoint(path.parents)
            why = "part of a capture folder" if other else f"no capture of the layout {layout}"
            drafts[0].leave_out(path, why)


@dataclass(frozen=True)
class Imported:
    """A capture folder that was written."""

    path: Path
    contents: dict[str, int]
    """How many there are of each kind of capture."""
    assumed: dict[str, str]
    """What no file of the source states, and why it was taken."""
    provenance: dict[str, str]
    notes: tuple[str, ...]
    """Lines at the head of its manifest: among others what was left out, and why."""


def import_captures(
    source: Path | str,
    out: Path | str,
    layout: str = AUTO,
    options: ImportOptions | None = None,
) -> list[Path]:
    """Write ``source`` as capture folders of version 2; returns their paths.

    Images keep their bytes, and the manifest says which presses are held out. A source of several
    sensors or sets becomes one folder each below ``out``. Every folder is loaded once, so that what
    is written can be used.

    Raises:
        InputError: Something in ``source`` cannot be used, or ``out`` holds foreign files.
    """
    return [written.path for written in import_folders(source, out, layout, options)]


def import_folders(
    source: Path | str,
    out: Path | str,
    layout: str = AUTO,
    options: ImportOptions | None = None,
) -> list[Imported]:
    """As ``import_captures``; says what each folder holds."""
    source, out = Path(source), Path(out)
    if (source / MANIFEST_NAME).is_file():
        raise InputError(f"{source} is a capture folder already: it has {MANIFEST_NAME}")
    _, drafts = read_drafts(source, layout, options)
    written = []
    with atomic_directory(out) as staging:
        for draft in drafts:
            folder = staging / draft.part
            folder.mkdir(exist_ok=True)
            draft.write(folder)
            try:
                captures = load_capture_folder(folder)
                freeze_split(captures, folder / MANIFEST_NAME)
            except InputError as error:
                text = str(error).replace(str(folder), str(source))
                raise InputError(f"{text} (imported from {draft.place})") from error
            lines = (folder / MANIFEST_NAME).read_text(encoding="utf-8").splitlines()
            notes = tuple(line[2:] for line in lines if line.startswith("# "))
            # Nothing may fail of the folder once it stands: what is said of it is read before.
            written_facts = captures.contents(), captures.assumed, captures.provenance, notes
            written.append(Imported(out / draft.part, *written_facts))
    return written


def freeze_split(captures: CaptureFolder, manifest: Path) -> None:
    """Write into ``manifest`` which presses are held out, so that no later change moves them."""
    import tomli_w

    if captures.heldout is not None or len(captures.presses) < HOLDOUT_EVERY:
        return
    names = list(captures.split().heldout_names)
    text = manifest.read_text(encoding="utf-8")
    manifest.write_text(text + "\n" + tomli_w.dumps({"split": {"heldout": names}}), "utf-8")
