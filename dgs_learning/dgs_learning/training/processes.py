"""One training on several GPUs: the place of this process among those that torchrun started."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch
import torch.distributed as dist

from dgs_description.errors import DgsError, ErrorCode


@dataclass(frozen=True)
class Place:
    """This process among all.

    Attributes:
        rank: 0 is the one that measures, prints and writes.
        processes: how many there are.
        device: where it computes.
    """

    rank: int
    processes: int
    device: torch.device

    @property
    def first(self) -> bool:
        """Whether this process writes."""
        return self.rank == 0


def find_device(wanted: str, local_rank: int = 0) -> torch.device:
    """The device of a name (`cpu`, `cuda`, `cuda:1`); with several processes each takes its own GPU.

    Raises:
        DgsError: REQUEST_INVALID where there is no such GPU: a training on a CPU by mistake would take weeks.
    """
    device = torch.device(wanted)
    if device.type != "cuda":
        return device
    index = local_rank if device.index is None else device.index
    count = torch.cuda.device_count()
    if not torch.cuda.is_available() or index >= count:
        raise DgsError(
            ErrorCode.REQUEST_INVALID, f"GPU {index} was asked for, torch sees {count}: take --device cpu"
        )
    return torch.device("cuda", index)


@contextmanager
def joined(wanted_device: str) -> Iterator[Place]:
    """Join the processes that torchrun started (its environment variables say so), else be the only one.

    Raises:
        DgsError: REQUEST_INVALID, see `find_device`.
    """
    processes = int(os.environ.get("WORLD_SIZE", "1"))
    device = find_device(wanted_device, int(os.environ.get("LOCAL_RANK", "0")))
    if device.type == "cuda":
        torch.cuda.set_device(device)
    if processes == 1:
        yield Place(0, 1, device)
        return
    dist.init_process_group("nccl" if device.type == "cuda" else "gloo")
    try:
        yield Place(dist.get_rank(), processes, device)
    finally:
        dist.destroy_process_group()
