# SPDX-License-Identifier: Apache-2.0
"""A recipe: how a project stores captures, as data. ``docs/capture_import.md`` explains its keys.

Paths are patterns with named fields (``path_pattern.py``). What a recipe states in numbers is
marked as assumed, with the reason: no file of the source says so.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, model_validator

from taccel_lab.calibration.capture.importers.path_pattern import (
    Pattern,
    Patterns,
    one_or_several,
)
from taccel_lab.calibration.capture.schema import MAX_MM_PER_PX, MAX_RADIUS_MM, MIN_RADIUS_MM
from taccel_lab.files.inner_path import require_inner_name
from taccel_lab.files.strict_model import Flag, Number, StrictModel

ANY_FOLDER = "**"
Text = Annotated[str, Field(min_length=1, max_length=1000)]
Name = Annotated[str, Field(pattern=r"^[\w{}. -]{1,80}$")]
Sensor = Annotated[str, Field(pattern=r"^[a-z0-9_]{1,80}$")]
Folder = Annotated[str, Field(min_length=1), BeforeValidator(require_inner_name)]
Words = Annotated[list[Text], one_or_several, Field(min_length=1, max_length=20)]
"""Names under which a value stands: fields of the path, columns of the table, or arrays."""


class Setting(StrictModel):
    """A number of the set's file of settings."""

    key: Text
    """Its dotted key."""
    text: Text | None = None
    """How the text there has the number as ``{value}``: ``*radius {value} mm*``."""


Radius = Annotated[Number, Field(gt=MIN_RADIUS_MM, le=MAX_RADIUS_MM)]
Scale = Annotated[Number, Field(gt=0.0, le=1e4)]


class ImageRecipe(StrictModel):
    """Files; or rows of a table with the names of images; or an archive beside each image."""

    files: Patterns | None = None
    table: Patterns | None = None
    """A CSV with one row an image, the first that there is."""
    folder: Folder = "."
    """Where the table's images lie."""
    image: Text | None = None
    """The table's column with their names."""
    arrays: Pattern | None = None
    """A ``.npz`` for each image; ``files`` says where its image is, the first that there is."""
    name: Name = "{stem}"
    """Names in the capture folder, of fields and the image's ``{stem}``."""

    @model_validator(mode="after")
    def _one_way(self) -> ImageRecipe:
        if (self.files is None) == (self.table is None):
            raise ValueError("files or a table are needed, not both")
        if (self.table is None) != (self.image is None):
            raise ValueError("a table and image, its column with their names, go together")
        if self.table is not None and self.arrays is not None:
            raise ValueError("arrays belong to files; there is a table")
        return self


class Presses(ImageRecipe):
    """Presses of a ball, and where what is known of each stands."""

    circle: Words | None = None
    """Column, row and radius of the contact [px], three numbers in all."""
    depth_mm: Words | None = None
    """Travel past first touch: the first of these words that there is."""
    force_n: Words | None = None
    stage_mm: Words | None = None
    """Where a stage pressed, two numbers in all, in its own axes."""
    radius_mm: Words | None = None
    """The ball's, press by press."""
    diameter_mm: Words | None = None


class Edges(ImageRecipe):
    """Presses of a straight edge."""

    length_mm: Number
    line: Words | None = None
    """Column and row of its middle, length [px] and angle [degrees], four numbers in all."""


class Boards(StrictModel):
    """Views of a calibration board."""

    files: Patterns
    name: Name = "{stem}"
    board: Text
    """As ``--board`` has it."""
    on_gel: Flag = False


class Record(StrictModel):
    """A record of forces on the set's ball: a CSV, or lists in the settings."""

    kind: Literal["indentation"]
    file: Patterns | None = None
    columns: dict[Text, Text] = Field(default_factory=dict)
    """What the CSV's columns are called here, by their names there."""
    lists: dict[Text, Text] | None = None
    """Dotted keys of the settings, by the column that each becomes."""


class MarkerRecipe(StrictModel):
    """Frames of dots on the gel."""

    frames: Patterns
    labels: Pattern | None = None
    """A CSV: places of dots without load, and the way to where the first frame (``{stem}``) has
    them."""
    columns: dict[Text, Text] = Field(default_factory=dict)


class Set(StrictModel):
    """One sensor or set; it is there where any of its captures is."""

    part: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,99}$")] | None = None
    """Folder below the target. Default: that which sets it apart where there are several,."""
    place: Literal["**"] | Folder = "."
    """Where patterns begin: a folder of the source, or the source itself if it is called so;
    ``**``: each folder with presses and a background, or with presses where none has both."""
    each: Pattern | None = None
    """A folder a set, whose fields stand for their text in all other patterns."""
    sensor: Sensor | None = None
    """Of the catalogue. Default: any flat gel."""
    sensors_in_path: list[Sensor] = Field(default_factory=list)
    """Others, that it is where the source's path says so."""
    unit: Text | None = None
    """This very sensor's name, of fields."""
    background: Patterns | None = None
    untouched: Patterns | None = None
    mask: Patterns | None = None
    settings: Patterns | None = None
    """A JSON or YAML file with numbers."""
    radius_mm: Radius | Setting | None = None
    diameter_mm: Scale | Setting | None = None
    mm_per_px: Annotated[Scale, Field(le=MAX_MM_PER_PX)] | Setting | None = None
    px_per_mm: Scale | Setting | None = None
    presses: Annotated[
        Presses | None,
        BeforeValidator(lambda v: {"files": v} if isinstance(v, (str, list)) else v),
    ] = None
    edges: Edges | None = None
    boards: Boards | None = None
    record: Record | None = None
    markers: MarkerRecipe | None = None
    leave_out: dict[Pattern, Text] = Field(default_factory=dict, max_length=20)
    """Files that are known and not taken in, with the reason."""
    notes: list[Text] = Field(default_factory=list)
    why: dict[Text, Text] = Field(default_factory=dict)
    """Reasons for what is assumed, by its name, where ``published`` is not it."""

    @model_validator(mode="after")
    def _whole(self) -> Set:
        kinds = (self.presses, self.edges, self.boards, self.record, self.markers)
        if all(kind is None for kind in kinds):
            raise ValueError("presses, edges, boards, a record or markers are needed")
        for one, other in (("radius_mm", "diameter_mm"), ("mm_per_px", "px_per_mm")):
            if getattr(self, one) is not None and getattr(self, other) is not None:
                raise ValueError(f"{one} or {other}; one is enough")
        if self.record is not None and (self.record.file is None) == (self.record.lists is None):
            raise ValueError("a record has a file, or lists; one is needed")
        lists = self.record is not None and self.record.lists is not None
        kinds = (self.radius_mm, self.diameter_mm, self.mm_per_px, self.px_per_mm)
        if self.settings is None and (lists or any(isinstance(k, Setting) for k in kinds)):
            raise ValueError("keys and lists stand in the file settings; name it")
        return self


class Recipe(StrictModel):
    """Contents of a recipe's file."""

    title: Text = "a recipe of your own"
    """One line: whose layout, and what tells it."""
    published: Text | None = None
    """Where what it states is from."""
    source: Text | None = None
    """Where all captures of this layout come from, when they do."""
    license: Text | None = None
    sets: list[Set] = Field(min_length=1, max_length=50)
