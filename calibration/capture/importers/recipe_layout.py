# SPDX-License-Identifier: Apache-2.0
"""A recipe at work: recognised in a source, and read into drafts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from taccel_lab.calibration.capture.importers.background_guess import BACKGROUND_NAME
from taccel_lab.calibration.capture.importers.board_text import board_entry
from taccel_lab.calibration.capture.importers.draft import Draft, ImportOptions
from taccel_lab.calibration.capture.importers.files import images_in
from taccel_lab.calibration.capture.importers.label_tables import LabelTables, read_label_tables
from taccel_lab.calibration.capture.importers.layout import FALLBACK_SENSOR, CaptureLayout
from taccel_lab.calibration.capture.importers.left_out import capture_folders
from taccel_lab.calibration.capture.importers.path_pattern import filled, find
from taccel_lab.calibration.capture.importers.recipe import ANY_FOLDER, Recipe, Set
from taccel_lab.calibration.capture.importers.recipe_images import (
    Found,
    ImagePlace,
    any_images,
    images_of,
    named,
)
from taccel_lab.calibration.capture.importers.recipe_values import (
    RecipeSettings,
    renamed_table,
    set_values,
)
from taccel_lab.errors import InputError
from taccel_lab.files.images import read_image
from taccel_lab.files.inner_path import real_path
from taccel_lab.files.regular_file import file_sha256
from taccel_lab.sensors.registry import known_sensor

RECIPES = Path(__file__).with_name("recipes")
"""Those of published layouts."""
_CIRCLE = ("u_px", "v_px", "radius_px")
_LINE = ("u_px", "v_px", "length_px", "angle_deg")


def recipe_layout(path: Path) -> CaptureLayout:
    """The layout of a recipe's file; InputError names the file and each wrong key."""
    recipe = Recipe.read(path)

    def read(source: Path, options: ImportOptions) -> list[Draft]:
        for name in {of.sensor for of in recipe.sets if of.sensor is not None}:
            if known_sensor(name) is None:
                raise InputError(f"{path}: no sensor {name!r}; taccel-lab sensors list has those")
        return _read(recipe, path.stem, source, options)

    return CaptureLayout(
        path.stem, recipe.title, lambda source: bool(_places(recipe, source)), read
    )


@dataclass(frozen=True)
class _SetAt(ImagePlace):
    """A set of the recipe, looked for in a folder."""

    of: Set
    source: Path
    name: str
    """Of the folder that sets it apart from others."""

    def is_there(self, with_background: bool) -> bool:
        """Whether any of its captures is."""
        of = self.of
        if with_background and of.place == ANY_FOLDER and not self.images(of.background):
            return False
        return bool(
            (of.presses and any_images(self, of.presses, of.presses.circle))
            or (of.edges and any_images(self, of.edges, of.edges.line))
            or (of.boards and self.images(of.boards.files))
            or (of.markers and self.images(of.markers.frames))
            or (of.record and self.files(of.record.file or of.settings))
        )


def _places(recipe: Recipe, source: Path, with_background: bool = True) -> list[_SetAt]:
    return [
        place
        for of in recipe.sets
        for place in _candidates(of, source)
        if place.is_there(with_background)
    ]


def _candidates(of: Set, source: Path) -> Iterator[_SetAt]:
    if source.is_file():
        # A record may be named by its own file.
        if of.record is not None and source.name in (of.record.file or of.settings or ()):
            yield _SetAt(source.parent, {}, of, source, source.stem)
        return
    folder = source / of.place
    if of.place == ANY_FOLDER:
        written = capture_folders(source)
        below = sorted(path for path in source.rglob("*") if path.is_dir())
        for place in (source, *(path for path in below if path not in written)):
            yield _SetAt(place, {}, of, source, place.name)
        return
    if not folder.is_dir() and source.name == Path(of.place).name:
        folder = source
    if of.each is None:
        yield _SetAt(folder, {}, of, source, folder.name)
    else:
        for match in find(folder, of.each, {}, Path.is_dir):
            yield _SetAt(folder, match.fields, of, source, match.path.name)


