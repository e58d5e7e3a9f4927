# SPDX-License-Identifier: Apache-2.0
"""The force model of a profile as an ONNX graph: averaging over pixels, network, scales, range."""

from __future__ import annotations

from typing import Any

import numpy as np

from taccel_lab.exporters.onnx_graph import Graph
from taccel_lab.networks.force_settings import (
    LEVELS,
    LOG_SIGMA,
    MARKER_PLANES,
    MARKER_UNIT_MM,
    STD_FLOOR,
    TARGETS,
    color_directions,
)
from taccel_lab.profile import SensorProfile
from taccel_lab.signals.force_model import ForceModel
from taccel_lab.signals.force_network import area_matrix

CHECKED = 3
"""Images that the graph is compared on."""


def force_graph(
    profile: SensorProfile,
) -> tuple[Any, dict[str, np.ndarray], dict[str, np.ndarray], dict[str, object]]:
    """The graph, inputs to compare it on, what its model makes of them, and its description."""
    model = ForceModel.from_profile(profile)
    proto = _graph(model)
    feeds, expected = _comparison(model)
    config = model.config
    described: dict[str, object] = {
        "file": "force_model.onnx",
        "change": "image minus background, levels of 255, RGB planes",
        "targets": list(TARGETS),
        "patch_centers_mm": model.centers_mm.tolist(),
        "fz_n_shear_n_area_mm2_patch_n_of_the_training": list(config.most),
        "young_modulus_pa": config.young_modulus_pa,
    }
    if config.markers:
        described["markers"] = (
            f"means of the markers' motion over {MARKER_UNIT_MM} mm about each patch (x, y), with "
            f"weights w = exp(-(distance / {config.marker_reach_mm} mm)^2 / 2) over their sum + "
            "0.1, and sum w / (sum w + 1)"
        )
    return proto, feeds, expected, described


