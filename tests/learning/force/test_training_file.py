# SPDX-License-Identifier: Apache-2.0
"""A training that was stopped goes on with the same command and ends as one that was not."""

from __future__ import annotations

import dataclasses
import os
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from taccel_lab.learning.force.fit import calibrate_force
from taccel_lab.learning.force.options import ForceOptions
from taccel_lab.learning.force.train import TrainedForces
from taccel_lab.learning.force.training_file import TrainingFile
from taccel_lab.progress import Progress, silent
from tests.learning.force.conftest import QUICK
from tests.learning.force.small_touches import planned, write_touches
from tests.support.strangers import Payload

SHORT = dataclasses.replace(QUICK, steps=20)
"""A few batches to an order of the samples, so that it is drawn anew on the way."""
KILLED = """
import os, signal, sys
from pathlib import Path
from taccel_lab.learning.force import train
from taccel_lab.learning.force.fit import calibrate_force
from taccel_lab.learning.force.training_file import TrainingFile
from tests.learning.force.test_training_file import SHORT

def killed(task, done, total):
    if task.startswith("training") and done >= 12:
        os.kill(os.getpid(), signal.SIGKILL)

train.EVERY = 4
calibrate_force(sys.argv[1], None, SHORT, killed, TrainingFile(Path(sys.argv[2]), every_s=0.0))
"""


class _StoppedError(Exception):
    pass


def stop_at(step: int) -> Progress:

    def progress(task: str, done: int, total: int) -> None:
        if task.startswith("training") and done >= step:
            raise _StoppedError

    return progress


def train(
    touches: Path,
    file: TrainingFile | None,
    progress: Progress = silent,
    options: ForceOptions = SHORT,
) -> TrainedForces:
    return calibrate_force(touches, None, options, progress, file).trained


def same(first: TrainedForces, second: TrainedForces) -> bool:
    weights = (np.array_equal(first.weights[n], second.weights[n]) for n in first.weights)
    return first.config == second.config and first.curve == second.curve and all(weights)


@pytest.fixture(autouse=True, scope="module")
def often() -> Any:
    """Points of the loss curve, which the training may be stopped at."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("taccel_lab.learning.force.train.EVERY", 4)
        # Judged after the training, and not looked at here.
        patch.setattr("taccel_lab.learning.force.fit.found_imposters", lambda *_: [])
        yield


@pytest.fixture(scope="module")
def touches(sensor: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_touches(planned(sensor, episodes=40), tmp_path_factory.mktemp("few") / "data")


@pytest.fixture(scope="module")
def whole(touches: Path) -> TrainedForces:
    return train(touches, None)


@pytest.fixture
def stopped(touches: Path, tmp_path: Path) -> Path:
    """Where a training that was stopped at step 12 has left its state of step 11."""
    file = TrainingFile(tmp_path / "t.pt", every_s=0.0)
    with pytest.raises(_StoppedError):
        train(touches, file, stop_at(12))
    assert file.step == 11
    return file.path


@pytest.mark.thorough
def test_it_ends_with_the_same_bits(touches: Path, whole: TrainedForces, stopped: Path) -> None:
    said: list[str] = []
    file = TrainingFile(stopped, said.append, every_s=0.0)
    with pytest.raises(_StoppedError):
        train(touches, file, stop_at(16))
    assert "continues after step 11" in said[0] and file.step == 15
    assert len(whole.curve) == 5
    assert same(train(touches, TrainingFile(stopped, every_s=1e9)), whole)
    # Kept at its end, too: what goes wrong in the figures or the writing costs no training.
    file = TrainingFile(stopped, said.append)
    assert same(train(touches, file, stop_at(1)), whole)
    assert "continues after step 20" in said[-1] and file.earlier_s > 0
    file.remove()
    assert not list(stopped.parent.iterdir())


@pytest.mark.slow
def test_after_a_kill_it_ends_alike(touches: Path, whole: TrainedForces, tmp_path: Path) -> None:
    words = [sys.executable, "-c", KILLED, str(touches), str(tmp_path / "t.pt")]
    assert subprocess.run(words, capture_output=True, check=False).returncode == -9
    file = TrainingFile(tmp_path / "t.pt", every_s=1e9)
    assert same(train(touches, file), whole)
    assert file.earlier_s > 0


@pytest.mark.timeout(60)
@pytest.mark.parametrize("content", ["pickle", "torch", "list", "pipe"])
def test_nothing_that_a_file_holds_is_run(tmp_path: Path, content: str) -> None:
    path, place = tmp_path / "t.pt", tmp_path / "ran"
    said: list[str] = []
    state = {"key": "k", "step": Payload(place), "seconds": 0.0}
    if content == "pickle":
        path.write_bytes(pickle.dumps(state, protocol=2))
    elif content == "pipe":
        os.mkfifo(path)
    else:
        torch.save(state if content == "torch" else [1.0], path)
    assert TrainingFile(path, said.append).load("k") is None
    assert "cannot be read; the training starts anew" in said[0] and not place.exists()


def test_a_state_goes_on_with_its_own_training_alone(tmp_path: Path) -> None:
    said: list[str] = []
    TrainingFile(tmp_path / "t.pt").save("ours", 11, {"rate": 0.5})
    file = TrainingFile(tmp_path / "t.pt", said.append)
    assert file.load("another") is None and file.step is None
    assert "is of other data or settings; the training starts anew" in said[0]
    state = file.load("ours")
    assert state is not None and state["rate"] == 0.5 and file.step == 11
    assert said[1:] == [f"the training continues after step 11, kept in {tmp_path / 't.pt'}"]


def begun(touches: Path, path: Path, **changes: Any) -> str:
    """What a training says that finds a file there; it is stopped before it keeps anything."""
    said: list[str] = []
    file, before = TrainingFile(path, said.append, every_s=1e9), path.read_bytes()
    with pytest.raises(_StoppedError):
        train(touches, file, stop_at(1), dataclasses.replace(SHORT, **changes))
    # Replaced by the first state of the new one, not before.
    assert file.step is None and path.read_bytes() == before
    return said[0]


@pytest.mark.thorough
def test_others_begin_anew(touches: Path, sensor: Path, stopped: Path, tmp_path: Path) -> None:
    other = "of other data or settings; the training starts anew"
    for changes in ({"seed": 1}, {"steps": 21}, {"light": 0.2}, {"learning_rate": 1e-3}):
        assert other in begun(touches, stopped, **changes)
    assert other in begun(write_touches(planned(sensor, episodes=30), tmp_path / "o"), stopped)
    for spoilt in (stopped.read_bytes()[:1000], b"x"):
        stopped.write_bytes(spoilt)
        assert "cannot be read; the training starts anew" in begun(touches, stopped)
