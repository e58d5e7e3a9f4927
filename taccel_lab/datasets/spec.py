# SPDX-License-Identifier: Apache-2.0
"""The file of a data set: sensors, objects, motions, what varies and what is kept, from TOML.

Only the form is checked here; ``taccel_lab.datasets.plan`` checks files, sensors and depths.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, StrictStr, field_validator, model_validator

from taccel_lab.files.documents import first_repeated
from taccel_lab.files.strict_model import Number, StrictModel, Whole
from taccel_lab.profile.schema import Name
from taccel_lab.signals.frame_faults import FrameFaults

MAX_EPISODES = 10_000_000
MAX_STEPS = 1000
"""Steps of a touch; one takes a second and more of a core."""
FAULT_CHANNELS = ("faults", "fault_values")
"""Labels of faulty frames."""
DEFAULT_CHANNELS = ("rgb", "depth_mm", "contact_mask", "markers_px", "patch_forces_n")
Range = tuple[Number, Number]
"""Drawn evenly between both; equal ends hold it."""
Weight = Annotated[Number, Field(gt=0, le=1e6)]
Share = Annotated[Number, Field(ge=0, le=1)]
Split = Literal["train", "test"]


def _check_range(ends: Range | None) -> Range | None:
    if ends is not None and ends[0] > ends[1]:
        raise ValueError(f"[{ends[0]:g}, {ends[1]:g}] has its ends the wrong way round")
    return ends


class DatasetBlock(StrictModel):
    """What is made."""

    name: Name
    episodes: Whole = Field(ge=1, le=MAX_EPISODES)
    """Touches: each is one object in one place that goes through one motion."""
    seed: Whole = Field(default=0, ge=0, lt=2**31)
    accuracy: Literal["fast", "default", "reference"] = "default"
    """Accuracy as of ``taccel-lab press``."""
    mesh: Literal["focused", "profile"] = "focused"
    """Mesh as of ``taccel-lab press``."""
    view: Share = 0.7
    """Touches are placed in this part of the camera's view about its middle."""
    x_mm: Range | None = None
    """Places along gel x, in place of ``view``."""
    y_mm: Range | None = None

    _ranges = field_validator("x_mm", "y_mm")(_check_range)

    @model_validator(mode="after")
    def _check_place(self) -> DatasetBlock:
        if (self.x_mm is None) != (self.y_mm is None):
            raise ValueError("give x_mm and y_mm together")
        if self.x_mm is not None and "view" in self.model_fields_set:
            raise ValueError("give either view, or x_mm and y_mm, not both")
        return self


class SensorEntry(StrictModel):
    """A sensor that is touched."""

    profile: StrictStr
    """Profile folder, beside the file if it is not absolute, or a sensor of the catalogue."""
    units: Whole = Field(default=1, ge=1, le=10_000)
    """Sensors that could have been built, drawn from the spread that the profile states; the first
    is the profile itself."""
    test_units: Whole = Field(default=0, ge=0, le=10_000)
    """How many of them, the last ones, belong to the split test."""
    weight: Weight = 1.0
    """How often it is touched, beside the others."""
    split: Split = "train"

    @model_validator(mode="after")
    def _check_units(self) -> SensorEntry:
        if self.test_units >= self.units and self.test_units:
            raise ValueError(f"test_units {self.test_units} must be fewer than units {self.units}")
        return self


class ObjectEntry(StrictModel):
    """An object that touches."""

    tool: StrictStr
    """Tool as ``--indenter`` of ``taccel-lab press`` takes it: ``sphere:3``, ``box:4x3``,
    ``mesh:FILE@AXIS``; a file lies beside the spec if its path is not absolute."""
    name: Name | None = None
    """The tool's text when left out."""
    yaw_deg: Range = (0.0, 360.0)
    """Turn about its axis."""
    tilt_deg: Range = (0.0, 0.0)
    """How far its axis, along which it comes down, leans from the face's normal, to any side."""
    weight: Weight = 1.0
    split: Split = "train"

    _ranges = field_validator("yaw_deg", "tilt_deg")(_check_range)

    @field_validator("tilt_deg")
    @classmethod
    def _check_tilt(cls, ends: Range) -> Range:
        if ends[0] < 0 or ends[1] > 15:
            raise ValueError(f"must lie in [0, 15] degrees, got [{ends[0]:g}, {ends[1]:g}]")
        return ends

    @property
    def label(self) -> str:
        return self.name or self.tool


