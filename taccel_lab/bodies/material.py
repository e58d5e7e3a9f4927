# SPDX-License-Identifier: Apache-2.0
"""Hyperelastic materials of soft bodies, uniform or by tet, and their Maxwell branches; checked."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.guards import require_range
from taccel_lab.typed import typed

MOST_BRANCHES = 3
"""Most branches of a material: each is one more evaluation of all elements, and three span as many
decades of time."""


@typed
@dataclass(frozen=True, order=True)
class MaxwellBranch:
    """A spring and a dashpot in a row, beside the spring of the relaxed solid.

    With branches g_i, tau_i the modulus of a step of strain falls as E (1 + sum_i g_i
    exp(-t / tau_i)), E the modulus of the relaxed solid [the generalised Maxwell solid: Simo and
    Hughes 1998, Computational Inelasticity, 10.2]. Poisson's ratio is that of the solid at all
    times. A series whose moduli are shares p_i of the instantaneous modulus has
    g_i = p_i / (1 - sum p), and E is that modulus times 1 - sum p.
    """

    relative_modulus: float
    """Modulus of the spring over that of the relaxed solid, g."""
    time_s: float
    """Relaxation time tau [s]."""

    def __post_init__(self) -> None:
        modulus = self.relative_modulus
        require_range("relative_modulus of a Maxwell branch", modulus, 1e-6, 100.0)
        require_range("time_s of a Maxwell branch", self.time_s, 1e-6, 1e6, "s")


def check_branches(branches: Sequence[MaxwellBranch]) -> tuple[MaxwellBranch, ...]:
    """Return branches as a tuple, of at most ``MOST_BRANCHES``; InputError for more."""
    if len(branches) > MOST_BRANCHES:
        raise InputError(
            f"a material has at most {MOST_BRANCHES} Maxwell branches, got {len(branches)}"
        )
    return tuple(branches)


_BY_TET = ("young_modulus_pa", "poisson_ratio", "density_kg_m3", "mooney_ratio")
"""Parameters that a material field may have by tet."""
_YOUNG_PA = (1e2, 1e12)


class MaterialModel(StrEnum):
    """Energy of an isotropic solid; for small strains all follow E and nu alike."""

    NEO_HOOKEAN = "neo_hookean"
    """Bonet and Wood; infinite at inversion."""
    STABLE_NEO_HOOKEAN = "stable_neo_hookean"
    """Smith et al. 2018; finite through inversion."""
    ST_VENANT_KIRCHHOFF = "st_venant_kirchhoff"
    """Linear in the Green strain; for large rotations with small strains only."""
    MOONEY_RIVLIN = "mooney_rivlin"
    """Rubber with a second invariant; infinite at inversion."""


def check_young(value: float, where: str = "") -> None:
    """Refuse a modulus that no gel has; ``where`` says whose it is, as for the checks below."""
    if not (math.isfinite(value) and _YOUNG_PA[0] <= value <= _YOUNG_PA[1]):
        raise InputError(
            f"Young's modulus{where} must lie in [100 Pa, 1 TPa], got {value:g} Pa "
            "(a gel is 1e4 to 1e6 Pa; the unit is pascal)"
        )


def check_poisson(value: float, where: str = "") -> None:
    """Refuse a ratio that no compressible solid has."""
    if not (math.isfinite(value) and -1.0 < value < 0.5):
        raise InputError(
            f"Poisson's ratio{where} must lie in (-1, 0.5), got {value:g}; 0.5 is an "
            "incompressible solid, which this energy cannot represent (use 0.45 to 0.49)"
        )


def check_density(value: float, where: str = "") -> None:
    """Refuse a density that no solid has."""
    require_range(f"density{where}", value, 1, 3e4, "kg/m^3")


def check_mooney(model: MaterialModel, ratio: float, poisson: float, where: str = "") -> None:
    """Refuse a ratio c01 / (c10 + c01) that the law, or the law with this Poisson's ratio, cannot
    have."""
    if not isinstance(model, MaterialModel):
        raise InputError(f"model must be one of {', '.join(MaterialModel)}, got {model!r}")
    if model is not MaterialModel.MOONEY_RIVLIN:
        if ratio != 0:
            raise InputError(f"mooney_ratio is a parameter of mooney_rivlin only, not of {model}")
        return
    require_range(f"mooney_ratio{where} = c01 / (c10 + c01)", ratio, 0, 1)
    least = ratio / (1 + 2 * ratio)
    if ratio > 0 and poisson < least:
        raise InputError(
            f"a Mooney-Rivlin solid of mooney_ratio {ratio:g} needs a Poisson's ratio of at least "
            f"{least:.4g}, or its volumetric modulus is negative; got {poisson:g}{where}"
        )


def _check_each(check: Callable[[float, str], None], values: np.ndarray) -> None:
    for value, tet in zip(*np.unique(values, return_index=True), strict=True):
        check(float(value), f" of tet {tet}" if values.ndim else "")


@typed
@dataclass(frozen=True)
class Material:
    """An isotropic hyperelastic solid, compressible Neo-Hookean unless told otherwise."""

    young_modulus_pa: float
    poisson_ratio: float
    density_kg_m3: float = 1000.0
    model: MaterialModel = MaterialModel.NEO_HOOKEAN
    mooney_ratio: float = 0.0
    """Mooney-Rivlin only: c01 / (c10 + c01), 0 for a Neo-Hookean solid."""
    branches: tuple[MaxwellBranch, ...] = ()
    """Stress that a strain adds at first and that fades; the moduli are those of the relaxed
    solid."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "branches", check_branches(self.branches))
        check_young(self.young_modulus_pa)
        check_poisson(self.poisson_ratio)
        check_density(self.density_kg_m3)
        check_mooney(self.model, self.mooney_ratio, self.poisson_ratio)

    @classmethod
    @typed
    def mooney_rivlin(
        cls, c10_pa: float, c01_pa: float, bulk_modulus_pa: float, density_kg_m3: float = 1000.0
    ) -> Material:
        """Make a Mooney-Rivlin solid from its constants [Pa]: mu = 2 (c10 + c01) and the bulk
        modulus of small strains."""
        require_range("c10", c10_pa, 0, math.inf, "Pa")
        require_range("c01", c01_pa, 0, math.inf, "Pa")
        mu = 2 * (c10_pa + c01_pa)
        if not (mu > 0 and math.isfinite(bulk_modulus_pa) and bulk_modulus_pa > 0):
            raise InputError(
                "c10 + c01 and the bulk modulus must be positive, "
                f"got {c10_pa + c01_pa:g} Pa and {bulk_modulus_pa:g} Pa"
            )
        return cls(
            young_modulus_pa=9 * bulk_modulus_pa * mu / (3 * bulk_modulus_pa + mu),
            poisson_ratio=(3 * bulk_modulus_pa - 2 * mu) / (2 * (3 * bulk_modulus_pa + mu)),
            density_kg_m3=density_kg_m3,
            model=MaterialModel.MOONEY_RIVLIN,
            mooney_ratio=2 * c01_pa / mu,
        )

    @property
    def shear_modulus_pa(self) -> float:
        """Lame's second parameter mu [Pa]."""
        return self.young_modulus_pa / (2 * (1 + self.poisson_ratio))

    @property
    def lame_lambda_pa(self) -> float:
        """Lame's first parameter lambda [Pa]."""
        nu = self.poisson_ratio
        return self.young_modulus_pa * nu / ((1 + nu) * (1 - 2 * nu))

    @property
    def largest_young_modulus_pa(self) -> float:
        """Young's modulus [Pa]."""
        return self.young_modulus_pa

    @property
    def tet_count(self) -> None:
        """None: for any number of tets."""
        return None


