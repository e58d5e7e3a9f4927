# SPDX-License-Identifier: Apache-2.0
"""The networks of a profile as files that stand alone: safetensors, and ONNX graphs.

safetensors files hold weights and settings; ``models.json`` beside them has the formula. The graphs
have all scaling inside: ``color_model.onnx`` maps pixel, normals and displacement to the change of
colour, ``normal_model.onnx`` the features of pixels to tilts and their expected error,
``force_model.onnx`` images to forces. torch traces each; ONNX's own reference evaluator runs the
graph, and what it answers is compared with the profile's model before the graph is written.
"""

from __future__ import annotations

import json
import math
import tempfile
import warnings
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.exporters.record import MAKERS, ExportRecord
from taccel_lab.files.atomic_file import write_by, write_json
from taccel_lab.networks.color_settings import UPRIGHT_DEG
from taccel_lab.networks.force_settings import LEVELS, MARKER_PLANES, MARKER_UNIT_MM, TARGETS
from taccel_lab.networks.normal_settings import ensemble_of
from taccel_lab.profile import ColorBlock, ForceBlock, NormalsBlock, SensorProfile
from taccel_lab.reading import network_answers
from taccel_lab.reading.slopes import NormalModel
from taccel_lab.signals import color_model, force_network
from taccel_lab.signals.color_model import ColorModel
from taccel_lab.signals.force_model import ForceModel
from taccel_lab.signals.tensors import layer_tensors

if TYPE_CHECKING:
    from torch import Tensor

Network = tuple[ColorBlock | NormalsBlock | ForceBlock, Mapping[str, np.ndarray]]

COLOR_FORMULA = (
    "x = (inputs - input_mean) / input_scale, inputs in the order of `inputs`; u = 2 column / "
    "(width_px - 1) - 1, v = 2 row / (height_px - 1) - 1; normal: outward unit normal in the gel "
    "frame, turned back to a tilt of cone_deg where it leans further; displacement_mm: rise of the "
    "face over rest. After them, for k = 0 .. position_bands - 1: sin(2^k pi u), sin(2^k pi v), "
    "cos(2^k pi u), cos(2^k pi v), as they are. Each layer: x = activation(weight x + bias), the "
    "last without activation. change [levels of 255, RGB] = output_scale (f(pressed) - f(at "
    "rest)), at rest being the same pixel with its resting normal and displacement 0."
)
NORMAL_FORMULA = (
    "x = (features - input_mean) / input_scale, features in the order of `features`, of which "
    "sin_u_k is sin(2^k pi u); each member: x = silu(weight x + bias), the last layer without. "
    "tilt [rad] = the mean over the members of the first two outputs, minus the same for the pixel "
    "without change of colour; expected angle of error [rad] = sqrt((error_factor mean(exp(clip("
    "third output, -12, 2)) + 3.5e-4))^2 + spread of the members' tilts^2); 95 % of the errors lie "
    "below radius95_sigmas / sqrt(pi / 2) times that. The tilt turns the resting normal, leaning "
    "towards it. small.*, where there is one: a network that reads first. It gives that tilt, the "
    "logarithm of that error, and that of what the tilt is off the ensemble's; squares of both add "
    "up. The ensemble reads where the latter is more than half of the former."
)


FORCE_FORMULA = (
    "x = (image - background) / 32 levels, averaged over rows patch_px x columns patch_px equal "
    "parts, with planes u and v from -1 to 1; down<k>: x = silu(conv 3x3, stride 2, padding 1); "
    "block<k>: x = x + silu(conv 3x3, padding 1), block0 with three planes of markers, too, where "
    "markers is true; patch: 1x1, force by patch [N] = first three channels times patch_scale_n, "
    "area = sum of softplus of the fourth times target_scale[6]; hidden: features = silu(linear of "
    "means and maxima over patches); rest: linear of these, three corrections of the moment about "
    "the gel's origin [N mm] times target_scale[3:6], and logarithms of standard deviations over "
    "target_scale, clipped to -7..3, times sigma_factor. Forces and moments are for "
    "young_modulus_pa and proportional to it."
)
FORMULAS = {"color": COLOR_FORMULA, "normals": NORMAL_FORMULA, "force": FORCE_FORMULA}