class MotionEntry(StrictModel):
    """How an object moves: down to a depth, then sideways, about its axis, or rolling."""

    kind: Literal["press", "shear", "twist", "roll", "slip"]
    depth_mm: Range
    """Depth past first touch."""
    shear_mm: Range | None = None
    """Way sideways of shear and slip, at full depth."""
    direction_deg: Range = (0.0, 360.0)
    """Direction of shear, slip and roll, from the object's x towards its y."""
    twist_deg: Range | None = None
    """Turn of a twist about the object's axis; one sign or both."""
    roll_deg: Range | None = None
    """Turn of a roll about an axis along the face, while the object moves on by its height times
    the angle, as a ball or a roller does that does not slide."""
    step_mm: Number = Field(default=0.2, gt=0, le=10)
    """Largest motion of a step; each step is a row of the data."""
    step_deg: Number = Field(default=2.0, gt=0, le=30)
    weight: Weight = 1.0

    _ranges = field_validator("depth_mm", "shear_mm", "direction_deg", "twist_deg", "roll_deg")(
        _check_range
    )

    @model_validator(mode="after")
    def _check_kind(self) -> MotionEntry:
        if self.depth_mm[0] <= 0:
            raise ValueError(f"depth_mm must be above 0, got {self.depth_mm[0]:g}")
        for name, kinds in (
            ("shear_mm", ("shear", "slip")),
            ("twist_deg", ("twist",)),
            ("roll_deg", ("roll",)),
        ):
            given = getattr(self, name) is not None
            if given and self.kind not in kinds:
                raise ValueError(f"{name} belongs to {' and '.join(kinds)}, not to {self.kind}")
            if not given and self.kind in kinds:
                raise ValueError(f"kind = {self.kind!r} needs {name} = [low, high]")
        if "direction_deg" in self.model_fields_set and self.kind in ("press", "twist"):
            raise ValueError(f"direction_deg belongs to shear, slip and roll, not to {self.kind}")
        if self.shear_mm is not None and not 0 <= self.shear_mm[0] <= self.shear_mm[1] <= 20:
            raise ValueError("shear_mm must lie in [0, 20] mm; direction_deg says which way")
        for name, most in (("twist_deg", 180), ("roll_deg", 45)):
            ends = getattr(self, name)
            if ends is not None and max(abs(ends[0]), abs(ends[1])) > most:
                raise ValueError(f"{name} must lie within +-{most} degrees")
        steps = self._most_steps()
        if steps > MAX_STEPS:
            raise ValueError(
                f"a touch would take {steps:.3g} steps of step_mm = {self.step_mm:g} mm and "
                f"step_deg = {self.step_deg:g} degrees; at most {MAX_STEPS}"
            )
        return self

    def _most_steps(self) -> float:
        """Steps of the longest touch."""
        turns = [
            abs(end) for ends in (self.twist_deg, self.roll_deg) if ends is not None for end in ends
        ]
        side = max(
            0.0 if self.shear_mm is None else self.shear_mm[1] / self.step_mm,
            max(turns, default=0.0) / self.step_deg,
        )
        return self.depth_mm[1] / self.step_mm + side


