# SPDX-License-Identifier: Apache-2.0
"""The moulds of a gel, one a casting step: the core first, then the skin over it."""

from __future__ import annotations

from collections.abc import Mapping

from taccel_lab.cad.moulds.checks import MouldReport, check_mould
from taccel_lab.cad.moulds.options import MouldOptions
from taccel_lab.cad.moulds.two_part import Mould, gel_mould
from taccel_lab.cad.parts.labelled_solid import LabelledSolid
from taccel_lab.errors import InputError


def casting_moulds(
    gel: LabelledSolid,
    layers: Mapping[str, LabelledSolid] | None = None,
    options: MouldOptions | None = None,
) -> list[tuple[Mould, MouldReport]]:
    """Build and check the moulds of ``gel``.

    ``layers`` are its layers by name, core first; two make two moulds: the first casts the core,
    the second the skin round the core, which lies in it on the lid. Raises InputError when a layer
    cannot be cast.
    """
    names = list(layers or {})
    if len(names) < 2:
        mould = gel_mould(gel, options)
        return [(mould, check_mould(mould, gel))]
    if len(names) > 2 or layers is None:
        raise InputError(f"moulds cast gels of one or two layers, this one has {len(names)}")
    core, skin = layers[names[0]], layers[names[1]]
    first = gel_mould(core, options, name=f"mould_1_{names[0]}")
    second = gel_mould(gel, options, name=f"mould_2_{names[1]}", insert=core, fill=skin)
    return [(first, check_mould(first, core)), (second, check_mould(second, gel))]