def networks(profile: SensorProfile) -> dict[str, Network]:
    """Block and weights of each network that the profile has, by key; InputError when none."""
    found: dict[str, Network] = {}
    if profile.color is not None and profile.color_weights is not None:
        found["color"] = (profile.color, profile.color_weights)
    if profile.normals is not None and profile.normal_weights is not None:
        found["normals"] = (profile.normals, profile.normal_weights)
    if profile.force is not None and profile.force_weights is not None:
        found["force"] = (profile.force, profile.force_weights)
    if not found:
        raise InputError(
            f"the profile of {profile.sensor.name!r} has none of the blocks color, normals and "
            f"force, whose networks are exported; made by {MAKERS['color']}, {MAKERS['normals']}, "
            f"{MAKERS['force']}"
        )
    return found


def export_safetensors(profile: SensorProfile, folder: Path) -> ExportRecord:
    """Write the networks' safetensors files and ``models.json``."""
    from safetensors.numpy import save

    record = ExportRecord(
        notes=[
            "the header's metadata holds the settings as JSON (key architecture); models.json "
            "has them with the formula",
        ]
    )
    described: dict[str, dict[str, object]] = {}
    for key, (block, weights) in networks(profile).items():
        settings, name = block.architecture, block.file
        metadata = {
            "kind": key,
            "sensor": profile.sensor.name,
            "architecture": json.dumps(settings, sort_keys=True),
        }
        tensors = {item: np.ascontiguousarray(weights[item]) for item in sorted(weights)}
        (folder / name).write_bytes(save(tensors, metadata=metadata))
        described[key] = {
            "file": name,
            "architecture": settings,
            "formula": FORMULAS[key],
            "shapes": {item: list(tensor.shape) for item, tensor in tensors.items()},
        }
        colors = ColorModel.from_profile(profile) if key == "color" else None
        if colors is not None:
            described[key]["cone_deg"] = colors.cone_deg
        record.carries[key] = "all weights, unchanged"
    write_json(folder / "models.json", described)
    record.leave_out_missing(profile, "color", "normals", "force")
    if profile.background_rgb is not None:
        background = {"rgb": profile.background_rgb}
        write_by(folder / "background.npz", partial(np.savez_compressed, **background))
        record.carries["background"] = "as background.npz, unchanged"
    return record


OPSET = 17
CHECKED, CHECKED_IMAGES = 512, 3
LARGEST_DIFFERENCE = 1e-3
"""Largest difference of a graph from its model, relative to the model's largest output: rounding is
far below."""


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
        answer, feeds, expected, described[key] = _MAKERS[key](profile)
        graph = _graph(answer, feeds, expected)
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


def _graph(
    answer: Callable[..., Any], feeds: Mapping[str, np.ndarray], outputs: Mapping[str, np.ndarray]
) -> Any:
    """What ``answer`` does to tensors like ``feeds``, of any number of rows, as a checked graph."""
    import onnx
    import torch

    class Traced(torch.nn.Module):
        def forward(self, *tensors: Tensor) -> Any:
            return answer(*tensors)

    with tempfile.TemporaryDirectory() as folder, torch.no_grad(), warnings.catch_warnings():
        # The exporter that torch prefers needs onnxscript, and this one warns of that. It warns of
        # constants, too, and all are: sizes but that of the batch, settings, weights.
        warnings.simplefilter("ignore")
        file = Path(folder) / "graph.onnx"
        torch.onnx.export(
            Traced(),
            tuple(torch.from_numpy(value) for value in feeds.values()),
            file,
            input_names=list(feeds),
            output_names=list(outputs),
            dynamic_axes={name: {0: "n"} for name in (*feeds, *outputs)},
            opset_version=OPSET,
            dynamo=False,
        )
        graph = onnx.load(file)
    onnx.checker.check_model(graph, full_check=True)
    return graph


Made = tuple[Callable[..., Any], dict[str, np.ndarray], dict[str, np.ndarray], dict[str, object]]
"""What a graph answers, inputs to compare it on, what the model makes of them, and what
``models.json`` says of it."""


