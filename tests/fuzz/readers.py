# SPDX-License-Identifier: Apache-2.0
"""Everything that reads files of others, each with a sound sample and a way to call it.

A reader is entered as users enter it: by a command, or by a function of a room's public part.
"""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from shutil import copy
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

from taccel_lab.benchmarks.results import benchmark_page, read_result
from taccel_lab.calibration.capture import load_capture_folder, load_captures
from taccel_lab.calibration.capture.camera.recording import Recording
from taccel_lab.calibration.capture.camera.replay import open_replay
from taccel_lab.calibration.capture.load import cut_short
from taccel_lab.calibration.live import recorded
from taccel_lab.cli import app
from taccel_lab.cli.capture import CaptureCheckCommand, CaptureImport, CaptureRectify
from taccel_lab.cli.catalogue import RobotShow
from taccel_lab.cli.dataset import DatasetCheck, DatasetMake
from taccel_lab.cli.design import ImportGel
from taccel_lab.cli.profile import ProfileShow, ProfileValidate
from taccel_lab.cli.read import Depth, Read
from taccel_lab.cli.study import StudyCommand
from taccel_lab.datasets.motion import Placing
from taccel_lab.datasets.sensor import Sensor
from taccel_lab.errors import InputError
from taccel_lab.exporters.taxim_table import TABLE_FILE, read_table
from taccel_lab.files.file_cache import CACHE_VARIABLE
from taccel_lab.files.output_folder import atomic_directory
from taccel_lab.learning.force.training_file import TrainingFile
from taccel_lab.presses import Indenter, PressSetup, parse_indenter
from taccel_lab.reading import reading as touch
from taccel_lab.signals.texture import Texture
from taccel_lab.studies import report
from taccel_lab.studies.evaluate.runner import default_kit
from taccel_lab.studies.spec.study import read_study
from taccel_lab.tasks.catalogue import read_task
from taccel_lab.viewer.press_folder import read_press, summary
from tests.calibration.judged_once import detect_once
from tests.fuzz.reader import Reader, Refused
from tests.fuzz.samples import captures, layouts, profiles, recordings, results, shapes, touches
from tools.bench.compare import Compare

Call = Callable[[Path, Path], object]


def _run(command: app.Command) -> None:
    """The command as the command line runs it."""
    said, earlier = io.StringIO(), sys.stderr
    sys.stderr = said
    try:
        with patch.object(app, "parse", lambda _: command):
            code = app.main([])
    except SystemExit as ended:
        code = ended.code
    finally:
        sys.stderr = earlier
    if code == 2:
        raise Refused(f"\n{said.getvalue()}".rpartition("\nerror: ")[2].strip())
    if code not in (0, 1):
        raise AssertionError(f"exit code {code}: {said.getvalue()[-800:]}")


def _show_profile(given: Path, out: Path) -> None:
    _run(ProfileShow(given / "profile"))
    _run(ProfileShow(given / "profile", json=True))
    _run(ProfileValidate(given / "profile"))


# Figures take a hundred times as long as all else.


def _read_depth(given: Path, out: Path) -> None:
    pictures = {name: given / f"{name}.png" for name in ("background", "mask")}
    copied = {
        "draw_maps": lambda *_: None,
        "save_figure": lambda _, to: copy(pictures["mask"], to),
    }
    with patch.multiple(touch, **copied):
        _run(Depth(given / "profile", (given / "press.png",), out, method="depth", **pictures))


def _read_recorded(given: Path, out: Path) -> None:
    background = given / "background.png"
    with patch.multiple(recorded, draw_recorded=lambda _: None, save_figure=lambda *_: None):
        _run(Read(given / "profile", given / "press.png", out, background=background))


def _load_captures(given: Path, out: Path) -> None:
    folder = load_capture_folder(given)
    if folder.presses and folder.background is not None:
        for press in folder.ball_presses().presses:
            press.image()
    for video in () if folder.markers is None else folder.markers.videos:
        video.frames()
        cut_short(video)
    for record in folder.records:
        record.sigma_n()


@cache
def _work_once() -> None:
    """Most examples leave most pictures and the sensor as they are."""
    patch = pytest.MonkeyPatch()
    detect_once(patch)
    make, made = Placing.setup, {}

    def once(
        placing: Placing, sensor: Sensor, tool: Indenter, *rest: Any, **more: Any
    ) -> PressSetup:
        key = placing, sensor.digest, tool.name, *rest, *more.items()
        if key not in made:
            made[key] = make(placing, sensor, tool, *rest, **more)
        return made[key]

    patch.setattr(Placing, "setup", once)


def _check(json: bool) -> Call:
    def call(given: Path, out: Path) -> None:
        _work_once()
        _run(CaptureCheckCommand(given, json=json))

    return call


def _rectify(given: Path, out: Path) -> None:
    _run(CaptureRectify(given / "raw", given / "maps.npz", out))


