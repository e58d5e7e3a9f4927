# SPDX-License-Identifier: Apache-2.0
"""How strongly each parameter moves each metric.

Three figures, each with its own use:

- **elasticity**: percent of the metric for a percent of the parameter: the coefficients of a least
  squares fit of log(metric) on the logs of all swept parameters (with its R^2). Parameters and
  metrics that are not positive throughout have none.
- **means** and **share** (grids): means of the metric by the parameter's levels, and the part of
  its variance that they explain, the correlation ratio eta^2 = SS_between / SS_total (Fisher
  1925). Also for choices. Where designs have no figure, means over what is left compare thin hard
  gels with thick soft ones; so only designs count whose *partners*, the designs that differ from
  them in this parameter alone, have figures at every level that has any.
- **rank correlation** (random and optimiser-driven sweeps): Spearman's rho; an optimiser's designs
  crowd around its optimum, so that theirs holds near it only.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Effect:
    """Effect of one parameter on one metric."""

    elasticity: float | None
    share: float | None
    """eta^2, of grids."""
    rank: float | None
    """Spearman's rho, of other sweeps."""
    means: dict[Any, float | None]
    """Mean by level of grids, over designs with partners; None for a level without."""
    compared: int
    """Designs with partners, of grids; all with a figure, of other sweeps."""


@dataclass(frozen=True)
class Sensitivity:
    """Sensitivity of one metric to all parameters."""

    effects: dict[str, Effect]
    r2: float | None
    """Coefficient of determination of the fit behind the elasticities."""
    count: int
    """Designs with a figure."""
    lacking: int
    """Designs without."""


def sensitivity(
    parameters: Mapping[str, Sequence[Any]], values: Sequence[float | None], *, grid: bool
) -> Sensitivity:
    """Effects of parameters on a metric.

    Args:
        parameters: Values by name, one for each design; numbers or texts.
        values: Of the metric, one for each design; None where there is none. Of a grid with all
            its designs, so that it is known which are lacking.
        grid: Whether parameters have levels.
    """
    known = [i for i, value in enumerate(values) if value is not None]
    y = np.array([values[i] for i in known], dtype=np.float64)
    columns = {name: [column[i] for i in known] for name, column in parameters.items()}
    elasticities, r2 = _elasticities(columns, y)
    effects = {}
    for name, column in columns.items():
        pick = with_partners(columns, name) if grid else list(range(len(y)))
        levels, figures = [column[i] for i in pick], y[pick]
        means = _level_means(levels, figures) if grid else {}
        effects[name] = Effect(
            elasticity=elasticities.get(name),
            share=_share(levels, figures) if grid else None,
            rank=None if grid else _rank(column, y),
            means={level: means.get(level) for level in parameters[name]} if grid else {},
            compared=len(pick),
        )
    return Sensitivity(effects, r2, len(known), len(values) - len(known))


def with_partners(columns: Mapping[str, Sequence[Any]], name: str) -> list[int]:
    """Places of the designs that have a partner at every level of ``name`` that comes up.

    Partners have the same values of all other parameters. Of levels without any design nothing can
    be compared; they take no other design out.
    """
    wanted = set(columns[name])
    others = list(zip(*(c for n, c in columns.items() if n != name), strict=True))
    others = others or [()] * len(columns[name])
    found: dict[tuple[Any, ...], set[Any]] = {}
    for rest, level in zip(others, columns[name], strict=True):
        found.setdefault(rest, set()).add(level)
    return [i for i, rest in enumerate(others) if found[rest] == wanted]


def _numeric(column: Sequence[Any]) -> np.ndarray | None:
    if any(isinstance(value, str) for value in column):
        return None
    return np.array(column, dtype=np.float64)


def _elasticities(
    columns: dict[str, list[Any]], y: np.ndarray
) -> tuple[dict[str, float], float | None]:
    """Elasticity by parameter, and R^2 of the fit."""
    logs: dict[str, np.ndarray] = {}
    for name, column in columns.items():
        x = _numeric(column)
        if x is not None and len(x) and (x > 0).all() and np.ptp(x) > 0:
            logs[name] = np.log(x)
    if not logs or len(y) < len(logs) + 2 or not (y > 0).all() or np.ptp(y) == 0:
        return {}, None
    design = np.column_stack([np.ones(len(y)), *logs.values()])
    target = np.log(y)
    coefficients, _, rank, _ = np.linalg.lstsq(design, target, rcond=None)
    if rank < design.shape[1]:
        return {}, None
    residual = target - design @ coefficients
    r2 = 1 - float(residual @ residual) / float(((target - target.mean()) ** 2).sum())
    return {name: float(c) for name, c in zip(logs, coefficients[1:], strict=True)}, r2


def _level_means(column: Sequence[Any], y: np.ndarray) -> dict[Any, float]:
    levels: dict[Any, list[float]] = {}
    for value, figure in zip(column, y, strict=True):
        levels.setdefault(value, []).append(float(figure))
    return {value: float(np.mean(figures)) for value, figures in levels.items()}


def _share(column: Sequence[Any], y: np.ndarray) -> float | None:
    if len(y) < 2 or np.ptp(y) == 0:
        return None
    means = _level_means(column, y)
    between = sum((means[value] - y.mean()) ** 2 for value in column)
    return float(between / ((y - y.mean()) ** 2).sum())


def _rank(column: Sequence[Any], y: np.ndarray) -> float | None:
    from scipy.stats import rankdata

    x = _numeric(column)
    if x is None or len(y) < 3 or np.ptp(x) == 0 or np.ptp(y) == 0:
        return None
    # Spearman's rho: Pearson's correlation of the ranks, ties at their mean rank.
    return float(np.corrcoef(rankdata(x), rankdata(y))[0, 1])
