# SPDX-License-Identifier: Apache-2.0
"""A force model's training on disk, so that the same command goes on after an interrupt.

One file beside the profile to come, renamed into its place when whole: weights, Adam's moments, the
learning rate's plan, the random generators and the order of the samples. It is tied to the data and
the settings by a digest, as a training that goes on must end as one that was never stopped.
"""

from __future__ import annotations

import dataclasses
import hashlib
import pickle
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from taccel_lab.files.atomic_file import write_by
from taccel_lab.files.inner_path import real_path
from taccel_lab.files.regular_file import LARGEST_BYTES, require_regular_file
from taccel_lab.learning.force.options import ForceOptions
from taccel_lab.learning.force.samples import ForceSamples
from taccel_lab.networks.force_settings import ForceModelConfig
from taccel_lab.version import __version__

EVERY_S = 10.0
"""Time between two states on disk [s]: what an interrupt loses at most."""
FORMAT = 1
_UNREADABLE = (
    OSError, RuntimeError, EOFError, LookupError, TypeError, ValueError, pickle.UnpicklingError,
)  # fmt: skip
"""What torch raises for files that are no states, or only part of one."""


class TrainingFile:
    """Where a training is kept while it runs."""

    def __init__(
        self,
        path: Path,
        say: Callable[[str], None] = lambda words: None,
        every_s: float = EVERY_S,
    ) -> None:
        self.path, self.say, self.every_s = path, say, every_s
        self.step: int | None = None
        """Steps that the state on disk has done; None before there is one of this training."""
        self.earlier_s = 0.0
        """What earlier runs of this training took [s]."""
        self._begun = self._saved = time.monotonic()

    @classmethod
    def beside(cls, out: Path, say: Callable[[str], None]) -> TrainingFile:
        """Training file of the profile folder ``out``, which may hold nothing but a profile."""
        out = real_path(out)
        return cls(out.with_name(f".{out.name}.training.pt"), say)

    def load(self, key: str) -> dict[str, Any] | None:
        """The state of the training with the digest ``key``, if that is what the file holds.

        The file may be anybody's: only tensors and plain values are read of it, never code."""
        if not self.path.exists():
            return None
        try:
            require_regular_file(self.path, LARGEST_BYTES, "a training's state")
            state = torch.load(self.path, map_location="cpu", weights_only=True)
            same, step, seconds = state["key"] == key, int(state["step"]), float(state["seconds"])
        except _UNREADABLE:
            self.say(f"{self.path} cannot be read; the training starts anew and replaces it")
            return None
        if not same:
            self.say(
                f"{self.path} is of other data or settings; the training starts anew and replaces "
                "it"
            )
            return None
        self.step, self.earlier_s = step, seconds
        self.say(f"the training continues after step {step:,}, kept in {self.path}")
        return state

    def due(self) -> bool:
        """Whether the last state is older than ``every_s``."""
        return time.monotonic() - self._saved >= self.every_s

    def save(self, key: str, step: int, state: Mapping[str, Any]) -> None:
        """Put a state in the place of the last one."""
        seconds = self.earlier_s + time.monotonic() - self._begun
        kept = {**state, "key": key, "step": step, "seconds": seconds}
        write_by(self.path, partial(torch.save, kept))
        self.step, self._saved = step, time.monotonic()

    def what_stays(self) -> str:
        """Words for what an interrupt leaves; empty where nothing is kept."""
        if self.step is None:
            return ""
        return f"{self.path} stays, and the same command continues after step {self.step:,}"

    def remove(self) -> None:
        """Drop the state, when what was trained is written."""
        self.path.unlink(missing_ok=True)


def training_key(
    samples: ForceSamples,
    config: ForceModelConfig,
    centers_mm: np.ndarray,
    light: object,
    options: ForceOptions,
    device: torch.device,
) -> str:
    """SHA-256 of all that the weights follow from: data, settings, versions and kind of device."""
    kind = torch.cuda.get_device_name(device) if device.type == "cuda" else "cpu"
    chosen = [getattr(options, name) for name in ("steps", "batch", "learning_rate", "seed")]
    said = (FORMAT, __version__, torch.__version__, kind, config, light, chosen, options.light)
    digest = hashlib.sha256(repr(said).encode())
    arrays = {
        field.name: getattr(samples, field.name)
        for field in dataclasses.fields(samples)
        if isinstance(getattr(samples, field.name), np.ndarray)
    }
    for name, array in {**arrays, "centers_mm": centers_mm}.items():
        digest.update(f"{name} {array.dtype} {array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


class Keeper:
    """What ``descend`` is given to go on from a file and to keep its state there.

    ``weights`` and ``curve`` are changed in place; the other parts have ``state_dict`` and
    ``load_state_dict``, as torch's optimisers do.
    """

    def __init__(
        self,
        file: TrainingFile,
        key: str,
        steps: int,
        weights: Mapping[str, torch.Tensor],
        curve: list[tuple[int, float]],
        parts: Mapping[str, Any],
    ) -> None:
        self.file, self.key, self.steps = file, key, steps
        self.weights, self.curve, self.parts = weights, curve, parts

    def restore(self, **more: Any) -> int:
        """Put back what is on disk; returns the steps that are done."""
        state = self.file.load(self.key)
        if state is None:
            return 0
        with torch.no_grad():
            for name, value in self.weights.items():
                value.copy_(state["weights"][name])
        self.curve[:] = state["curve"]
        for name, part in {**self.parts, **more}.items():
            part.load_state_dict(state[name])
        return int(state["step"])

    def keep(self, step: int, **more: Any) -> None:
        """Write the state after ``step`` when it is time to, and the last one."""
        if not (self.file.due() or step == self.steps):
            return
        parts = {name: part.state_dict() for name, part in {**self.parts, **more}.items()}
        weights = {name: value.detach() for name, value in self.weights.items()}
        self.file.save(self.key, step, {"weights": weights, "curve": self.curve, **parts})
