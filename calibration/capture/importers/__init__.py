# SPDX-License-Identifier: Apache-2.0
"""Importers: captures in the layouts of other projects become capture folders."""

from __future__ import annotations

import importlib.util
import traceback
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.capture.importers import plain, published
from taccel_lab.calibration.capture.importers.draft import (
    CaptureLayout,
    Draft,
    ImportOptions,
    board_entry,
    require_lengths,
)
from taccel_lab.calibration.capture.importers.files import (
    UNKNOWN,
    capture_folders,
    files_of,
    images_in,
    label_numbers,
    press_rows,
    read_origin,
    stated_number,
)
from taccel_lab.calibration.capture.importers.label_tables import read_label_tables
from taccel_lab.calibration.capture.load import load_capture_folder
from taccel_lab.calibration.capture.schema import MANIFEST_NAME, manifest_notes
from taccel_lab.calibration.capture.split import HOLDOUT_EVERY
from taccel_lab.errors import InputError
from taccel_lab.files.foreign_images import WAY_OUT, unread_format, unread_pictures
from taccel_lab.files.inner_path import real_path, require_inner_links
from taccel_lab.files.output_folder import atomic_directory
from taccel_lab.guards import nearest

LAYOUTS = {
    # The most telling first: any folder of images is a plain one.
    layout.name: layout
    for layout in (
        CaptureLayout(
            "taxim", "Taxim: dataPack.npz and params.json",
            published.is_taxim, published.read_taxim,
        ),
        CaptureLayout(
            "9dtact", "9DTact: camera_calibration and depth_calibration of each unit",
            published.is_ninedtact, published.read_ninedtact,
        ),
        CaptureLayout(
            "gs-sdk", "gs_sdk: <ball>mm/<n>/gelsight.png with label.npz, or its examples",
            published.is_gs_sdk, published.read_gs_sdk,
        ),
        CaptureLayout(
            "printer", "printer_presses.csv of capture guide --printer, with its images",
            plain.is_printed, plain.read_printed,
        ),
        CaptureLayout(
            "markers", "a video, or numbered frames, of a gel with dots",
            plain.is_video_of_dots, plain.read_video,
        ),
        CaptureLayout("plain", "any folder of images", plain.has_images, plain.read_plain),
    )
}  # fmt: skip
AUTO = "auto"
SCRIPT_SUFFIX = ".py"
SCRIPTS = Path(__file__).with_name("layouts")
"""Where the layouts of further published sets are, as scripts."""
PUBLISHED = {
    "fots": ["mlp_calib/*"],
    "feats": ["force_indentation.json"],
    "py3dcal": ["probe_images/*"],
    "osaka": ["fisheye/cam*/*"],
    "rvsathu": ["calib_*_real.*"],
    "ruihangao": ["calib_ball/frame_*"],
    "gelslim": ["**/ref.*", "**/sample_*"],
    "cube-edges": ["*/label.npz"],
}
"""Their names, and what a folder has that follows one."""

__all__ = [
    "AUTO",
    "LAYOUTS",
    "CaptureLayout",
    "Draft",
    "ImportOptions",
    "Imported",
    "board_entry",
    "detect_layout",
    "images_in",
    "import_captures",
    "import_folders",
    "label_numbers",
    "press_rows",
    "read_drafts",
    "read_label_tables",
    "stated_number",
]
"""Scripts of layouts use what reads files here, too."""


def detect_layout(source: Path | str) -> CaptureLayout:
    """The layout that ``source`` follows.

    Raises:
        InputError: None of them, or a published one, which many folders look like; the message
            names it, or all.
    """
    source = _own_files_alone(Path(source))
    for layout in LAYOUTS.values():
        if layout.name in ("markers", "plain"):
            for name, signs in PUBLISHED.items():
                # Of one file its name tells alone: what lies beside it is not imported.
                if (
                    all(next(source.glob(sign), None) for sign in signs)
                    if source.is_dir()
                    else signs == [source.name]
                ):
                    raise InputError(
                        f"{source} has {' and '.join(signs)}, as the published set {name}: add "
                        f"--layout {name}, or --layout plain where all images are of one ball"
                    )
        if layout.recognises(source):
            return layout
    known = "; ".join(f"{layout.name} ({layout.title})" for layout in LAYOUTS.values())
    if other := unread_pictures([source] if source.is_file() else files_of(source)):
        raise InputError(f"{source} holds no image that can be read{other}")
    raise InputError(
        f"{source} follows none of the layouts known: {known}; docs/capture_import.md shows how a "
        "script of 20 lines reads one of your own"
    )


