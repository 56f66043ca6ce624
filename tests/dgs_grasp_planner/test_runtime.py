"""Choice of device and number format, settings of the process."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
import torch

from dgs_description.errors import ErrorCode
from dgs_grasp_planner.runtime import bf16_is_faster, choose_device, choose_dtype
from tests.support.refused import refused


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_gpu_that_is_asked_for_and_absent_is_refused() -> None:
    with refused(ErrorCode.REQUEST_INVALID, "torch sees none"):
        choose_device("cuda")
    assert choose_device("auto").type == "cpu"


def test_number_formats() -> None:
    cpu = choose_device("cpu")
    assert cpu.type == "cpu"
    assert choose_dtype("fp32", cpu) == torch.float32
    assert choose_dtype("bf16", cpu) == torch.bfloat16
    assert choose_dtype("auto", cpu) == (torch.bfloat16 if bf16_is_faster() else torch.float32)
    assert choose_dtype("auto", torch.device("cuda")) == torch.bfloat16


def test_prepare_process_comes_before_torch_and_respects_the_users_choice() -> None:
    program = (
        "import os, sys; import dgs_grasp_planner.grasp_planner_node;"
        "from dgs_grasp_planner.runtime import prepare_process; prepare_process();"
        "print(os.environ['OMP_WAIT_POLICY'], 'torch' in sys.modules)"
    )
    for given, wanted in ((None, "PASSIVE"), ("ACTIVE", "ACTIVE")):
        environment = {k: v for k, v in os.environ.items() if k != "OMP_WAIT_POLICY"}
        environment["PYTHONPATH"] = os.pathsep.join(path for path in sys.path if path)
        if given:
            environment["OMP_WAIT_POLICY"] = given
        out = subprocess.run(
            [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True
        )
        assert out.stdout.split() == [wanted, "False"]


def test_holes_in_the_heap_go_back_to_the_kernel() -> None:
    """Blocks below the mmap threshold, every second one freed: without a trim they stay resident."""
    program = (
        "import numpy as np; from dgs_description.malloc import trim\n"
        "from dgs_grasp_planner.runtime import prepare_process\n"
        "prepare_process()\n"
        "def mib(): return int(open('/proc/self/statm').read().split()[1]) / 256\n"
        "blocks = [np.ones(1 << 17) for _ in range(200)]\n"
        "blocks = blocks[::2]; full = mib(); trim(); print(full - mib())"
    )
    out = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert float(out.stdout) > 80, "100 MiB were freed between blocks that are in use"
