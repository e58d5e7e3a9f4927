# SPDX-License-Identifier: Apache-2.0
"""Robots from MJCF and USD files, by newton's readers, in the readers' process.

What such a file names lies in its own folder: no absolute path, no ``..`` and no link leads out.
"""

from __future__ import annotations

import os
import pickle
import tempfile
import warnings
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from taccel_lab.bodies.joints import JointKind
from taccel_lab.errors import InputError, naming
from taccel_lab.files.apart import cpu_s_of, read_apart
from taccel_lab.files.regular_file import require_regular_file
from taccel_lab.newton_bridge.importing import import_model
from taccel_lab.newton_bridge.mjcf_file import whole_mjcf
from taccel_lab.newton_bridge.newton_model import NOT_INSTALLED, newton_module
from taccel_lab.newton_bridge.usd_layers import LAYERS, MAX_BYTES, PACKAGE, checked_layers, unpacked
from taccel_lab.printable import words_of
from taccel_lab.processes.child_process import allow_cpu
from taccel_lab.robots import Robot
from taccel_lab.robots.description import Link, LinkMass, Mimic, RobotJoint
from taccel_lab.robots.shapes import CollisionShape, PrimitiveShape, SurfaceShape
from taccel_lab.scene import TriangleMesh

_RECORDS = (
    CollisionShape, JointKind, Link, LinkMass, Mimic, PrimitiveShape, Robot, RobotJoint,
    SurfaceShape, TriangleMesh,
)  # fmt: skip
"""Classes that a robot of newton's is made of."""
_START_BYTES = 10 << 20
"""Bytes of a file that take as long as to load newton and to compile its kernels."""
_BY_CLASS = {"collider_classes", "ignore_classes", "no_class_as_colliders", "visual_classes"}
"""Options of newton's that go by names of classes, which its text has not."""
USD_SUFFIXES = (*LAYERS, PACKAGE)


def load_mjcf(path: Path | str, **options: Any) -> Robot:
    """A robot from a MuJoCo XML file, read by newton.

    Args:
        path: The file. What it includes and its meshes, STL, OBJ or MSH, lie in its folder or below
            it; textures and materials are not read.
        options: Of ``newton.ModelBuilder.add_mjcf``, such as ``floating=False``.

    Raises:
        InputError: As ``import_model``, for a file with anything beside one robot, and for one that
            names a file elsewhere.
    """
    path = Path(path)
    with tempfile.TemporaryDirectory() as scratch, naming(path):
        _require_newton(options)
        if told := _BY_CLASS.intersection(options):
            raise InputError(
                f"{min(told)} is not taken: contype and conaffinity say which geoms touch"
            )
        fixed = any(options.get(name) is not None for name in ("floating", "base_joint"))
        text, size = whole_mjcf(path, Path(scratch), fixed)
        options = {"parse_visuals": False, **options}
        return _apart(path, _of_mjcf, text, options, "newton", size)


def load_usd(path: Path | str, **options: Any) -> Robot:
    """A robot from a USD file, read by newton and usd-core; as ``load_mjcf``.

    Args:
        path: The file, ``.usd``, ``.usda``, ``.usdc`` or ``.usdz``. Layers and all else that it
            names lie in its folder or below it.
        options: Of ``newton.ModelBuilder.add_usd``, such as ``floating=False``.
    """
    path = Path(path)
    with tempfile.TemporaryDirectory() as scratch, naming(path):
        _require_newton(options)
        require_regular_file(path, MAX_BYTES, "a USD file")
        if path.suffix.lower() not in USD_SUFFIXES:
            raise InputError(f"{path} is no USD file; these end in {', '.join(USD_SUFFIXES)}")
        package = path.suffix.lower() == PACKAGE
        layer = (unpacked(path, Path(scratch)) if package else path).absolute()
        try:
            options = {"load_visual_shapes": False, **options}
            return _apart(path, _of_usd, layer, options, "pxr", layer.stat().st_size)
        except InputError as error:  # Who named a package knows no other folder.
            raise InputError(str(error).replace(scratch, str(path))) from None


def _require_newton(options: dict[str, Any]) -> None:
    if find_spec("newton") is None:
        raise InputError(NOT_INSTALLED)
    if "path_resolver" in options:
        raise InputError("path_resolver is not taken: a robot's files lie in its own folder")
    try:
        pickle.dumps(options)
    except Exception:
        raise InputError("options of newton's readers must be plain values") from None


def _apart(
    path: Path, read: Callable[..., Robot], source: Any, options: dict[str, Any], by: str, size: int
) -> Robot:
    return read_apart(
        str(path), read, source, path.stem, options, by=by, pool="newton",
        records=lambda: _RECORDS, size=size + _START_BYTES,
    )  # fmt: skip


def _of_mjcf(text: str, name: str, options: dict[str, Any]) -> Robot:
    """The robot of an MJCF text; runs in the readers' process."""
    _leave_no_traces()
    return _robot("add_mjcf", text, name, options)


def _of_usd(layer: Path, name: str, options: dict[str, Any]) -> Robot:
    """The robot of a USD file; runs in the readers' process."""
    _leave_no_traces()
    try:
        layers = checked_layers(layer)
    except ImportError as error:
        raise InputError(f"newton needs another package to read it: {words_of(error)}") from None
    size = sum(os.stat(layer.realPath).st_size for layer in layers)
    allow_cpu(cpu_s_of(size + _START_BYTES))
    robot = _robot("add_usd", str(layer), name, options)
    del layers  # Until now: they are not read twice.
    return robot


def _leave_no_traces() -> None:
    """USD, which newton loads, keeps where a fatal error of it would leave a file with the stack of
    this process: nowhere."""
    os.environ["TMPDIR"] = os.devnull


def _robot(reader: str, source: str, name: str, options: dict[str, Any]) -> Robot:
    """The one robot that a reader of newton finds."""
    newton = newton_module()
    builder = newton.ModelBuilder()
    with warnings.catch_warnings():
        # Of what it leaves out, or takes otherwise than it stands.
        warnings.simplefilter("error", newton.NewtonWarning)
        try:
            _added(builder, reader, source, options)
            scene = import_model(builder, name=name)
        except newton.NewtonWarning as warning:
            words = words_of(warning)
            raise InputError(f"newton does not take it as it stands: {words}") from None
    others = [body.name for body in (*scene.affine_bodies, *scene.soft_bodies, *scene.planes)]
    if scene.robot is None or others:
        raise InputError(
            f"it holds {'no robot' if scene.robot is None else 'more than a robot'}"
            + (f": {', '.join(others)}; import_model takes these" if others else "")
        )
    return scene.robot


def _added(builder: Any, reader: str, source: str, options: dict[str, Any]) -> None:
    try:
        getattr(builder, reader)(source, **options)
    except (MemoryError, UserWarning):
        raise
    except ImportError as error:
        raise InputError(f"newton needs another package to read it: {words_of(error)}") from None
    except Exception as error:
        raise InputError(f"newton cannot read it: {words_of(error)}") from error