def named_layout(name: str) -> CaptureLayout:
    """The layout of that name, or that of a script, ``mine.py``.

    Raises InputError for another name, and for a script without ``read``.
    """
    if name.endswith(SCRIPT_SUFFIX):
        return script_layout(Path(name))
    if name in PUBLISHED:
        return script_layout(SCRIPTS / f"{name}{SCRIPT_SUFFIX}")
    known = (*LAYOUTS, *PUBLISHED)
    if name not in known:
        raise InputError(
            f"no layout {name!r}{nearest(name, known)}; known: {AUTO}, {', '.join(known)}, or a "
            f"script, which ends in {SCRIPT_SUFFIX}"
        )
    return LAYOUTS[name]


def script_layout(path: Path) -> CaptureLayout:
    """The layout whose ``read(source, options)`` a Python file defines, as ``CaptureLayout`` has
    it; its docstring begins with the title. The file is run.

    Raises InputError where there is no such file or function.
    """
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if not path.is_file() or spec is None or spec.loader is None:
        raise InputError(f"{path} does not exist; a layout's script is needed")
    script = importlib.util.module_from_spec(spec)
    with _naming_lines_of(path):
        spec.loader.exec_module(script)
    if not callable(getattr(script, "read", None)):
        raise InputError(f"{path} defines no read(source, options), which returns drafts")

    def read(source: Path, options: ImportOptions) -> list[Draft]:
        with _naming_lines_of(path):
            drafts = list(script.read(source, options))
        if not all(isinstance(draft, Draft) for draft in drafts):
            raise InputError(f"{path}: read(source, options) returns a list of Draft alone")
        return drafts

    title = (script.__doc__ or "a layout of your own").strip().splitlines()[0]
    return CaptureLayout(path.stem, title, lambda source: True, read)


@contextmanager
def _naming_lines_of(path: Path) -> Iterator[None]:
    """Turn what goes wrong in a script into an InputError with its line."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        lines = [frame.lineno for frame in frames if frame.filename == str(path)]
        at = f", line {lines[-1]}" if lines else ""
        raise InputError(f"{path}{at}: {type(error).__name__}: {error}") from error


def read_drafts(
    source: Path | str, layout: str = AUTO, options: ImportOptions | None = None
) -> tuple[CaptureLayout, list[Draft]]:
    """What ``source`` holds, one draft for each sensor or set, with the options applied.

    Raises:
        InputError: Unknown or wrong layout, a length that no captures have, or a file that cannot
            be used.
    """
    source, options = _own_files_alone(Path(source)), options or ImportOptions()
    require_lengths(
        radius_mm=options.radius_mm,
        mm_per_px_x=options.mm_per_px_x,
        mm_per_px_y=options.mm_per_px_y,
        edge_mm=options.edge_mm,
    )
    chosen = detect_layout(source) if layout == AUTO else named_layout(layout)
    drafts = chosen.read(source, options)
    if not drafts:
        raise InputError(f"{source} is not of the layout {chosen.name}: {chosen.title}")
    require_effect(options, drafts, source, chosen.name)
    origin = read_origin(source)
    _part_ways(drafts)
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


def _part_ways(drafts: list[Draft]) -> None:
    """Number parts of one name, each of which becomes a folder."""
    seen: Counter[str] = Counter()
    for draft in drafts:
        seen[draft.part] += 1
        if seen[draft.part] > 1:
            draft.part += f"_{seen[draft.part]}"


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
            foreign = unread_format(path)
            why = "part of a capture folder" if other else f"no capture of the layout {layout}"
            if foreign is not None:
                why = f"an image of the format {foreign}, which is not read. {WAY_OUT}"
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
    *,
    replace: bool = False,
) -> list[Path]:
    """Write ``source`` as capture folders of version 2; returns their paths.

    Images keep their bytes, and the manifest says which presses are held out. A source of several
    sensors or sets becomes one folder each below ``out``. Every folder is loaded once, so that what
    is written can be used.

    Raises:
        InputError: Something in ``source`` cannot be used, or ``out`` holds foreign files, or
            captures where ``replace`` is not set.
    """
    found = import_folders(source, out, layout, options, replace=replace)
    return [written.path for written in found]


def import_folders(
    source: Path | str,
    out: Path | str,
    layout: str = AUTO,
    options: ImportOptions | None = None,
    *,
    replace: bool = False,
) -> list[Imported]:
    """Writes capture folders as ``import_captures`` does; says what each folder holds."""
    source, out = Path(source), Path(out)
    if (source / MANIFEST_NAME).is_file():
        raise InputError(f"{source} is a capture folder already: it has {MANIFEST_NAME}")
    _, drafts = read_drafts(source, layout, options)
    written = []
    with atomic_directory(out, captures=replace) as staging:
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
            notes = manifest_notes(folder / MANIFEST_NAME)
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