def _read(recipe: Recipe, name: str, source: Path, options: ImportOptions) -> list[Draft]:
    places = _places(recipe, source) or _places(recipe, source, with_background=False)
    why = f"that of {recipe.published or f'the recipe {name}'}"
    presses = [list(images_of(p, p.of.presses)) if p.of.presses else [] for p in places]
    tables: dict[Path, LabelTables] = {}
    drafts = []
    for place, found in zip(places, presses, strict=True):
        # Tables of a folder are about the presses of all sets there.
        here = [press.image for other, pressed in zip(places, presses, strict=True)
                for press in pressed if other.folder == place.folder]  # fmt: skip
        first = place.folder not in tables
        if here and first:
            tables[place.folder] = read_label_tables(place.folder)
        labels = tables.get(place.folder)
        part = place.of.part or (place.name if len(places) > 1 else "")
        taken = sum(draft.part.startswith(part) for draft in drafts) if part else 0
        part += f"_{taken + 1}" if any(draft.part == part for draft in drafts) else ""
        draft = Draft(part, FALLBACK_SENSOR, place.folder)
        circles = labels.of_images(here) if labels is not None else {}
        _fill(draft, place, found, circles, options, why)
        if labels is not None and first:
            labels.tell(draft, here)
        draft.source = recipe.source or draft.source
        draft.license = recipe.license or draft.license
        drafts.append(draft)
    return drafts


def _fill(
    draft: Draft,
    place: _SetAt,
    presses: list[Found],
    circles: dict[Path, dict[str, float]],
    options: ImportOptions,
    why: str,
) -> None:
    """Take in what the set has."""
    of = place.of
    _set_sensor(draft, place, why)
    if of.unit is not None:
        draft.manifest["unit"] = filled(of.unit, place.fields)
    _take_boards(draft, place, options, why)
    background = _take_background(draft, place, options)
    settings = RecipeSettings(place, of, draft)
    radius = set_values(draft, place, of, settings, options, why)
    draft.notes += of.notes
    _take_presses(draft, place, [p for p in presses if p.image != background], circles)
    _take_edges(draft, place, options)
    _take_markers(draft, place, why)
    _take_record(draft, place, settings, radius)
    for pattern, reason in of.leave_out.items():
        for path in place.files([pattern]):
            if path not in draft.used:
                draft.leave_out(path, reason)
    for further in (of.presses and of.presses.table, of.settings):
        for path in place.files(further)[1:]:
            if path not in draft.used:
                draft.leave_out(path, f"{place.files(further)[0].name} is read instead")


def _set_sensor(draft: Draft, place: _SetAt, why: str) -> None:
    of = place.of
    path = "/".join(real_path(place.source).parts[-3:]).lower()
    named = next((name for name in of.sensors_in_path if name in path), None)
    draft.sensor = named or of.sensor or FALLBACK_SENSOR
    reason = "by the folder's path" if named else of.why.get("sensor", why)
    if draft.sensor == FALLBACK_SENSOR:
        reason = "which stands for any flat gel; --sensor names another"
    draft.assume("sensor", f"{draft.sensor}, {reason}")


def _take_background(draft: Draft, place: _SetAt, options: ImportOptions) -> Path | None:
    of = place.of
    found = place.images(of.background)
    if of.background is not None and not found:
        found = [path for path in images_in(place.folder) if BACKGROUND_NAME.search(path.stem)]
    if found:
        inner = found[0].relative_to(place.folder)
        draft.set_background(found[0], f"{inner}, {of.why.get('background', 'by its name')}")
        for image in place.images(of.untouched):
            if image != found[0]:
                _add_untouched(draft, found[0], image)
    elif of.background is not None and options.background is None:
        missing = filled(of.background[0], place.fields).replace("*", "png")
        draft.notes.append(
            f"no background: {missing} is missing; give one with "
            "--background, or --background median for that of the presses"
        )
    for mask in place.images(of.mask)[:1]:
        draft.manifest["mask"] = draft.add_image(mask, "mask")
    return found[0] if found else None


def _add_untouched(draft: Draft, background: Path, image: Path) -> None:
    """A further background, unless it is the same image again."""
    if file_sha256(background) == file_sha256(image):
        draft.leave_out(image, "the same image as the background")
    elif read_image(background).shape != read_image(image).shape:
        draft.leave_out(image, "not of the background's size")
    else:
        name = draft.add_image(image, "untouched")
        draft.manifest.setdefault("untouched", []).append(name)


