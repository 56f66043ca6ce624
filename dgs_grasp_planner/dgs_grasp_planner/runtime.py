"""Process settings that make inference fast and predictable on few cores. Torch is imported inside the functions only.

Measured on two cores: spinning OpenMP threads next to one busy process made a forward pass 30 times slower, and glibc
handing large buffers back to the kernel after every layer cost 10 to 25 %.
"""

from __future__ import annotations

import os
import time
from functools import cache
from typing import TYPE_CHECKING

from dgs_description import malloc
from dgs_description.errors import DgsError, ErrorCode

if TYPE_CHECKING:
    import torch

_TRIM_THRESHOLD, _MMAP_THRESHOLD = 1 << 30, 1 << 25
"""Bytes; some versions of glibc refuse an mmap threshold above 32 MiB."""


def prepare_process() -> None:
    """To be called before torch is loaded: passive waiting of OpenMP, and a malloc that keeps its memory (glibc)."""
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    malloc.mallopt(malloc.MMAP_THRESHOLD, _MMAP_THRESHOLD)
    malloc.mallopt(malloc.TRIM_THRESHOLD, _TRIM_THRESHOLD)


def choose_device(wanted: str) -> torch.device:
    """`cpu`, `cuda`, or `auto` = a GPU where there is one. Raises DgsError REQUEST_INVALID: there is no `cuda`."""
    import torch

    if wanted == "cpu":
        return torch.device("cpu")
    if torch.cuda.is_available():
        return torch.device("cuda")
    if wanted == "cuda":
        raise DgsError(
            ErrorCode.REQUEST_INVALID, "a GPU was asked for, torch sees none: take device cpu or auto"
        )
    return torch.device("cpu")


def cpu_has_bf16() -> bool:
    """Whether this CPU has instructions for bf16 (AMX or AVX512-BF16); elsewhere they are emulated and slow."""
    import torch

    probes = ("_is_amx_tile_supported", "_is_avx512_bf16_supported")
    return any(bool(getattr(torch.cpu, probe, lambda: False)()) for probe in probes)


@cache
def bf16_is_faster() -> bool:
    """Whether this CPU multiplies matrices clearly faster in bf16 than in fp32: tried once, which takes milliseconds.

    Instructions for it are not enough. With AMX it is several times as fast; a Xeon with AVX512-BF16 alone took twice
    as long, and 1.4 times as long for the whole network.
    """
    import torch

    if not cpu_has_bf16():
        return False

    def fastest(dtype: torch.dtype) -> float:
        rows, weight = torch.ones(4096, 64, dtype=dtype), torch.ones(64, 64, dtype=dtype)
        times = []
        for _ in range(20):
            start = time.perf_counter()
            torch.mm(rows, weight)
            times.append(time.perf_counter() - start)
        return min(times)

    return fastest(torch.bfloat16) < 0.7 * fastest(torch.float32)


def pairs_pay(device: torch.device, dtype: torch.dtype) -> bool:
    """Whether convolutions over occupied pairs are faster than one dense product: on a CPU in fp32 only."""
    import torch

    return device.type == "cpu" and dtype != torch.bfloat16


def choose_dtype(wanted: str, device: torch.device) -> torch.dtype:
    """`fp32`, `bf16`, or `auto` = bf16 where the device is faster with it."""
    import torch

    if wanted == "auto":
        wanted = "bf16" if device.type == "cuda" or bf16_is_faster() else "fp32"
    return {"fp32": torch.float32, "bf16": torch.bfloat16}[wanted]
