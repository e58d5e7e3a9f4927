# SPDX-License-Identifier: Apache-2.0
"""The materials by name, behind one signature that kernels are compiled against.

A kernel factory takes a ``Law`` and captures its functions, so a scene compiles the code of its
own material and of no other.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import warp as wp

from taccel_lab.ipc.elasticity import (
    mooney_rivlin,
    neo_hookean,
    st_venant_kirchhoff,
    stable_neo_hookean,
)
from taccel_lab.ipc.elasticity.principal import PrincipalHessian
from taccel_lab.scene.material import MaterialModel

wp.set_module_options({"enable_backward": False})


@wp.struct
class Moduli:
    """Material parameters of the tets."""

    mu: wp.array(dtype=wp.float64)
    """Shear modulus [Pa], shape [tet_count]."""
    lam: wp.array(dtype=wp.float64)
    """Lame's first parameter [Pa], shape [tet_count]."""
    ratio: wp.array(dtype=wp.float64)
    """c01 / (c10 + c01), shape [tet_count]; empty unless the material is Mooney-Rivlin."""


@dataclass(frozen=True)
class Law:
    """Functions of a material: ``energy(f, moduli, tet)`` [J/m^3], ``piola(f, moduli, tet)`` [Pa],
    ``hessian(f, moduli, tet, psd_mode)``, a PrincipalHessian [Pa]."""

    model: MaterialModel
    energy: Any
    piola: Any
    hessian: Any


def _of_lame(model: MaterialModel, energy: Any, piola: Any, hessian: Any) -> Law:
    """Law of functions (f, mu, lam)."""

    @wp.func
    def tet_energy(f: wp.mat33d, m: Moduli, tet: int) -> wp.float64:
        return energy(f, m.mu[tet], m.lam[tet])

    @wp.func
    def tet_piola(f: wp.mat33d, m: Moduli, tet: int) -> wp.mat33d:
        return piola(f, m.mu[tet], m.lam[tet])

    @wp.func
    def tet_hessian(f: wp.mat33d, m: Moduli, tet: int, mode: int) -> PrincipalHessian:
        return hessian(f, m.mu[tet], m.lam[tet], mode)

    return Law(model, tet_energy, tet_piola, tet_hessian)


def _of_lame_and_ratio(model: MaterialModel, energy: Any, piola: Any, hessian: Any) -> Law:
    """Law of functions (f, mu, lam, ratio)."""

    @wp.func
    def tet_energy(f: wp.mat33d, m: Moduli, tet: int) -> wp.float64:
        return energy(f, m.mu[tet], m.lam[tet], m.ratio[tet])

    @wp.func
    def tet_piola(f: wp.mat33d, m: Moduli, tet: int) -> wp.mat33d:
        return piola(f, m.mu[tet], m.lam[tet], m.ratio[tet])

    @wp.func
    def tet_hessian(f: wp.mat33d, m: Moduli, tet: int, mode: int) -> PrincipalHessian:
        return hessian(f, m.mu[tet], m.lam[tet], m.ratio[tet], mode)

    return Law(model, tet_energy, tet_piola, tet_hessian)


LAWS = {
    law.model: law
    for law in (
        _of_lame(
            MaterialModel.NEO_HOOKEAN,
            neo_hookean.neo_hookean_energy,
            neo_hookean.neo_hookean_piola,
            neo_hookean.neo_hookean_hessian,
        ),
        _of_lame(
            MaterialModel.STABLE_NEO_HOOKEAN,
            stable_neo_hookean.stable_neo_hookean_energy,
            stable_neo_hookean.stable_neo_hookean_piola,
            stable_neo_hookean.stable_neo_hookean_hessian,
        ),
        _of_lame(
            MaterialModel.ST_VENANT_KIRCHHOFF,
            st_venant_kirchhoff.st_venant_kirchhoff_energy,
            st_venant_kirchhoff.st_venant_kirchhoff_piola,
            st_venant_kirchhoff.st_venant_kirchhoff_hessian,
        ),
        _of_lame_and_ratio(
            MaterialModel.MOONEY_RIVLIN,
            mooney_rivlin.mooney_rivlin_energy,
            mooney_rivlin.mooney_rivlin_piola,
            mooney_rivlin.mooney_rivlin_hessian,
        ),
    )
}
