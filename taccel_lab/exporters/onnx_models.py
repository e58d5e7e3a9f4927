# SPDX-License-Identifier: Apache-2.0
"""The networks of a profile as ONNX graphs, with all scaling inside.

``color_model.onnx`` maps pixel, normals and displacement to the change of colour,
``normal_model.onnx`` the features of pixels to tilts and their expected error, ``force_model.onnx``
(``onnx_force``) images to forces. Each is run through ONNX's own reference evaluator and compared
with the profile's model before it is written.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.exporters.network_files import networks
from taccel_lab.exporters.onnx_force import force_graph
from taccel_lab.exporters.onnx_graph import Graph
from taccel_lab.exporters.record import ExportRecord
from taccel_lab.files.atomic_file import write_json
from taccel_lab.networks.color_settings import UPRIGHT_DEG
from taccel_lab.profile import SensorProfile
from taccel_lab.signals.color_model import ColorModel
from taccel_lab.signals.normal_model import MIN_ERROR_RAD, NormalModel

PEER = "ONNX opset 17 (onnxruntime 1.15 and later)"
CHECKED = 512
LARGEST_DIFFERENCE = 1e-3
"""Of a graph from its model, relative to the model's largest output: rounding is far below."""


def export_onnx(profile: SensorProfile, folder: Path) -> ExportRecord:
    """Write the graphs and ``models.json``; needs a block with a network, and the
    package onnx."""
    _require_onnx()
    record = ExportRecord(
        notes=[
            "color_model: columns and rows as float, outward unit normals in the gel frame, change "
            "in levels of 255 (RGB); add it to the background and clip",
            "force_model: image minus background in levels of 255, [n, 3, height, width]; forces "
            "of the gel on the object and moments about the gel's origin, gel frame, scaled to the "
            "profile's modulus; a distance above 1 is unlike the training",
            "normal_model: raw features of the pixels as models.json lists them; tilt [rad] turns "
            "the resting normal, leaning towards it",
        ]
    )
    described: dict[str, Any] = {}
    for key in networks(profile):
        graph, feeds, expected, described[key] = _MAKERS[key](profile)
        record.approximations[f"{key}_largest_difference"] = _compare(graph, feeds, expected, key)
        (folder / _file(key)).write_bytes(graph.SerializeToString())
        record.carries[key] = "the whole network with its scaling"
    write_json(folder / "models.json", described)
    record.leave_out_missing(profile, "color", "normals", "force")
    if profile.background_rgb is not None:
        record.left_out["background"] = "an image, not a network; see the other formats"
    return record


def _file(key: str) -> str:
    return {"color": "color_model", "normals": "normal_model", "force": "force_model"}[
        key
    ] + ".onnx"


def _require_onnx() -> None:
    try:
        import onnx  # noqa: F401
    except ImportError:
        raise InputError(
            "the onnx export needs the package onnx, which is not installed: "
            "pip install 'taccel-lab[onnx]'"
        ) from None


Made = tuple[Any, dict[str, np.ndarray], dict[str, np.ndarray], dict[str, object]]


