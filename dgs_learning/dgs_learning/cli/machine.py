"""What a measured time must come with: processor, cores, load, accelerator, versions, revision, date."""

from __future__ import annotations

import os
import platform
from pathlib import Path
from typing import Any


def processor() -> str:
    """Name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    return next(names, "") or platform.processor() or platform.machine()


def measured_here(device: str = "cpu") -> dict[str, Any]:
    """JSON-ready `machine` as torch sees it for a device `cpu` or `cuda`, `revision` and `date`."""
    import torch

    from dgs_description.paths import revision, today
    from dgs_grasp_planner.runtime import cpu_has_bf16

    machine = {
        "processor": processor(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "bf16_in_hardware": cpu_has_bf16(),
        "gpu": torch.cuda.get_device_name() if device == "cuda" else None,
        "torch": torch.__version__,
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
        "load_average": round(os.getloadavg()[0], 2),
    }
    return {"machine": machine, "revision": revision(), "date": today()}
