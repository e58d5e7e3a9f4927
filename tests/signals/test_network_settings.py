# SPDX-License-Identifier: Apache-2.0
"""Settings and weights of the three networks: kept by a dict, refused where no sensor has them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.signals import color_model, force_network, normal_model
from taccel_lab.signals.color_model import ColorModel, ColorModelConfig
from taccel_lab.signals.force_model import ForceModel
from taccel_lab.signals.force_settings import ForceModelConfig
from taccel_lab.signals.network_answers import require_answers
from taccel_lab.signals.normal_model import NormalModel
from taccel_lab.signals.normal_model_config import NormalModelConfig
from taccel_lab.signals.position_encoding import MAX_BANDS

SIZE = {"width_px": 40, "height_px": 30}
COLOR = ColorModelConfig(**SIZE, hidden=(16, 8))
NORMAL = NormalModelConfig(**SIZE, members=3, hidden=(16, 8))
FORCE = ForceModelConfig(**SIZE, columns=4, rows=3, patch_px=4, widths=(3, 5), blocks=2, hidden=6)
GRID = PixelGrid(40, 30, 0.1, 0.12)
Config = ColorModelConfig | NormalModelConfig | ForceModelConfig
Weights = dict[str, np.ndarray]


def weights_of(config: Config, seed: int = 0) -> Weights:
    kinds = {ColorModelConfig: color_model, NormalModelConfig: normal_model}
    shapes = kinds.get(type(config), force_network).expected_shapes(config)
    rng = np.random.default_rng(seed)
    return {n: rng.normal(0, s[-1] ** -0.5, s).astype(np.float32) for n, s in shapes.items()}


@pytest.mark.parametrize(
    "config",
    [
        COLOR,
        dataclasses.replace(COLOR, position_bands=3),
        NORMAL,
        NormalModelConfig(**SIZE, position_bands=2),
        NormalModelConfig(
            48, 36, members=2, hidden=(8,), input_mean=(1.0,) * 23, input_scale=(2.0,) * 23,
            light_drift=True,
        ),
        FORCE,
    ],
)  # fmt: skip
def test_settings_go_through_a_dict_and_refuse_other_keys(config: Config) -> None:
    kind, values = type(config), config.to_dict()
    assert kind.from_dict(values) == config
    with pytest.raises(InputError, match=r"unknown.*gamma"):
        kind.from_dict({**values, "gamma": 2})
    with pytest.raises(InputError, match="wrong type"):
        kind.from_dict({**values, "hidden": ["many"]})
    with pytest.raises(InputError, match=r"missing.*hidden"):
        kind.from_dict({name: value for name, value in values.items() if name != "hidden"})


@pytest.mark.parametrize(
    ("config", "changes", "message"),
    [
        (COLOR, {"inputs": ("u", "shade")}, "inputs"),
        (COLOR, {"inputs": ()}, "inputs"),
        (COLOR, {"activation": "sine"}, "silu, tanh, relu"),
        (COLOR, {"hidden": (0,)}, "hidden"),
        (COLOR, {"width_px": 1}, "1x30 px"),
        (COLOR, {"input_mean": (0.0,)}, "input_mean needs 6"),
        (COLOR, {"input_mean": (math.nan,) * 6}, "input_mean needs 6 finite"),
        (COLOR, {"input_scale": (0.0,) * 6}, "positive"),
        (COLOR, {"position_bands": -1}, r"color model position_bands must lie in 0\.\.8"),
        (NORMAL, {"position_bands": MAX_BANDS + 1}, r"normal model position_bands must lie in"),
        (NORMAL, {"input_mean": (0.0,)}, "finite numbers, one per feature"),
        (NORMAL, {"members": 0}, "at least 1"),
        (FORCE, {"patch_px": 8}, "patch_px must be 4"),
        (FORCE, {"rows": 0}, "sizes"),
        (FORCE, {"widths": (3, 0)}, "widths"),
        (FORCE, {"most": (1.0, 2.0)}, "most needs 4"),
        (FORCE, {"sigma_factor": (0.0,) * 7}, "sigma_factor"),
        (FORCE, {"young_modulus_pa": 0.0}, "young_modulus_pa"),
        (FORCE, {"rows": 2000, "columns": 2000}, "patches"),
        # No gel is that large, that stiff or pressed that hard.
        (FORCE, {"target_scale": (1000.0, 1, 1, 1, 1, 1, 1)}, "force model.* target_scale"),
        (FORCE, {"target_scale": (1, 1, 1, 1, 1, 1, 1e5)}, "force model.* target_scale"),
        (FORCE, {"patch_scale_n": (1, 1, 1e-5)}, "force model.* patch_scale_n"),
        (FORCE, {"sigma_factor": (1, 1e3, 1, 1, 1, 1, 1)}, "force model.* sigma_factor"),
        (FORCE, {"most": (5e3, 1, 1, 1)}, "force model.* largest force"),
    ],
)
def test_settings_of_no_sensor_are_refused(
    config: Config, changes: dict[str, object], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        dataclasses.replace(config, **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("make", "config", "name", "value", "message"),
    [
        (ColorModel, COLOR, "layer1.bias", None, "weights have shapes"),
        (ColorModel, COLOR, "layer1.bias", np.full(8, np.nan), "NaN"),
        (ColorModel, COLOR, "layer0.weight", np.zeros((16, 18)), "weights have shapes"),
        (NormalModel, NORMAL, "layer0.weight", np.zeros((1, 2)), "expected"),
        (ForceModel, FORCE, "down0.weight", np.zeros((3, 4, 3, 3)), "down0.weight"),
        (ForceModel, FORCE, "extra", np.zeros(2), "extra"),
        (ForceModel, FORCE, "hidden.bias", np.full(6, np.nan), "NaN"),
    ],
)
def test_weights_that_do_not_fit_are_refused(
    make: Callable, config: Config, name: str, value: np.ndarray | None, message: str
) -> None:
    changed = weights_of(config) | {name: value}
    if value is None:
        del changed[name]
    with pytest.raises(InputError, match=message):
        make(config, changed, *([GRID] if make is ForceModel else []))


def scaled(weights: Weights, factor: float) -> Weights:
    """With the last of three layers multiplied."""
    factors = {name: factor if name.startswith("layer2") else 1 for name in weights}
    return {name: value * np.float32(factors[name]) for name, value in weights.items()}


@pytest.mark.parametrize("seed", range(3))
def test_models_whose_answers_no_sensor_shows_are_refused(seed: int) -> None:
    """As of weights that were scaled, or of another output scale."""
    weights, normal = weights_of(COLOR, seed), weights_of(NORMAL, seed)
    ColorModel(COLOR, weights).require_levels()
    NormalModel(NORMAL, normal).require_angles()
    for wrong in (
        ColorModel(COLOR, scaled(weights, 100)),
        ColorModel(dataclasses.replace(COLOR, output_scale=3200.0), weights),
        ColorModel(COLOR, scaled(weights, 1e38)),
    ):
        with pytest.raises(InputError, match=r"color model answers up to .* levels, but a picture"):
            wrong.require_levels()
    with pytest.raises(InputError, match=r"normal model answers up to .* degrees, but a tilt has"):
        NormalModel(NORMAL, scaled(normal, 100)).require_angles()
    require_answers("it", np.full(100, 1.0), 2.0, "N", "more is none")
    with pytest.raises(InputError, match="it answers up to inf N, but more is none"):
        require_answers("it", np.full(100, np.nan), 2.0, "N", "more is none")