def _graph(model: ForceModel) -> Any:
    config, weights, graph = model.config, model.weights, Graph()
    height, width = config.input_px

    def layer(x: str, name: str, **attributes: Any) -> str:
        w, b = graph.constant(weights[f"{name}.weight"]), graph.constant(weights[f"{name}.bias"])
        return graph.add("Conv", x, w, b, **attributes)

    def square_mean(x: str, axes: list[int]) -> str:
        return graph.add("ReduceMean", graph.add("Mul", x, x), axes=axes, keepdims=0)

    left = graph.constant(area_matrix(config.height_px, height))
    right = graph.constant(area_matrix(config.width_px, width).T.copy())
    levels = graph.add("MatMul", graph.add("MatMul", left, "change"), right)
    change = graph.add("Div", levels, graph.constant(LEVELS))

    # The place is the same in every image: what the first layer makes of it is a constant.
    first = weights["down0.weight"]
    padded: dict[str, Any] = {"pads": [1, 1, 1, 1]}
    v, u = np.meshgrid(np.linspace(-1, 1, height), np.linspace(-1, 1, width), indexing="ij")
    place = graph.constant(np.stack([u, v])[None])
    x = graph.add("Conv", change, graph.constant(first[:, :3]), strides=[2, 2], **padded)
    bias = graph.constant(weights["down0.bias"])
    of_place = graph.add(
        "Conv", place, graph.constant(first[:, 3:]), bias, strides=[2, 2], **padded
    )
    x = graph.activation("silu", graph.add("Add", x, of_place))
    for k in range(1, len(config.widths)):
        x = graph.activation("silu", layer(x, f"down{k}", strides=[2, 2], **padded))
    for k in range(config.blocks):
        seen = graph.add("Concat", x, "markers", axis=1) if config.markers and not k else x
        x = graph.add("Add", x, graph.activation("silu", layer(seen, f"block{k}", **padded)))

    scale = np.array(config.target_scale)
    channels = [graph.constant(np.array(r), np.int64) for r in ([0, 1, 2], [3])]
    by_patch = layer(x, "patch")
    patch_scale = np.array(config.patch_scale_n)[:, None, None] * model.stiffness
    patches = graph.add("Gather", by_patch, channels[0], axis=1)
    patches = graph.add("Mul", patches, graph.constant(patch_scale), output="patch_forces_n")
    over_patches = graph.constant(np.array([2, 3]), np.int64)
    force = graph.add("ReduceSum", patches, over_patches, keepdims=0, output="force_n")
    soft = graph.add("Softplus", graph.add("Gather", by_patch, channels[1], axis=1))
    area = graph.add("ReduceSum", soft, over_patches, keepdims=0)
    area = graph.add("Mul", area, graph.constant(scale[6]))
    pooled = graph.add(
        "Concat",
        graph.add("ReduceMean", x, axes=[2, 3], keepdims=0),
        graph.add("ReduceMax", x, axes=[2, 3], keepdims=0),
        axis=1,
    )

    def linear(x: str, name: str) -> str:
        w, b = graph.constant(weights[f"{name}.weight"]), graph.constant(weights[f"{name}.bias"])
        return graph.add("Gemm", x, w, b, transB=1)

    features = graph.activation("silu", linear(pooled, "hidden"))
    rest = linear(features, "rest")
    parts = []
    x_mm, y_mm = model.centers_mm[..., 0], model.centers_mm[..., 1]
    for arm in (y_mm, x_mm):
        weighted = graph.add("Mul", patches, graph.constant(arm))
        parts.append(graph.add("ReduceSum", weighted, over_patches, keepdims=0))
    # (y F, x F) to the moment: Tx = y Fz, Ty = -x Fz, Tz = x Fy - y Fx.
    arms = np.zeros((6, 3))
    arms[2, 0], arms[5, 1], arms[4, 2], arms[0, 2] = 1, -1, 1, -1
    moment = graph.add("MatMul", graph.add("Concat", *parts, axis=1), graph.constant(arms))
    more = graph.add("Gather", rest, graph.constant(np.arange(3), np.int64), axis=1)
    more = graph.add("Mul", more, graph.constant(scale[3:6] * model.stiffness))
    moment = graph.add("Add", moment, more, output="moment_nmm")
    area = graph.add("Reshape", area, graph.constant(np.array([-1, 1]), np.int64))
    graph.add("Identity", area, output="area_mm2")

    ends = [graph.constant(value) for value in LOG_SIGMA]
    sigma = graph.add("Gather", rest, graph.constant(np.arange(3, 10), np.int64), axis=1)
    sigma = graph.add("Exp", graph.add("Clip", sigma, *ends))
    factors = scale * config.sigma_factor
    factors[:6] *= model.stiffness
    sigma = graph.add("Mul", sigma, graph.constant(factors))
    stiff = np.array([config.stiffness_relative] * 6 + [0.0])
    unsure = graph.add("Concat", force, moment, area, axis=1)
    unsure = graph.add("Mul", unsure, graph.constant(stiff))
    squares = [graph.add("Mul", one, one) for one in (sigma, unsure)]
    graph.add("Sqrt", graph.add("Add", *squares), output="sigma")

    # Statistics of the change, as ``image_statistics``.
    mean = graph.add("ReduceMean", levels, axes=[2, 3], keepdims=1)
    away = graph.add("Sub", levels, mean)
    std = graph.add("Sqrt", square_mean(away, [2, 3]))
    kernel = np.zeros((3, 1, 3, 3))
    kernel[:, 0, [0, 1, 1, 2], [1, 0, 2, 1]] = -0.25
    kernel[:, 0, 1, 1] = 1.0
    rough = graph.add("Sqrt", square_mean(graph.add(
        "Conv", levels, graph.constant(kernel), group=3), [2, 3]))  # fmt: skip
    floor = graph.constant(STD_FLOOR)

    def pairs(x: str, which: list[int]) -> str:
        return graph.add("Gather", x, graph.constant(np.array(which), np.int64), axis=1)

    both = graph.add("Mul", pairs(away, [0, 0, 1]), pairs(away, [1, 2, 2]))
    both = graph.add("ReduceMean", both, axes=[2, 3], keepdims=0)
    product = graph.add("Mul", pairs(std, [0, 0, 1]), pairs(std, [1, 2, 2]))
    together = graph.add("Div", both, graph.add("Add", product, graph.constant(STD_FLOOR**2)))
    largest = graph.add("ReduceMax", graph.add("Abs", away), axes=[1, 2, 3], keepdims=0)
    largest = graph.add("Reshape", largest, graph.constant(np.array([-1, 1]), np.int64))
    statistics = graph.add(
        "Concat",
        graph.add("Reshape", mean, graph.constant(np.array([-1, 3]), np.int64)),
        graph.add("Log", graph.add("Add", std, floor)),
        graph.add("Log", graph.add("Add", rough, floor)),
        together,
        graph.add("Log", graph.add("Add", largest, floor)),
        axis=1,
    )
    found = []
    for name, values, limit in zip(
        ("features", "statistics"), (features, statistics), config.distance_limits, strict=False
    ):
        off = graph.add("Sub", values, graph.constant(weights[f"{name}.mean"]))
        white = graph.add("MatMul", off, graph.constant(weights[f"{name}.whiten"].T.copy()))
        distance = graph.add("Sqrt", graph.add(
            "ReduceMean", graph.add("Mul", white, white), axes=[1], keepdims=1))  # fmt: skip
        found.append(graph.add("Div", distance, graph.constant(limit)))
    # Colours, as ``color_reach``.
    mean = graph.add("AveragePool", levels, kernel_shape=[3, 3])
    directions = graph.constant(color_directions()[:, :, None, None])
    reach = graph.add("ReduceMax", graph.add("Conv", mean, directions), axes=[2, 3], keepdims=0)
    most = weights["colors.most"] * np.float32(config.distance_limits[2])
    reach = graph.add("Div", reach, graph.constant(most))
    found.append(graph.add("ReduceMax", reach, axes=[1], keepdims=1))
    graph.add("Concat", *found, axis=1, output="distances")

    inputs: dict[str, list] = {"change": ["n", 3, config.height_px, config.width_px]}
    if config.markers:
        inputs["markers"] = ["n", MARKER_PLANES, config.rows, config.columns]
    outputs: dict[str, list] = {
        "force_n": ["n", 3],
        "moment_nmm": ["n", 3],
        "area_mm2": ["n", 1],
        "sigma": ["n", len(TARGETS)],
        "patch_forces_n": ["n", 3, config.rows, config.columns],
        "distances": ["n", 3],
    }
    return graph.model("force_model", inputs, outputs)