def _importer(layout: str, **options: str | float) -> Call:
    return lambda given, out: _run(CaptureImport(given, out, layout=layout, **options))


def _plan_study(given: Path, out: Path) -> None:
    planned = read_study(given / "study.toml", default_kit())
    if planned.spec.sweep.kind in ("grid", "random"):
        planned.points()


def _report_study(given: Path, out: Path) -> None:
    with patch.object(report, "write_study_report", lambda _: {"verdict": {"good": True}}):
        _run(StudyCommand(given / "study.toml", out=given / "study", report_only=True, json=True))


def _plan_dataset(given: Path, out: Path) -> None:
    _work_once()
    _run(DatasetMake(given / "touches.toml", out, check_only=True))


def _check_dataset(given: Path, out: Path) -> None:
    _run(DatasetCheck((given / "data",)))


def _replay(given: Path, out: Path) -> None:
    camera = open_replay(given / "frames")
    while camera.read() is not None:
        pass


def _recorded(source: str, name: str | None = None) -> Call:
    """Reads all frames; those that are refused are so in a sentence of their own."""

    def call(given: Path, out: Path) -> None:
        frames = [frame.image for frame in Recording.of(given / source, name).frames()]
        refused = [image for image in frames if isinstance(image, InputError)]
        if refused and len(refused) == len(frames):
            raise refused[0]

    return call


def _read_press(given: Path, out: Path) -> None:
    for name in ("steps", "end"):
        summary(given / name)
        read_press(given / name)


def _compare_results(given: Path, out: Path) -> None:
    Compare(given / "first.json", given / "second.json").run()
    benchmark_page(read_result(given / "first.json"))


def _import_step(given: Path, out: Path) -> None:
    from taccel_lab.cad.gel_import import FaceSelection, import_gel

    import_gel(given / "gel.step", FaceSelection.from_toml(given / "faces.toml"))


def _gel(name: str, unit: str = "mm") -> Call:
    def call(given: Path, out: Path) -> None:
        from taccel_lab.cad.gel_import import FaceSelection, import_gel

        import_gel(given / name, FaceSelection(unit=unit))

    return call


def _indenter(*names: str) -> Call:
    def call(given: Path, out: Path) -> None:
        for name in names:
            parse_indenter(f"mesh:{given / name}").contact(0.5)

    return call


def _robot(name: str) -> Call:
    return lambda given, out: _run(RobotShow(str(given / name), json=True))


def _kept(given: Path, out: Path) -> None:
    os.environ[CACHE_VARIABLE] = str(given)
    results.kept_file().read_or_make(lambda: {"a": np.arange(4.0)})


def _replace_output(given: Path, out: Path) -> None:
    with atomic_directory(given / "earlier") as folder:
        (folder / "press.json").write_text("{}")


