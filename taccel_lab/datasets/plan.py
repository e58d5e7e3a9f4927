# SPDX-License-Identifier: Apache-2.0
"""What a data set will hold: every episode as it is drawn, and the parts they are written in.

Everything follows from the file and its seed. Episode i is drawn from (seed, i) alone; parts are
episodes of one sensor and object, by their length, so that nobody waits for a longer one. Nothing
depends on who simulates which part, or when.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from taccel_lab.datasets.channels import camera_record, check_channels
from taccel_lab.datasets.motion import Placing, view_range_mm
from taccel_lab.datasets.sensor import UNITS_KEY, Sensor, sensor_of
from taccel_lab.errors import InputError, naming
from taccel_lab.files.file_cache import content_key
from taccel_lab.files.regular_file import file_sha256
from taccel_lab.presses import PHYSICS, Accuracy, Indenter, PressPath, PressPhysics, parse_indenter
from taccel_lab.presses.touch import check_depth
from taccel_lab.progress import Progress, silent
from taccel_lab.signals.perturbation import Perturbation, draw_perturbation
from taccel_lab.version import __version__

if TYPE_CHECKING:
    from taccel_lab.datasets.spec import DatasetSpec, MotionEntry
    from taccel_lab.profile import SensorProfile

FORMAT = 1
"""Format of the folder; a reader refuses others."""
PRESS_RULES = 2
"""Raised when presses of the same file have other forces: a data set does not go on with them."""
EPISODE_KEY, LIGHT_KEY, NOISE_KEY, FAULT_KEY = 2, 3, 4, 5
"""Keys of the seeds of what they name, beside the data set's own."""
_TOLD_EVERY = 4096
"""Episodes that are drawn between two words of how far it is: a quarter of a second."""


@dataclass(frozen=True)
class PlannedTouch:
    """One touch as it was drawn."""

    index: int
    sensor: int
    unit: int
    object: int
    motion: int
    """Entries of the file, from 0."""
    placing: Placing
    path: PressPath
    """Its way, in the object's frame at the start."""
    drawn: dict[str, float]
    """Depth, way, direction and turns as they were drawn, by column."""
    friction: float
    young_modulus_factor: float
    split: str


@dataclass(frozen=True)
class DatasetPart:
    """Episodes that are written together, of one sensor and object."""

    index: int
    sensor: int
    object: int
    episodes: tuple[int, ...]
    steps: int
    """Rows of them all, the untouched gel of each included, where none stops early."""

    @property
    def name(self) -> str:
        return f"{self.index:06d}"


class Episodes(Sequence[PlannedTouch]):
    """All episodes of a plan by index, each drawn on demand: ten million would fill the
    memory."""

    def __init__(self, plan: DatasetPlan) -> None:
        self._plan = plan

    def __len__(self) -> int:
        return self._plan.spec.dataset.episodes

    @overload
    def __getitem__(self, index: int) -> PlannedTouch: ...
    @overload
    def __getitem__(self, index: slice) -> list[PlannedTouch]: ...
    def __getitem__(self, index: int | slice) -> PlannedTouch | list[PlannedTouch]:
        chosen = range(len(self))[index]
        if isinstance(chosen, range):
            return [self._plan.draw(number) for number in chosen]
        return self._plan.draw(chosen)

    def __iter__(self) -> Iterator[PlannedTouch]:
        return map(self._plan.draw, range(len(self)))