def _comparison(
    model: ForceModel,
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Changes of colour, smooth and rough, and what the model tells of them."""
    config, rng = model.config, np.random.default_rng(0)
    size = (CHECKED, config.height_px, config.width_px, 3)
    changes = (rng.normal(0, 20, size) + 40 * rng.random((CHECKED, 1, 1, 3))).astype(np.float32)
    planes = rng.normal(0, 0.5, (CHECKED, MARKER_PLANES, config.rows, config.columns))
    planes = planes.astype(np.float32)
    empty = np.zeros(size[1:], dtype=np.float32)
    found = [
        model.read(change, empty, planes=plane if config.markers else None)
        for change, plane in zip(changes, planes, strict=True)
    ]
    feeds = {"change": np.ascontiguousarray(changes.transpose(0, 3, 1, 2))}
    if config.markers:
        feeds["markers"] = planes
    return feeds, {
        "force_n": np.stack([one.force_n for one in found]),
        "moment_nmm": np.stack([one.moment_nmm for one in found]),
        "area_mm2": np.array([[one.area_mm2] for one in found]),
        "sigma": np.stack([one.sigma for one in found]),
        "patch_forces_n": np.stack([one.patch_forces_n.transpose(2, 0, 1) for one in found]),
        "distances": np.stack([one.distances for one in found]),
    }