@typed
@dataclass(frozen=True)
class MaterialField:
    """A solid whose moduli differ by tet; a number stands for all tets.

    For layers of unlike stiffness, inclusions, or a graded gel; one model for the whole body.
    """

    young_modulus_pa: np.ndarray | float
    """Shape [tet_count]."""
    poisson_ratio: np.ndarray | float
    """Shape [tet_count]."""
    density_kg_m3: np.ndarray | float = 1000.0
    """Shape [tet_count]."""
    model: MaterialModel = MaterialModel.NEO_HOOKEAN
    mooney_ratio: np.ndarray | float = 0.0
    """Mooney-Rivlin only: c01 / (c10 + c01), shape [tet_count]."""
    branches: tuple[MaxwellBranch, ...] = ()
    """Maxwell branches as in Material; those of the whole body."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "branches", check_branches(self.branches))
        arrays = {name: np.array(getattr(self, name), dtype=np.float64) for name in _BY_TET}
        shapes = {array.shape for array in arrays.values() if array.shape}
        if len(shapes) > 1 or any(len(shape) != 1 for shape in shapes):
            found = ", ".join(f"{name} {array.shape}" for name, array in arrays.items())
            raise InputError(f"a material field is numbers or arrays [tet_count], got {found}")
        for name, array in arrays.items():
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        _check_each(check_young, arrays["young_modulus_pa"])
        _check_each(check_poisson, arrays["poisson_ratio"])
        _check_each(check_density, arrays["density_kg_m3"])
        pairs = np.broadcast_arrays(arrays["mooney_ratio"], arrays["poisson_ratio"])
        unique, first = np.unique(np.stack([p.ravel() for p in pairs]), axis=1, return_index=True)
        for (ratio, poisson), tet in zip(unique.T, first, strict=True):
            check_mooney(self.model, float(ratio), float(poisson), f" of tet {tet}")

    @property
    def tet_count(self) -> int | None:
        """Tets the arrays are for, None when all are numbers."""
        values = (getattr(self, name) for name in _BY_TET)
        return next((np.size(value) for value in values if np.ndim(value)), None)

    @property
    def shear_modulus_pa(self) -> np.ndarray:
        """Lame's second parameter mu [Pa], shape [tet_count] or []."""
        return np.asarray(self.young_modulus_pa / (2 * (1 + self.poisson_ratio)))

    @property
    def lame_lambda_pa(self) -> np.ndarray:
        """Lame's first parameter lambda [Pa], shape [tet_count] or []."""
        nu = self.poisson_ratio
        return np.asarray(self.young_modulus_pa * nu / ((1 + nu) * (1 - 2 * nu)))

    @property
    def largest_young_modulus_pa(self) -> float:
        """Young's modulus of the stiffest tet [Pa]."""
        return float(np.max(self.young_modulus_pa))