class DatasetPlan:
    """A checked file with what it names, ready to be simulated."""

    def __init__(self, spec: DatasetSpec, base: Path, physics: PressPhysics | None = None) -> None:
        """Read profiles and objects, whose paths are relative to ``base``; simulates nothing.
        ``physics`` is that of the file's accuracy when None.

        Raises InputError for what cannot be: missing files, depths beyond the gel, channels that a
        sensor lacks, places where the gel cannot be meshed.
        """
        self.spec, self.base = spec, base
        self.physics = physics or PHYSICS[Accuracy(spec.dataset.accuracy)]
        self.profiles: list[SensorProfile] = []
        self.sensors: list[Sensor] = []
        for number, entry in enumerate(spec.sensors):
            with naming(f"sensors[{number}]"):
                profile = _load_profile(entry.profile, base)
                seed = (spec.dataset.seed, UNITS_KEY, number)
                self.profiles.append(profile)
                self.sensors.append(sensor_of(profile, spec.output.size_px, entry.units, seed))
        self.tools = [_tool(entry.tool, base) for entry in spec.objects]
        self.indenters: list[Indenter] = []
        for number, tool in enumerate(self.tools):
            with naming(f"objects[{number}]"):
                self.indenters.append(parse_indenter(tool))
        self._check()

    # What is checked -------------------------------------------------------------------------

    def _check(self) -> None:
        gap_mm = 1e3 * self.physics.dhat_m
        for number, motion in enumerate(self.spec.motions):
            if motion.depth_mm[1] < gap_mm:
                raise InputError(
                    f"motions[{number}]: depth_mm ends at {motion.depth_mm[1]:g} mm; contact "
                    f"begins at a gap of {gap_mm:g} mm, so that touches must be deeper than that "
                    "(is the depth in metres?)"
                )
            for profile in self.profiles:
                with naming(f"motions[{number}] on {profile.sensor.name}"):
                    check_depth(motion.depth_mm[1], profile)
        for number, indenter in enumerate(self.indenters):
            with naming(f"objects[{number}]"):
                indenter.require_size(self._deepest_mm)
        for number, sensor in enumerate(self.sensors):
            with naming(f"sensors[{number}] ({sensor.name})"):
                check_channels(self.spec.output, sensor)
                self._check_places(sensor)

    @property
    def _deepest_mm(self) -> float:
        return max(motion.depth_mm[1] for motion in self.spec.motions)

    def _check_places(self, sensor: Sensor) -> None:
        """Refuse ranges of places in whose corners the gel cannot be meshed for some object."""
        low, high = self.place_range_mm(sensor)
        straight, friction = PressPath(self._deepest_mm), sensor.friction_coefficient
        corners = [(x, y) for x in {low[0], high[0]} for y in {low[1], high[1]}]
        for entry, indenter in zip(self.spec.objects, self.indenters, strict=True):
            for x, y in corners:
                placing = Placing(float(x), float(y), entry.yaw_deg[0], entry.tilt_deg[1])
                try:
                    placing.frame(sensor.pad, indenter)
                    if self.spec.dataset.mesh == "focused":
                        placing.setup(sensor, indenter, straight, self.physics, friction=friction)
                except InputError as error:
                    raise InputError(
                        f"object {entry.label!r} cannot be placed at ({x:.3g}, {y:.3g}) mm: "
                        f"{error}; choose a smaller view, or x_mm and y_mm, in [dataset]"
                    ) from None

    def place_range_mm(self, sensor: Sensor) -> tuple[np.ndarray, np.ndarray]:
        """Low and high gel xy of touches [mm], [2] each."""
        block = self.spec.dataset
        if block.x_mm is not None and block.y_mm is not None:
            ends = np.array([block.x_mm, block.y_mm])
            return ends[:, 0], ends[:, 1]
        return view_range_mm(sensor.grid, block.view)

    # What is drawn ---------------------------------------------------------------------------

    @property
    def episodes(self) -> Episodes:
        """All of them, by index."""
        return Episodes(self)

    @functools.cached_property
    def _edges(self) -> list[np.ndarray]:
        """Sums of the weights of sensors, objects and motions, up to each."""
        tables = (self.spec.sensors, self.spec.objects, self.spec.motions)
        return [np.cumsum([entry.weight for entry in table]) for table in tables]

    @functools.cached_property
    def _place_ranges_mm(self) -> list[tuple[np.ndarray, np.ndarray]]:
        return [self.place_range_mm(sensor) for sensor in self.sensors]

    def draw(self, index: int) -> PlannedTouch:
        """Episode ``index``, of its own seed."""
        spec = self.spec
        rng = np.random.default_rng([spec.dataset.seed, EPISODE_KEY, index])
        sensor, touched, motion = (_weighted(rng, edges) for edges in self._edges)
        by, thing = spec.sensors[sensor], spec.objects[touched]
        unit = int(rng.integers(by.units))
        low, high = self._place_ranges_mm[sensor]
        placing = Placing(
            float(rng.uniform(low[0], high[0])),
            float(rng.uniform(low[1], high[1])),
            float(rng.uniform(*thing.yaw_deg)),
            float(rng.uniform(*thing.tilt_deg)),
            float(rng.uniform(0, 360)),
        )
        path, drawn = _drawn_motion(rng, spec.motions[motion])
        one = self.sensors[sensor].units[unit]
        friction = one.friction_coefficient
        if friction is None:
            friction = self.sensors[sensor].friction_coefficient
        if spec.randomise.friction is not None:
            friction = float(rng.uniform(*spec.randomise.friction))
        factor = one.young_modulus_factor
        if spec.randomise.young_modulus_factor is not None:
            factor *= float(rng.uniform(*spec.randomise.young_modulus_factor))
        test = by.split == "test" or thing.split == "test" or unit >= by.units - by.test_units
        return PlannedTouch(
            index, sensor, unit, touched, motion, placing, path, drawn, friction, factor,
            "test" if test else "train",
        )  # fmt: skip

    def light(self, episode: PlannedTouch) -> Perturbation | None:
        """What [randomise] does to the light of an episode; one row."""
        from taccel_lab.profile import PerturbationBlock, Provenance

        wanted = self.spec.randomise
        gain, offset = wanted.light_gain, wanted.light_offset_levels
        gradient = wanted.light_gradient_levels
        if not (gain or offset or gradient):
            return None
        color = self.sensors[episode.sensor].color
        pivot = np.full(3, 128.0) if color is None else color[1].reshape(-1, 3).mean(axis=0)
        block = PerturbationBlock(
            gain_rgb=(gain, gain, gain),
            pivot_rgb=(float(pivot[0]), float(pivot[1]), float(pivot[2])),
            offset_rgb=(offset, offset, offset),
            gradient_rgb=(gradient, gradient, gradient),
            provenance=Provenance(kind="assumed", method="[randomise]", source="the file"),
        )
        rng = np.random.default_rng([self.spec.dataset.seed, LIGHT_KEY, episode.index])
        return draw_perturbation(block, 1, rng)

    def fault_seed(self, index: int) -> int:
        """Seed of the faults of an episode's images."""
        rng = np.random.default_rng([self.spec.dataset.seed, FAULT_KEY, index])
        return int(rng.integers(2**31))

    @functools.cached_property
    def parts(self) -> list[DatasetPart]:
        """All episodes, grouped as they are written."""
        return self._grouped(silent)

    def group(self, progress: Progress) -> None:
        """Find ``parts``, which takes a minute for a million episodes, and tell how far it is."""
        if "parts" not in self.__dict__:
            self.parts = self._grouped(progress)

    def _grouped(self, progress: Progress) -> list[DatasetPart]:
        count, size = len(self.episodes), self.spec.output.episodes_per_part
        pairs, steps = np.empty((2, count), dtype=np.int32)
        for episode in self.episodes:
            pairs[episode.index] = episode.sensor * len(self.tools) + episode.object
            steps[episode.index] = sum(episode.path.counts)
            if episode.index % _TOLD_EVERY == 0:
                progress("drawing touches", episode.index, count)
        progress("drawing touches", count, count)
        parts: list[DatasetPart] = []
        for pair in np.unique(pairs).tolist():
            group = np.flatnonzero(pairs == pair)
            group = group[np.argsort(steps[group], kind="stable")]
            for first in range(0, len(group), size):
                chosen = group[first : first + size]
                rows = int(steps[chosen].sum()) + len(chosen)
                sensor, thing = divmod(pair, len(self.tools))
                parts.append(DatasetPart(len(parts), sensor, thing, tuple(chosen.tolist()), rows))
        return parts

    def shard(self, number: int, count: int) -> list[DatasetPart]:
        """The parts of shard ``number`` of ``count``, from 1."""
        return self.parts[number - 1 :: count]

    # Its name ---------------------------------------------------------------------

    @functools.cached_property
    def recipe(self) -> dict[str, Any]:
        """All that the data depend on, as JSON."""
        spec = self.spec.model_dump(mode="json")
        cameras = [camera_record(sensor.camera) for sensor in self.sensors]
        return {
            # Not with data of earlier versions, whose channels saw a gel along its normal.
            **({"cameras": cameras} if any(cameras) else {}),
            "format": FORMAT,
            "tool_version": __version__,
            "spec": spec,
            "profiles": [sensor.digest for sensor in self.sensors],
            "objects": [_file_digest(tool) for tool in self.tools],
            "physics": self.physics.record(),
            "press_rules": PRESS_RULES,
        }

    @functools.cached_property
    def digest(self) -> str:
        """SHA-256 of ``recipe``."""
        return content_key(self.recipe)