def _color(profile: SensorProfile) -> Made:
    model = ColorModel.from_profile(profile)
    assert model is not None
    config = model.config
    graph = Graph()
    column = graph.constant(np.array([-1, 1]), np.int64)

    def scaled(pixels: str, size: int) -> str:
        wide = graph.add("Mul", pixels, graph.constant(2 / (size - 1)))
        return graph.add("Reshape", graph.add("Sub", wide, graph.constant(1.0)), column)

    place = {"u": scaled("u_px", config.width_px), "v": scaled("v_px", config.height_px)}
    encoded = []
    for k in range(config.position_bands):
        angles = [graph.add("Mul", p, graph.constant(2.0**k * np.pi)) for p in place.values()]
        encoded += [graph.add(wave, angle) for wave in ("Sin", "Cos") for angle in angles]
    displacement = graph.add("Reshape", "displacement_mm", column)
    none = graph.add("Mul", displacement, graph.constant(0.0))

    cone = math.radians(model.cone_deg)

    def within_cone(normal: str) -> dict[str, str]:
        x, y, z = (
            graph.add("Gather", normal, graph.constant(np.array([i]), np.int64), axis=1)
            for i in range(3)
        )
        if model.cone_deg < UPRIGHT_DEG:
            across = graph.add("Sqrt", graph.add("Add", *(graph.add("Mul", n, n) for n in (x, y))))
            across = graph.add("Max", across, graph.constant(math.sin(cone)))
            share = graph.add("Div", graph.constant(math.sin(cone)), across)
            x, y = graph.add("Mul", share, x), graph.add("Mul", share, y)
            z = graph.add("Max", z, graph.constant(math.cos(cone)))
        return {"normal_x": x, "normal_y": y, "normal_z": z}

    def network(normal: str, height: str) -> str:
        parts = {**place, "displacement_mm": height, **within_cone(normal)}
        x = graph.add("Concat", *(parts[name] for name in config.inputs), axis=1)
        x = graph.add("Sub", x, graph.constant(np.array(config.input_mean)))
        x = graph.add("Div", x, graph.constant(np.array(config.input_scale)))
        if encoded:
            x = graph.add("Concat", x, *encoded, axis=1)
        last = len(config.layer_sizes()) - 1
        for i in range(last + 1):
            weight, bias = model.weights[f"layer{i}.weight"], model.weights[f"layer{i}.bias"]
            x = graph.add("Gemm", x, graph.constant(weight), graph.constant(bias), transB=1)
            if i < last:
                x = graph.activation(config.activation, x)
        return x

    difference = graph.add("Sub", network("normal", displacement), network("rest_normal", none))
    graph.add("Mul", difference, graph.constant(config.output_scale), output="change_rgb")
    proto = graph.model(
        "color_model",
        {
            "u_px": ["n"],
            "v_px": ["n"],
            "normal": ["n", 3],
            "rest_normal": ["n", 3],
            "displacement_mm": ["n"],
        },
        {"change_rgb": ["n", 3]},
    )
    rng = np.random.default_rng(0)
    idx = rng.integers(0, config.width_px * config.height_px, CHECKED)
    normal, rest = _unit_normals(rng, 1.2), _unit_normals(rng, 0.1)
    height = rng.uniform(-1.5, 0.1, CHECKED).astype(np.float32)
    feeds = {
        "u_px": (idx % config.width_px).astype(np.float32),
        "v_px": (idx // config.width_px).astype(np.float32),
        "normal": normal,
        "rest_normal": rest,
        "displacement_mm": height,
    }
    expected = {"change_rgb": model.predict_pixels(idx, normal, height, rest)}
    return proto, feeds, expected, {"file": _file("color"), "inputs": sorted(feeds)}


def _normals(profile: SensorProfile) -> Made:
    model = NormalModel.from_profile(profile)
    config = model.config
    graph = Graph()
    # What at_rest() leaves of the features is the same selection in every pixel.
    kept = config.at_rest(np.ones((1, config.input_count), dtype=np.float32))[0]

    def network(features: str) -> str:
        x = graph.add("Sub", features, graph.constant(np.array(config.input_mean)))
        x = graph.add("Div", x, graph.constant(np.array(config.input_scale)))
        x = graph.add("Unsqueeze", x, graph.constant(np.array([0]), np.int64))
        for i in range(len(config.layer_sizes())):
            if i:
                x = graph.activation("silu", x)
            weight = np.swapaxes(model.weights[f"layer{i}.weight"], 1, 2)
            x = graph.add("MatMul", x, graph.constant(weight))
            x = graph.add("Add", x, graph.constant(model.weights[f"layer{i}.bias"][:, None]))
        return x

    def outputs(x: str, first: int, end: int) -> str:
        bounds = (graph.constant(np.array([value]), np.int64) for value in (first, end, 2))
        return graph.add("Slice", x, *bounds)

    present = network("features")
    still = network(graph.add("Mul", "features", graph.constant(kept)))
    tilts = graph.add("Sub", outputs(present, 0, 2), outputs(still, 0, 2))
    tilt = graph.add("ReduceMean", tilts, axes=[0], keepdims=0, output="tilt_rad")
    away = graph.add("Sub", tilts, tilt)
    axis = graph.constant(np.array([2]), np.int64)
    squared = graph.add("ReduceSum", graph.add("Mul", away, away), axis, keepdims=0)
    spread = graph.add("ReduceMean", squared, axes=[0], keepdims=0)
    raw = graph.add("Clip", outputs(present, 2, 3), graph.constant(-12.0), graph.constant(2.0))
    own = graph.add("Add", graph.add("Exp", raw), graph.constant(MIN_ERROR_RAD))
    own = graph.add("ReduceMean", own, axes=[0, 2], keepdims=0)
    own = graph.add("Mul", own, graph.constant(config.error_factor))
    total = graph.add("Add", graph.add("Mul", own, own), spread)
    graph.add("Sqrt", total, output="error_rad")
    proto = graph.model(
        "normal_model",
        {"features": ["n", config.input_count]},
        {"tilt_rad": ["n", 2], "error_rad": ["n"]},
    )
    rng = np.random.default_rng(0)
    spreads = rng.normal(size=(CHECKED, config.input_count)) * np.array(config.input_scale)
    features = (spreads + np.array(config.input_mean)).astype(np.float32)
    tilt_rad, error_rad = model.predict_pixels(features)
    described = {
        "file": _file("normals"),
        "features": list(config.features),
        "levels_per_unit": 32.0,
        "scales_px": list(config.scales_px),
        "slope_scales_px": list(config.slope_scales_px),
    }
    expected = {"tilt_rad": tilt_rad, "error_rad": error_rad}
    return proto, {"features": features}, expected, described


_MAKERS: dict[str, Callable[[SensorProfile], Made]] = {
    "color": _color,
    "normals": _normals,
    "force": force_graph,
}


def _unit_normals(rng: np.random.Generator, steep: float) -> np.ndarray:
    slope = rng.normal(0, steep, (CHECKED, 2))
    raw = np.concatenate([slope, np.ones((CHECKED, 1))], axis=1)
    return (raw / np.linalg.norm(raw, axis=1, keepdims=True)).astype(np.float32)


def _compare(
    graph: Any, feeds: dict[str, np.ndarray], expected: dict[str, np.ndarray], key: str
) -> float:
    """Largest difference of the graph's outputs from the model's, over the largest output."""
    from onnx.reference import ReferenceEvaluator

    found = ReferenceEvaluator(graph).run(list(expected), feeds)
    worst = 0.0
    for value, wanted in zip(found, expected.values(), strict=True):
        worst = max(worst, float(np.abs(value - wanted).max() / np.abs(wanted).max()))
    if not worst < LARGEST_DIFFERENCE:
        raise InputError(
            f"the ONNX graph of the {key} block differs from its model by {worst:.2g} of the "
            "largest output; this version's exporter does not know all of its settings"
        )
    return worst
