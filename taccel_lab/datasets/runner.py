# SPDX-License-Identifier: Apache-2.0
"""Makes a data set, or a shard of it: simulates the parts that are not there yet."""

from __future__ import annotations

import functools
import gc
import math
import os
import time
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taccel_lab.datasets.channels import channels_of
from taccel_lab.datasets.folder import PARTS, DatasetFolder
from taccel_lab.datasets.motion import Touch, TouchRecord, failed_touch
from taccel_lab.datasets.part import PartData, part_data, write_part
from taccel_lab.datasets.plan import NOISE_KEY, DatasetPart, DatasetPlan
from taccel_lab.datasets.simulate import TouchBench, simulate_touches
from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import write_json
from taccel_lab.files.output_folder import sweep_up
from taccel_lab.presses import PressPhysics
from taccel_lab.processes.process_pool import Died, Finished, ProcessPool, usable_cores
from taccel_lab.progress import Progress
from taccel_lab.report.machine import describe_run

if TYPE_CHECKING:
    from taccel_lab.datasets.spec import DatasetSpec

GPU_TOUCHES = 256
"""Environments side by side on a GPU."""
WRITERS = 4
"""Threads that compress and write while a GPU simulates."""


@dataclass(frozen=True)
class Done:
    """What became of one part."""

    part: int
    episodes: int
    failed: int
    """Episodes without a converged step, or that stopped early."""
    steps: int
    """Rows, one image each where images are kept."""
    size_bytes: int
    """Size on disk; 0 where nothing was written."""


@dataclass
class DatasetOutcome:
    """A run."""

    root: Path | None
    parts_total: int
    """Parts of the shard."""
    parts_there: int
    """Parts before the run."""
    done: list[Done]
    seconds: float
    device: str
    processes: int

    @property
    def steps(self) -> int:
        return sum(part.steps for part in self.done)

    @property
    def complete(self) -> bool:
        return self.parts_there + len(self.done) == self.parts_total

    def record(self) -> dict[str, Any]:
        """Rates, counts and machine of the run as JSON."""
        seconds = max(self.seconds, 1e-9)
        return {
            "images_per_s": self.steps / seconds,
            "episodes_per_s": sum(part.episodes for part in self.done) / seconds,
            "images": self.steps,
            "episodes": sum(part.episodes for part in self.done),
            "episodes_stopped": sum(part.failed for part in self.done),
            "bytes": sum(part.size_bytes for part in self.done),
            "written": self.root is not None,
            "seconds": self.seconds,
            "device": self.device,
            "processes": self.processes,
            "machine": describe_run(self.device),
        }


Listener = Callable[[int, int, int, float], None]
"""Receives parts done and in all, steps so far and seconds."""


def default_processes(device: str) -> int:
    """One a core this process may use; a GPU is served by this process itself."""
    return 0 if device.startswith("cuda") else usable_cores()


def batches(
    plan: DatasetPlan, parts: list[DatasetPart], device: str
) -> list[tuple[DatasetPart, ...]]:
    """Parts that are simulated together: one on the CPU, which gains nothing by more; on a GPU
    neighbours of one sensor and object."""
    if not device.startswith("cuda"):
        return [(part,) for part in parts]
    found: list[list[DatasetPart]] = []
    for part in parts:
        last = found[-1] if found else []
        room = GPU_TOUCHES - sum(len(p.episodes) for p in last)
        same = last and (last[0].sensor, last[0].object) == (part.sensor, part.object)
        if same and len(part.episodes) <= room:
            last.append(part)
        else:
            found.append([part])
    return [tuple(group) for group in found]


def touches_of(
    plan: DatasetPlan, part: DatasetPart, device: str = "cpu"
) -> list[Touch | TouchRecord]:
    """Episodes of a part, meshed; those that cannot be are records that say why."""
    sensor, indenter = plan.sensors[part.sensor], plan.indenters[part.object]
    wanted = plan.spec.randomise
    found: list[Touch | TouchRecord] = []
    for number in part.episodes:
        episode = plan.episodes[number]
        commands = episode.path.commands()
        try:
            setup = episode.placing.setup(
                sensor,
                indenter,
                episode.path,
                plan.physics,
                friction=episode.friction,
                poisson_ratio=sensor.units[episode.unit].poisson_ratio,
                focused=plan.spec.dataset.mesh == "focused",
                device=device,
            )
            frame = episode.placing.frame(sensor.pad, indenter)
        except InputError as error:
            found.append(failed_touch(number, len(commands), str(error)))
            continue
        found.append(
            Touch(
                episode=number,
                setup=setup,
                frame=frame,
                commands=commands,
                unit=episode.unit,
                young_modulus_factor=episode.young_modulus_factor,
                light=plan.light(episode),
                noise_levels=math.hypot(wanted.image_noise_levels, sensor.noise_levels),
                marker_noise_px=wanted.marker_noise_px,
                seed=(plan.spec.dataset.seed, NOISE_KEY),
                faults=plan.spec.faults or None,
                fault_seed=plan.fault_seed(number),
            )
        )
    return found


def simulate_parts(
    plan: DatasetPlan, parts: tuple[DatasetPart, ...], device: str, progress: Progress
) -> list[PartData]:
    """Simulate parts of one sensor and object side by side."""
    output = plan.spec.output
    first = parts[0]
    prepared = [touches_of(plan, part, device) for part in parts]
    ready = [touch for group in prepared for touch in group if isinstance(touch, Touch)]
    what = f"part {first.index}, {len(ready)} touches"
    bench = TouchBench(
        plan.sensors[first.sensor],
        channels_of(plan.spec.channels),
        output.patches,
        lambda done, total: progress(what, done, total),
    )
    records = iter(simulate_touches(ready, bench))
    return [
        part_data(
            plan,
            part,
            [next(records) if isinstance(touch, Touch) else touch for touch in group],
        )
        for part, group in zip(parts, prepared, strict=True)
    ]