def _color(profile: SensorProfile) -> Made:
    import torch

    model = ColorModel.from_profile(profile)
    assert model is not None
    config = model.config
    layers = layer_tensors(model.weights)
    mean, scale = torch.tensor(config.input_mean), torch.tensor(config.input_scale)
    cone = math.radians(model.cone_deg)

    def inputs(u: Tensor, v: Tensor, normal: Tensor, displacement: Tensor) -> Tensor:
        x, y, z = normal.unbind(dim=1)
        if model.cone_deg < UPRIGHT_DEG:
            across = (x.square() + y.square()).sqrt().clamp(min=math.sin(cone))
            x, y = math.sin(cone) / across * x, math.sin(cone) / across * y
            z = z.clamp(min=math.cos(cone))
        columns = {
            "u": u, "v": v, "normal_x": x, "normal_y": y, "normal_z": z,
            "displacement_mm": displacement,
        }  # fmt: skip
        parts = [(torch.stack([columns[name] for name in config.inputs], dim=1) - mean) / scale]
        place = torch.stack([u, v], dim=1)
        for k in range(config.position_bands):
            angle = (2.0**k * math.pi) * place
            parts += [angle.sin(), angle.cos()]
        return torch.cat(parts, dim=1)

    def answer(u: Tensor, v: Tensor, normal: Tensor, rest: Tensor, displacement: Tensor) -> Tensor:
        u, v = 2 / (config.width_px - 1) * u - 1, 2 / (config.height_px - 1) * v - 1
        pressed = inputs(u, v, normal, displacement)
        at_rest = inputs(u, v, rest, torch.zeros_like(displacement))
        return color_model.color_change(config, layers, pressed, at_rest)

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
    return answer, feeds, expected, {"file": _file("color"), "inputs": sorted(feeds)}


def _normals(profile: SensorProfile) -> Made:
    import torch

    model = NormalModel.from_profile(profile)
    config = model.config
    layers = layer_tensors(ensemble_of(model.weights))
    mean, scale = torch.tensor(config.input_mean), torch.tensor(config.input_scale)
    # What at_rest() leaves of the features is the same selection in every pixel.
    kept = config.at_rest(np.ones((1, config.input_count), dtype=np.float32))

    def answer(features: Tensor) -> tuple[Tensor, Tensor]:
        seen = [
            ((values - mean) / scale).expand(config.members, -1, -1)
            for values in (features, features * torch.from_numpy(kept))
        ]
        tilts, errors = network_answers.tilt_and_error(layers, *seen)
        tilt = tilts.mean(dim=0)
        spread2 = (tilts - tilt).square().sum(dim=-1).mean(dim=0)
        own = config.error_factor * errors.mean(dim=0)
        return tilt, (own.square() + spread2).sqrt()

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
    return answer, {"features": features}, expected, described


def _force(profile: SensorProfile) -> Made:
    import torch

    model = ForceModel.from_profile(profile)
    config, tensors = model.config, model.tensors
    left, right = (
        torch.from_numpy(force_network.area_matrix(count, wanted))
        for count, wanted in zip((config.height_px, config.width_px), config.input_px, strict=True)
    )
    centers = torch.from_numpy(model.centers_mm.astype(np.float32))
    limits = torch.tensor(config.distance_limits)
    # Forces and moments are scaled to the gel's modulus and share what is not known of it.
    stiff = torch.tensor([model.stiffness] * 6 + [1.0])
    unsure = torch.tensor([config.stiffness_relative] * 6 + [0.0])
    factors = torch.tensor(config.sigma_factor)

    def answer(change: Tensor, markers: Tensor | None = None) -> tuple[Tensor, ...]:
        levels = left @ change @ right.T
        found = force_network.forward(tensors, config, levels / LEVELS, markers, centers)
        targets = found["targets"] * stiff
        sigma = found["sigma"] * factors * stiff
        sigma = (sigma.square() + (unsure * targets).square()).sqrt()
        away = force_network.distances(levels, found["features"], tensors) / limits
        patches = found["patches"] * model.stiffness
        return targets[:, :3], targets[:, 3:6], targets[:, 6:], sigma, patches, away

    feeds, expected = _force_comparison(model)
    described: dict[str, object] = {
        "file": _file("force"),
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
    return answer, feeds, expected, described


def _force_comparison(model: ForceModel) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Changes of colour, smooth and rough, and what the model tells of them."""
    config, rng = model.config, np.random.default_rng(0)
    size = (CHECKED_IMAGES, config.height_px, config.width_px, 3)
    lit = 40 * rng.random((CHECKED_IMAGES, 1, 1, 3))
    changes = (rng.normal(0, 20, size) + lit).astype(np.float32)
    planes = rng.normal(0, 0.5, (CHECKED_IMAGES, MARKER_PLANES, config.rows, config.columns))
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


_MAKERS: dict[str, Callable[[SensorProfile], Made]] = {
    "color": _color,
    "normals": _normals,
    "force": _force,
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
