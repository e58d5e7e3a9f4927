# SPDX-License-Identifier: Apache-2.0
"""Every kernel compiles for every NVIDIA chip since Ampere, which needs no GPU.

Fast: the linear solvers, whose C++ depends on the chip, as machine code for the least shared memory
and for H100; the others as assembly for the oldest, of materials the first. Slow: all as machine
code for all. What was compiled once stays in Warp's cache, under the digest of its source.
"""

from __future__ import annotations

import importlib
import json
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import pytest
import warp as wp

from taccel_lab.ipc.device.block_ops import MAX_LANES
from taccel_lab.ipc.device.dense_inverse import room_for_inverse
from taccel_lab.ipc.elasticity.laws import LAWS
from taccel_lab.ipc.linear.arrow.kernel import solve_kernel
from taccel_lab.ipc.linear.arrow.program import ROOMS_KIB, STATIC_BYTES
from taccel_lab.ipc.linear.cg import block_cg, pipelined_cg, preconditioner
from taccel_lab.ipc.linear.cg.streamed_rows import room_for_stream
from taccel_lab.ipc.linear.coarse import matrix as coarse_matrix
from taccel_lab.ipc.potentials.elements import maxwell
from taccel_lab.ipc.potentials.elements.linear_kernels import create_linear_kernels
from taccel_lab.ipc.potentials.elements.quadratic_points import elastic_quadratic_kernels
from taccel_lab.outputs.stress import _stress_kernel
from taccel_lab.reading.fixed_network import _network_kernel
from taccel_lab.scene import Element, MaterialModel
from taccel_lab.signals.color_kernel import color_kernel

PACKAGE = Path(__file__).parents[1] / "taccel_lab"
LARGEST_BLOCK_KIB = {80: 163, 86: 99, 89: 99, 90: 227, 100: 227, 120: 99}
"""Shared memory that a block may have, by chip [CUDA C++ Programming Guide, compute capabilities]:
A100, RTX 30, RTX 40, H100 and H200, B200, RTX 50."""
FACTORIES: dict[str, Callable[[], list[Any]]] = {
    "ipc/linear/arrow/kernel.py": lambda: [solve_kernel(0, False)],
    "ipc/linear/cg/block_cg.py": lambda: [block_cg._solve_kernel(room_for_stream(MAX_LANES, 2))],
    "ipc/linear/coarse/matrix.py": lambda: [
        coarse_matrix._inverse_kernel(
            room_for_inverse(coarse_matrix.MOST_PARTS * coarse_matrix.MODES)
        )
    ],
    "ipc/linear/cg/pipelined_cg.py": lambda: [
        pipelined_cg._solve_kernel(room_for_stream(MAX_LANES, 2))
    ],
    "ipc/linear/cg/preconditioner.py": lambda: [
        preconditioner._inverse_kernel(room_for_inverse(preconditioner._COMMON_WIDTH))
    ],
    "ipc/potentials/elements/linear_kernels.py": lambda: [
        create_linear_kernels(x) for x in LAWS.values()
    ],
    "ipc/potentials/elements/quadratic_kernels.py": lambda: [
        *(elastic_quadratic_kernels(model) for model in MaterialModel),
        *(maxwell._quadratic_kernels(model) for model in MaterialModel),
    ],
    "outputs/stress.py": lambda: [
        _stress_kernel(*kind) for kind in product(MaterialModel, Element)
    ],
    "signals/color_kernel.py": lambda: [
        color_kernel((64, 64, 64), "silu", encoded) for encoded in (False, True)
    ],
    "reading/fixed_network.py": lambda: [_network_kernel((41, 64, 64, 64, 3))],
}
"""What makes the kernels of files that make them on demand; of solvers in one memory."""