def _load_profile(name: str, base: Path) -> SensorProfile:
    from taccel_lab.profile import split_view
    from taccel_lab.sensors.profile import load_sensor

    beside = base / split_view(name)[0]
    return load_sensor(str(base / name) if beside.is_dir() else name)


def _tool(text: str, base: Path) -> str:
    """A tool whose file is found from anywhere."""
    kind, _, value = text.partition(":")
    if kind != "mesh" or Path(value).is_absolute():
        return text
    return f"mesh:{base / value}"


def tool_file(tool: str) -> Path | None:
    """The file of an object, if it is one."""
    kind, _, value = tool.partition(":")
    if kind != "mesh":
        return None
    name, at, axis = value.rpartition("@")
    return Path(name) if at and len(axis) == 2 and axis[0] in "+-" else Path(value)


def _file_digest(tool: str) -> str:
    path = tool_file(tool)
    return "" if path is None else file_sha256(path)


def _weighted(rng: np.random.Generator, edges: np.ndarray) -> int:
    return min(int(np.searchsorted(edges, rng.random() * edges[-1], side="right")), len(edges) - 1)


def _drawn_motion(
    rng: np.random.Generator, entry: MotionEntry
) -> tuple[PressPath, dict[str, float]]:
    """A path, in the object's frame, and the numbers that it was drawn from."""

    def drawn(ends: tuple[float, float] | None) -> float:
        value = rng.uniform(*(ends or (0.0, 0.0)))
        return float(value) if ends is not None else 0.0

    values = {
        "depth_mm": drawn(entry.depth_mm),
        "shear_mm": drawn(entry.shear_mm),
        "direction_deg": drawn(entry.direction_deg),
        "twist_deg": drawn(entry.twist_deg),
        "roll_deg": drawn(entry.roll_deg),
    }
    assert all(math.isfinite(value) for value in values.values())
    direction_rad, way, roll = (
        math.radians(values["direction_deg"]), values["shear_mm"], values["roll_deg"]
    )  # fmt: skip
    x, y = math.cos(direction_rad), math.sin(direction_rad)
    path = PressPath(
        values["depth_mm"],
        (way * x, way * y),
        values["twist_deg"],
        step_mm=entry.step_mm,
        step_deg=entry.step_deg,
        # About the axis across the direction.
        roll_deg=(-roll * y, roll * x),
    )
    return path, values