def _take_presses(
    draft: Draft, place: _SetAt, presses: list[Found], circles: dict[Path, dict[str, float]]
) -> None:
    of = place.of.presses
    if of is None:
        return
    for press in presses:
        diameter = press.first(of.diameter_mm)
        stage = press.together(of.stage_mm, ("x", "y"))
        draft.add_press(
            press.image,
            press.name,
            contact=press.together(of.circle, _CIRCLE) or circles.get(press.image),
            depth_mm=press.first(of.depth_mm),
            force_n=press.first(of.force_n),
            stage_mm=None if stage is None else list(stage.values()),
            radius_mm=press.first(of.radius_mm) if diameter is None else diameter / 2,
        )
        if press.said_by != press.image:
            draft.used.add(press.said_by)
    for key in ("circle", "depth_mm", "force_n", "stage_mm", "radius_mm", "diameter_mm"):
        words = getattr(of, key)
        if words and presses and not any(p.numbers(w) for p in presses for w in words):
            draft.notes.append(f"no press has its {key}: nothing is called {' or '.join(words)}")
    if "presses" in place.of.why and len(of.files or ()) > 1:
        if any(place.images([pattern]) for pattern in (of.files or ())[1:]):
            draft.assume("presses", place.of.why["presses"])


def _take_edges(draft: Draft, place: _SetAt, options: ImportOptions) -> None:
    of = place.of.edges
    if of is None:
        return
    length = options.edge_mm
    if length is None:
        length = of.length_mm
        draft.assume(
            "edge_mm", f"{length:g} mm, that of the published cube; --edge-mm gives another"
        )
    edges = draft.manifest.setdefault("edges", [])
    for edge in images_of(place, of):
        entry = {
            "image": draft.add_image(edge.image, edge.name),
            "length_mm": float(length),
        }
        line = edge.together(of.line, _LINE)
        edges.append(entry | ({} if line is None else {"line": line}))
        if edge.said_by != edge.image:
            draft.used.add(edge.said_by)


def _take_boards(draft: Draft, place: _SetAt, options: ImportOptions, why: str) -> None:
    of = place.of.boards
    if of is None:
        return
    names = [
        draft.add_image(match.path, named(of.name, match.fields, match.path))
        for match in place.matches(of.files, images=True)
    ]
    if not names:
        return
    entry = board_entry(options.board or of.board)
    if options.board is None:
        unknown = "" if "pitch_mm" in entry else "; its pitch is unknown"
        draft.assume("board", f"{of.board}, {place.of.why.get('board', why)}{unknown}")
    on_gel = {"on_gel": True} if of.on_gel else {}
    draft.manifest["boards"] = [entry | on_gel | {"images": names}]


def _take_markers(draft: Draft, place: _SetAt, why: str) -> None:
    of = place.of.markers
    frames = place.images(of.frames) if of is not None else []
    if of is None or not frames:
        return
    markers = draft.manifest.setdefault("markers", {})
    if of.labels is not None:
        # The table has the dots of the first frame: places without load, and the way from there.
        markers["labels_image"] = draft.add_image(frames[0], "labelled")
        stem = {**place.fields, "stem": frames[0].stem}
        for table in ImagePlace(place.folder, stem).files([of.labels])[:1]:
            draft.files["marker_labels.csv"] = renamed_table(table, of.columns)
            markers["labels"] = "marker_labels.csv"
            draft.used.add(table)
            draft.assume(
                "labels",
                f"{table.name} has the places of the dots without load and the way from there to "
                f"where {frames[0].name} shows them, {place.of.why.get('labels', why)}",
            )
    if len(frames) > 1:
        names = [draft.add_image(frame, f"frame_{frame.stem}") for frame in frames]
        markers["videos"] = [{"frames": names}]
    elif "labels" in markers:
        draft.notes.append(
            "the only frame is a press: its dots have moved by what marker_labels.csv says, and "
            "there is no picture of the gel at rest, so that calibrate markers refuses; give one "
            "as markers.rest"
        )


def _take_record(
    draft: Draft, place: _SetAt, settings: RecipeSettings, radius: float | None
) -> None:
    of = place.of.record
    if of is None:
        return
    for table in place.files(of.file)[:1]:
        name = draft.add_text(renamed_table(table, of.columns), f"{table.stem}.csv")
        draft.used.add(table)
        break
    else:
        if of.lists is None or settings.path is None:
            return
        name = draft.add_text(settings.lists(of.lists), f"{settings.path.stem}.csv")
    tool = {} if radius is None else {"tool": {"kind": "sphere", "radius_mm": radius}}
    draft.manifest.setdefault("records", []).append({"file": name, "kind": of.kind, **tool})