def make_dataset(
    plan: DatasetPlan,
    root: Path | str | None,
    *,
    source: str = "",
    shard: tuple[int, int] = (1, 1),
    device: str = "cpu",
    processes: int | None = None,
    limit: int | None = None,
    listener: Listener = lambda done, total, steps, seconds: None,
    say: Callable[[str], None] = lambda words: None,
) -> DatasetOutcome:
    """Make the parts of a shard that are not there yet.

    Args:
        plan: What to make.
        root: Folder, new or begun; None to simulate and encode nothing, for timing.
        source: Text of the file, kept beside the data.
        shard: Number and count, from 1.
        device: Warp device.
        processes: How many; 0 works in this process. One a core, or this one for a GPU, when None.
        limit: Parts at most.
        listener: Receives how it goes.
        say: Receives each part that is damaged, as files of it are missing or cut short, and is
            made again.

    Raises:
        InputError: A folder with other files or of another data set, or a shard that is being made.
        OSError: A full disk and the like; parts that are there stay.
    """
    number, count = shard
    processes = default_processes(device) if processes is None else processes
    folder = None if root is None else DatasetFolder(root)
    parts = plan.shard(number, count)
    begun = time.perf_counter()
    if folder is None:
        wanted = parts[:limit]
        done = list(_run(plan, wanted, None, device, processes, len(parts), 0, listener, begun))
        seconds = time.perf_counter() - begun
        return DatasetOutcome(None, len(wanted), 0, done, seconds, device, processes)
    folder.require_usable(plan)
    with folder.locked(f"{number}/{count}"):
        folder.begin(plan, source)
        sound, missing = folder.without_damaged(parts, say)
        there = len(sound)
        outcome = DatasetOutcome(folder.root, len(parts), there, [], 0.0, device, processes)
        try:
            run = _run(
                plan, missing[:limit], folder, device, processes, len(parts), there, listener, begun
            )
            with closing(run):
                for done in run:
                    outcome.done.append(done)
        finally:
            # Processes that an error or Ctrl-C ended may have been writing.
            sweep_up(folder.root / PARTS)
            outcome.seconds = time.perf_counter() - begun
            if outcome.done or there:
                folder.write_index()
        if outcome.done:
            stamp = time.strftime("%Y%m%d-%H%M%S")
            name = f"{stamp}-{number}-of-{count}-{os.getpid()}.json"
            write_json(folder.root / "runs" / name, outcome.record())
        return outcome


def _run(
    plan: DatasetPlan,
    parts: list[DatasetPart],
    folder: DatasetFolder | None,
    device: str,
    processes: int,
    total: int,
    there: int,
    listener: Listener,
    begun: float,
) -> Generator[Done, None, None]:
    steps = 0

    def counted(done: Done) -> Done:
        nonlocal steps, there
        steps, there = steps + done.steps, there + 1
        listener(there, total, steps, time.perf_counter() - begun)
        return done

    listener(there, total, 0, 0.0)
    groups = batches(plan, parts, device)
    if processes == 0:
        yield from map(counted, _here(plan, groups, folder, device))
        return
    root = None if folder is None else folder.root
    work = functools.partial(_in_process, plan.spec, plan.base, plan.physics, root, device)
    # Not their numbers alone: a process would draw all episodes to know its parts by them.
    with ProcessPool(work, min(processes, max(1, len(groups)))) as pool:
        lost = []
        for event in pool.run(groups):
            if isinstance(event, Finished):
                yield from map(counted, event.result)
            elif isinstance(event, Died):
                lost.append(event)
        if lost:
            raise InputError(
                f"{len(lost)} of {len(groups)} parts were not made, the first one as "
                f"{lost[0].cause}; the others are kept, and the same command tries again"
            )


def _here(
    plan: DatasetPlan,
    groups: list[tuple[DatasetPart, ...]],
    folder: DatasetFolder | None,
    device: str,
) -> Iterator[Done]:
    """Makes parts in this process; threads write while the next batch is simulated."""
    with ThreadPoolExecutor(WRITERS) as pool:
        waiting: list[Future[Done]] = []
        for group in groups:
            made = simulate_parts(plan, group, device, lambda what, done, total: None)
            # Zarr leaves chunks that it wrote in circles, megabytes a touch, and commands look for
            # such rarely. What a batch left is young, so that this takes milliseconds.
            gc.collect(1)
            for future in waiting:
                yield future.result()
            waiting = [pool.submit(_finish, plan, data, folder) for data in made]
        for future in waiting:
            yield future.result()


def _finish(plan: DatasetPlan, data: PartData, folder: DatasetFolder | None) -> Done:
    size = 0
    if folder is not None:
        path = folder.part(data.part)
        write_part(path, data, plan)
        size = sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
    stopped = sum(status != "done" for status in data.episodes["status"])
    return Done(data.part.index, len(data.part.episodes), stopped, data.step_count, size)


_plans: dict[str, DatasetPlan] = {}
"""Plans of a process, by what made them."""


def _in_process(
    spec: DatasetSpec,
    base: Path,
    physics: PressPhysics,
    root: Path | None,
    device: str,
    parts: tuple[DatasetPart, ...],
    progress: Progress,
) -> list[Done]:
    """Make parts in a process of a pool."""
    key = f"{base}\n{spec.model_dump_json()}"
    if key not in _plans:
        _plans[key] = DatasetPlan(spec, base, physics)
    plan = _plans[key]
    folder = None if root is None else DatasetFolder(root)
    made = simulate_parts(plan, parts, device, progress)
    return [_finish(plan, data, folder) for data in made]