class Randomise(StrictModel):
    """What is drawn anew for each episode, beside the unit's own."""

    friction: Range | None = None
    """Coefficient between object and gel, in place of the profile's and the unit's."""
    young_modulus_factor: Range | None = None
    """Factor of all layers' moduli, beside the unit's."""
    light_gain: Number = Field(default=0.0, ge=0, le=1)
    """Standard deviation of each colour's gain about the mean of the background."""
    light_offset_levels: Number = Field(default=0.0, ge=0, le=100)
    """Standard deviation of each colour's offset [levels of 255]."""
    light_gradient_levels: Number = Field(default=0.0, ge=0, le=100)
    """Standard deviation of a gradient over half the image [levels]."""
    image_noise_levels: Number = Field(default=0.0, ge=0, le=100)
    """Standard deviation of a pixel [levels], drawn for each image."""
    marker_noise_px: Number = Field(default=0.0, ge=0, le=20)
    """Standard deviation of a marker's u and v [px], drawn for each step."""

    _ranges = field_validator("friction", "young_modulus_factor")(_check_range)

    @model_validator(mode="after")
    def _check_values(self) -> Randomise:
        if self.friction is not None and not 0 <= self.friction[0] <= self.friction[1] <= 5:
            raise ValueError("friction must lie in [0, 5]")
        factor = self.young_modulus_factor
        if factor is not None and not 0.05 <= factor[0] <= factor[1] <= 20:
            raise ValueError("young_modulus_factor must lie in [0.05, 20]")
        return self


class DatasetOutput(StrictModel):
    """What is kept of each step, and how it lies on disk."""

    channels: tuple[StrictStr, ...] = DEFAULT_CHANNELS
    """Names of ``taccel-lab dataset channels``."""
    size_px: tuple[Whole, Whole] | None = None
    """Width and height of images. Default: the camera's."""
    patches: tuple[Annotated[Whole, Field(ge=1, le=256)], Annotated[Whole, Field(ge=1, le=256)]] = (
        8,
        6,
    )
    """Columns and rows of patches that forces are added up over."""
    episodes_per_part: Whole = Field(default=8, ge=1, le=10_000)
    """Episodes that are written together: what a kill loses."""
    block_steps: Whole = Field(default=8, ge=1, le=10_000)
    """Steps of a chunk: what is read together."""

    @field_validator("channels")
    @classmethod
    def _check_repeats(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        repeated = first_repeated(names)
        if repeated is not None:
            raise ValueError(f"named twice: {repeated}")
        return names

    @field_validator("size_px")
    @classmethod
    def _check_size(cls, size: tuple[int, int] | None) -> tuple[int, int] | None:
        if size is not None and not all(8 <= n <= 8192 for n in size):
            raise ValueError(f"must lie in 8..8192 px, got {size[0]} x {size[1]}")
        return size


class DatasetSpec(StrictModel):
    """A whole file."""

    dataset: DatasetBlock
    sensors: list[SensorEntry] = Field(min_length=1)
    objects: list[ObjectEntry] = Field(min_length=1)
    motions: list[MotionEntry] = Field(min_length=1)
    randomise: Randomise = Randomise()
    faults: Annotated[FrameFaults, BeforeValidator(FrameFaults.of)] = FrameFaults()
    """Frames that are faulty, by chances and ranges."""
    output: DatasetOutput = DatasetOutput()

    @model_validator(mode="after")
    def _check_names(self) -> DatasetSpec:
        for what, names in (
            ("sensors", [entry.profile for entry in self.sensors]),
            ("objects", [entry.label for entry in self.objects]),
        ):
            repeated = first_repeated(names)
            if repeated is not None:
                raise ValueError(f"two {what} are called {repeated!r}")
        return self

    @model_validator(mode="after")
    def _check_faults(self) -> DatasetSpec:
        if self.faults and "rgb" not in self.output.channels:
            raise ValueError("[faults] are of images: put rgb into output.channels")
        named = [name for name in FAULT_CHANNELS if name in self.output.channels]
        if named:
            raise ValueError(f"{named[0]} is kept wherever there are [faults]; leave it out")
        return self

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of what is kept beside what always is: images with faults have labels."""
        return (*self.output.channels, *(FAULT_CHANNELS if self.faults else ()))


def load_spec(path: Path | str) -> DatasetSpec:
    """Read the file of a data set. Raises InputError with every wrong key: what is allowed."""
    return DatasetSpec.read(Path(path))