READERS: dict[str, Reader] = {
    "profile": Reader(profiles.whole, _show_profile, seal=profiles.seal),
    "profile-old": Reader(profiles.old, _show_profile, seal=profiles.seal),
    "profile-views": Reader(
        profiles.with_views,
        _show_profile,
        ("*/views/*", "*/profile.toml"),
        seal=profiles.seal_views,
    ),
    "depth": Reader(profiles.with_pictures, _read_depth, ("*.png",)),
    "read": Reader(profiles.with_pictures, _read_recorded, ("*.png",)),
    "force": Reader(
        profiles.with_force,
        _show_profile,
        ("*/force_model.safetensors", "*/force_model.safetensors", "*/profile.toml"),
        seal=profiles.seal,
    ),
    "captures": Reader(captures.whole, _load_captures, ("*.toml",)),
    "images": Reader(captures.presses, _load_captures, ("*.png", "*.jpg")),
    "records": Reader(captures.records, _load_captures, ("*.csv",)),
    "videos": Reader(captures.videos, _load_captures, ("*.avi", "*.csv")),
    "contacts": Reader(captures.presses, _load_captures, ("contacts.toml",)),
    "capture-check": Reader(captures.presses, _check(json=True)),
    "check-draft": Reader(layouts.plain_with_mask, _check(json=False)),
    "capture-rectify": Reader(captures.raw_with_maps, _rectify, ("maps.npz", "maps.npz", "raw/*")),
    "rectification": Reader(captures.raw_with_maps, _rectify, ("maps.npz",)),
    **{f"import-{name}": Reader(layouts.maker(name), _importer("auto")) for name in layouts.NAMES},
    "import-as-plain": Reader(layouts.plain_with_mask, _importer("plain", background="bg.png")),
    "import-boards": Reader(layouts.boards, _importer("plain", board="chessboard:6x6:2.5")),
    "import-video": Reader(layouts.video_of_dots, _importer("markers")),
    "taxim-pack": Reader(
        layouts.maker("taxim"), lambda g, _: load_captures(g / "dataPack.npz").presses[0].image()
    ),
    "study-file": Reader(results.study_file, _plan_study, named=("study.toml",)),
    "study-folder": Reader(results.study, _report_study, ("study/*",), own="study"),
    "dataset-file": Reader(touches.file, _plan_dataset, named=("touches.toml",)),
    "dataset-folder": Reader(touches.folder, _check_dataset, own="data"),
    "texture": Reader(
        captures.texture,
        lambda given, out: Texture.from_image(given / "coin.png", 0.05, 2.0).relief_m(),
    ),
    "camera-replay": Reader(captures.frames, _replay),
    "recording-hdf5": Reader(recordings.univtac, _recorded("0.hdf5", "left_tactile/rgb")),
    "recording-lerobot": Reader(recordings.lerobot, _recorded("set")),
    "recording-lerobot-2": Reader(recordings.lerobot_2, _recorded("set")),
    "recording-lerobot-3": Reader(recordings.lerobot_3, _recorded("set")),
    "step-list": Reader(
        shapes.step, lambda given, out: _run(ImportGel(given / "gel.step")), ("gel.step",)
    ),
    "step-import": Reader(shapes.step, _import_step, named=("faces.toml",)),
    "gel-msh": Reader(shapes.tets, _gel("gel.msh")),
    "gel-3mf": Reader(shapes.box_3mf, _gel("gel.3mf")),
    "gel-vtu": Reader(shapes.vtu, _gel("gel.vtu"), ("gel.vtu",)),
    "gel-vtk": Reader(shapes.vtu, _gel("gel.vtk"), ("gel.vtk",)),
    "gel-stl": Reader(shapes.stl, _gel("bytes.stl", "cm")),
    "indenter-stl": Reader(shapes.stl, _indenter("words.stl", "bytes.stl")),
    "indenter-ply": Reader(shapes.ply, _indenter("words.ply", "bytes.ply")),
    "indenter-obj": Reader(shapes.obj, _indenter("box.obj")),
    "robot-urdf": Reader(shapes.urdf, _robot("gripper.urdf"), ("gripper.urdf", "words.stl")),
    "robot-collada": Reader(shapes.collada, _robot("gripper.urdf"), ("box.dae", "gripper.urdf")),
    "press-folder": Reader(results.press, _read_press),
    "training": Reader(
        results.training, lambda given, out: TrainingFile(given / "training.pt").load("a")
    ),
    "bench-results": Reader(results.bench, _compare_results),
    "task-file": Reader(results.task, lambda given, out: read_task(given / "task.toml")),
    **{
        f"counts-{name}": Reader(make, call, tuple(files), counts=True)
        for name, make, call, *files in (
            ("hdf5", recordings.univtac, _recorded("0.hdf5", "left_tactile/rgb"), "*"),
            ("hdf5-levels", recordings.univtac_packed, _recorded("0.hdf5", "levels"), "*"),
            ("hdf5-streams", recordings.univtac_packed, _recorded("0.hdf5", "tactile/rgb"), "*"),
            ("lerobot", recordings.lerobot, _recorded("set"), "*"),
            ("lerobot-2", recordings.lerobot_2, _recorded("set"), "*"),
            ("lerobot-3", recordings.lerobot_3, _recorded("set"), "*"),
            ("videos", captures.videos, _load_captures, "*.avi"),
            ("images", captures.presses, _load_captures, "*.png", "*.jpg"),
            ("maps", captures.raw_with_maps, _rectify, "maps.npz"),
            ("dataset", touches.folder, _check_dataset, "*"),
            ("3mf", shapes.box_3mf, _gel("gel.3mf"), "*"),
            ("msh", shapes.tets, _gel("gel.msh"), "*"),
            ("vtu", shapes.vtu, _gel("gel.vtu"), "gel.vtu"),
            ("vtk", shapes.vtu, _gel("gel.vtk"), "gel.vtk"),
            ("stl", shapes.stl, _indenter("words.stl", "bytes.stl"), "*"),
            ("ply", shapes.ply, _indenter("words.ply", "bytes.ply"), "*"),
            ("obj", shapes.obj, _indenter("box.obj"), "*"),
            ("collada", shapes.collada, _robot("gripper.urdf"), "box.dae", "gripper.urdf"),
            ("press", results.press, _read_press, "*"),
        )
    },
    "taxim-table": Reader(results.table, lambda given, out: read_table(given / TABLE_FILE)),
    "kept-results": Reader(results.kept, _kept, own="."),
    "earlier-output": Reader(results.output, _replace_output, own="."),
}
"""By name, for ``make explore`` and kept seeds."""
if find_spec("newton") is not None:
    READERS["robot-mjcf"] = Reader(shapes.mjcf, _robot("gripper.xml"))
    if find_spec("pxr") is not None:
        READERS["robot-usd"] = Reader(shapes.usd, _robot("gripper.usda"))