def texts() -> Iterator[tuple[str, str]]:
    """Files of the package that have kernels, and their text; of its rooms, too. The one kernel of
    the command line is made where it is run, by ``doctor``."""
    rooms = [link for link in PACKAGE.iterdir() if link.is_symlink()]
    for path in sorted(path for folder in (PACKAGE, *rooms) for path in folder.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        name = str(path.relative_to(PACKAGE))
        if "@wp.kernel" in text and not name.startswith("cli/"):
            yield name, text


FAST_CHIPS = (86, 90)
"""Of the linear solvers: the least shared memory, and the most."""
CPU_ALONE = {"ipc/linear/cpu.py"}
"""Refused elsewhere; its C++ is a CPU compiler's."""
FILES = [name for name, _ in texts() if name not in CPU_ALONE]
LINEAR = [name for name in FILES if name.startswith("ipc/linear/")]


def modules_of(name: str, kinds: int | None = 1) -> list[wp.Module]:
    """Warp's modules with the kernels of a file, of the first ``kinds`` that are made on demand."""
    path = "taccel_lab." + name.removesuffix(".py").replace("/", ".")
    made: list[Any] = list(vars(importlib.import_module(path)).values())
    made = [k for k in made if isinstance(k, wp.Kernel) and k.module.name == path]
    for part in FACTORIES.get(name, list)()[:kinds]:
        parts = [part] if isinstance(part, wp.Kernel) else vars(part).values()
        made += [kernel for kernel in parts if isinstance(kernel, wp.Kernel)]
    return list({kernel.module.name: kernel.module for kernel in made}.values())


@dataclass(frozen=True)
class Use:
    """What a kernel takes, as its machine code says."""

    registers: int
    stack_bytes: int
    """Of a thread: what the registers have no room for, and arrays indexed by variables."""
    static_bytes: int
    """Shared memory beside what the launch asks for."""


_FRAME_SIZE, _REGISTER_COUNT = 0x11, 0x2F
"""Attributes of section .nv.info."""


def uses(cubin: bytes) -> dict[str, Use]:
    """By kernel, from a 64-bit ELF file; .nv.info: (format, attribute, size, (symbol, value))."""
    sections_at, width, count, names_index = struct.unpack_from("<Q10xHHH", cubin, 40)
    headers = [
        struct.unpack_from("<IIQQQQIIQQ", cubin, sections_at + width * i) for i in range(count)
    ]
    names_at = headers[names_index][4]

    def text(at: int) -> str:
        return cubin[at : cubin.index(b"\0", at)].decode()

    by_name = {text(names_at + header[0]): header for header in headers}
    symbols, strings = by_name[".symtab"], by_name[".strtab"]
    info = by_name[".nv.info"]
    found: dict[str, dict[int, int]] = {}
    at = info[4]
    while at < info[4] + info[5]:
        form, attribute, size = struct.unpack_from("<BBH", cubin, at)
        if form == 4 and attribute in (_FRAME_SIZE, _REGISTER_COUNT):
            symbol, value = struct.unpack_from("<II", cubin, at + 4)
            (name_at,) = struct.unpack_from("<I", cubin, symbols[4] + symbols[9] * symbol)
            found.setdefault(text(strings[4] + name_at), {})[attribute] = value
        at += 4 + (size if form == 4 else 0)
    return {
        kernel: Use(
            values[_REGISTER_COUNT],
            values[_FRAME_SIZE],
            by_name[f".nv.shared.{kernel}"][5] if f".nv.shared.{kernel}" in by_name else 0,
        )
        for kernel, values in found.items()
        if f".text.{kernel}" in by_name
    }


@pytest.mark.thorough
def test_every_kernel_is_covered() -> None:
    assert {name for name, _ in texts()} > CPU_ALONE
    on_demand = {name for name, text in texts() if "\n    @wp.kernel" in text}
    assert on_demand == set(FACTORIES)
    assert all(modules_of(name) for name in FILES)
    assert len(FILES) > 40


def compiled(module: wp.Module, arch: int) -> dict[str, Use]:
    """What the kernels of a module take on a chip, from machine code. Fails where a launch would:
    for want of registers for the lanes that are stated, or of shared memory."""
    (path,) = wp.compile_aot_module(module, arch=arch, use_ptx=False)
    asked: dict[str, int] = {}
    for meta in path.parent.glob("*.meta"):
        asked.update(json.loads(meta.read_text()))
    found = uses(path.read_bytes())
    assert found
    for kernel, use in found.items():
        shared = asked[f"{kernel}_smem_bytes"] + use.static_bytes
        assert shared <= 1024 * LARGEST_BLOCK_KIB[arch], kernel
    return found


def rooms_of(arch: int) -> list[tuple[int, bool]]:
    """Arguments of ``solve_kernel`` on a chip, the largest room first."""
    kib = [kib for kib in ROOMS_KIB if kib <= LARGEST_BLOCK_KIB[arch]]
    return [((1024 * k - STATIC_BYTES) // 8, inside) for k in kib[::-1] for inside in (True, False)]


def require_lean_factors(arch: int, rooms: list[tuple[int, bool]]) -> None:
    """Gels are factored without spilling a register."""
    for room in rooms:
        (use,) = compiled(solve_kernel(*room).module, arch).values()
        assert use.stack_bytes == 0
        # 512 lanes share 65,536.
        assert use.registers <= 128
        assert use.static_bytes <= STATIC_BYTES


def require_lean_gradients(name: str, arch: int, kinds: int | None = 1) -> None:
    """They keep most of what they compute with in registers: with 400 bytes and more elsewhere an
    iteration took a third longer."""
    for module in modules_of(name, kinds):
        found = compiled(module, arch)
        if name.endswith("_cg.py"):
            assert max(use.stack_bytes for use in found.values()) <= 256


@pytest.mark.thorough(cases=("86",))
@pytest.mark.parametrize("arch", FAST_CHIPS)
def test_linear_solvers_compile_for_the_least_and_the_most_shared_memory(arch: int) -> None:
    """In the largest shared memory, and in global memory; what has one layout for all chips, for
    the one with the least."""
    least = arch == min(FAST_CHIPS)
    require_lean_factors(arch, [rooms_of(arch)[0], *([(0, False)] * least)])
    for name in LINEAR * least:
        if name != "ipc/linear/arrow/kernel.py":
            require_lean_gradients(name, arch)


@pytest.mark.thorough(cases=("signals/deformed_face.py",))
@pytest.mark.parametrize("name", sorted({*FILES} - {*LINEAR}))
def test_kernels_compile_for_the_oldest(name: str) -> None:
    for module in modules_of(name):
        (path,) = wp.compile_aot_module(module, arch=min(LARGEST_BLOCK_KIB), use_ptx=True)
        assert path.stat().st_size


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("arch", LARGEST_BLOCK_KIB)
def test_everything_compiles_for_every_chip(arch: int) -> None:
    for name in sorted({*FILES} - {"ipc/linear/arrow/kernel.py"}):
        require_lean_gradients(name, arch, None)
    require_lean_factors(arch, rooms_of(arch))
