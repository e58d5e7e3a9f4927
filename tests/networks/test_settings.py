# SPDX-License-Identifier: Apache-2.0
"""Settings and weights of networks: kept as a dict, refused where no sensor has them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.networks.normal_settings import NormalModelConfig
from taccel_lab.networks.settings import MAX_BANDS
from taccel_lab.reading.slopes import NormalModel
from taccel_lab.signals.color_model import ColorModel
from taccel_lab.signals.force_model import ForceModel
from tests.networks.weights import COLOR, FORCE, NORMAL, random_weights

SCALED = NormalModelConfig(
    48, 36, members=2, hidden=(8,), input_mean=(1.0,) * 23, input_scale=(2.0,) * 23
)
SMALL_BESIDE = replace(NORMAL, small_hidden=(5, 4))


@pytest.mark.parametrize(
    "config",
    [
        COLOR,
        replace(COLOR, position_bands=3),
        NORMAL,
        SMALL_BESIDE,
        NormalModelConfig(40, 30, position_bands=2),
        SCALED,
        FORCE,
    ],
)
def test_settings_go_through_a_dict_and_refuse_other_keys(config):
    kind, values = type(config), config.to_dict()
    assert kind.from_dict(values) == config
    without = {name: value for name, value in values.items() if name != "hidden"}
    for changed, words in (
        ({**values, "gamma": 2}, r"unknown.*gamma"),
        ({**values, "hidden": ["many"]}, "wrong type"),
        (without, r"missing.*hidden"),
    ):
        with pytest.raises(InputError, match=words):
            kind.from_dict(changed)


@pytest.mark.parametrize(
    ("config", "changes", "message"),
    [
        (COLOR, {"inputs": ("u", "shade")}, "inputs"),
        (COLOR, {"inputs": ()}, "inputs"),
        (COLOR, {"activation": "sine"}, "silu, tanh, relu"),
        (COLOR, {"hidden": (0,)}, "hidden"),
        (COLOR, {"width_px": 1}, "1x30 px"),
        (COLOR, {"input_mean": (0.0,)}, "input_mean needs 6"),
        (COLOR, {"input_mean": (math.nan,) * 6}, "input_mean of u must lie in"),
        (COLOR, {"input_scale": (0.0,) * 6}, r"input_scale of u must lie in \[0.0009, 2\]"),
        (COLOR, {"position_bands": -1}, r"color model position_bands must lie in \[0, 8\]"),
        (NORMAL, {"position_bands": MAX_BANDS + 1}, r"normal model position_bands must lie in"),
        (NORMAL, {"input_mean": (0.0,)}, "numbers, one per feature"),
        (NORMAL, {"members": 0}, "at least 1"),
        (NORMAL, {"small_hidden": (4, 0)}, "at least 1"),
        (NORMAL, {"presses_px": (40.0, 50.0)}, "presses_px"),
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
def test_settings_of_no_sensor_are_refused(config, changes, message):
    with pytest.raises(InputError, match=message):
        replace(config, **changes)


@pytest.mark.parametrize(
    ("make", "config", "name", "value", "message"),
    [
        (ColorModel, COLOR, "layer1.bias", None, "have shapes"),
        (ColorModel, COLOR, "layer1.bias", np.full(8, np.nan), "NaN"),
        (ColorModel, COLOR, "layer0.weight", np.zeros((16, 18)), "have shapes"),
        (NormalModel, NORMAL, "layer0.weight", np.zeros((1, 2)), "expected"),
        (NormalModel, SMALL_BESIDE, "small.layer0.weight", np.zeros((5, 2)), "expected"),
        (NormalModel, SMALL_BESIDE, "small.layer2.bias", None, "have shapes"),
        (NormalModel, SMALL_BESIDE, "small.layer1.bias", np.full(4, np.nan), "NaN"),
        (NormalModel, NORMAL, "small.layer0.bias", np.zeros(4), "expected"),
        (ForceModel, FORCE, "down0.weight", np.zeros((3, 4, 3, 3)), "down0.weight"),
        (ForceModel, FORCE, "extra", np.zeros(2), "extra"),
        (ForceModel, FORCE, "hidden.bias", np.full(6, np.nan), "NaN"),
    ],
)
def test_weights_that_do_not_fit_are_refused(make, config, name, value, message):
    changed = random_weights(config) | {name: value}
    if value is None:
        del changed[name]
    grid = [PixelGrid(40, 30, 0.1, 0.12)] if make is ForceModel else []
    with pytest.raises(InputError, match=message):
        make(config, changed, *grid)


def test_a_tilt_is_less_sure_away_from_the_contacts_that_were_fitted():
    config = NormalModelConfig(200, 100, presses_px=(40.0, 50.0, 10.0, 60.0, 50.0, 20.0))
    away = config.away()
    assert away.shape == (100, 200)
    assert away[30:71, 30:81].max() == 0.0
    assert away[50, 110] == pytest.approx(0.3)
    assert away[90, 110] == pytest.approx(np.hypot(0.2, 0.3))
    middles = (away[:, 1:] + away[:, :-1])[1:, ::2] + (away[:, 1:] + away[:, :-1])[:-1, ::2]
    np.testing.assert_allclose(config.away(2), middles[::2] / 4, atol=2e-3)
    assert NormalModelConfig(200, 100).away().max() == 0.0
