"""A small stereo network of our own as an ONNX file: absolute differences over a window, best disparity."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper


def write_matcher(
    file: Path,
    size: tuple[int | str, int | str] = ("height", "width"),
    disparities: int = 64,
    channels: int = 3,
) -> Path:
    """Write a network for images of one size, or of any; it finds 0 .. disparities - 1."""
    constants = [numpy_helper.from_array(np.full((1, channels, 1, 1), 1 / channels, np.float32), "mean")]
    nodes, costs = [], []
    for d in range(disparities):
        # Shifted to the right by d: d columns come in at the left, as many are cut off at the right.
        constants.append(numpy_helper.from_array(np.array([0, 0, 0, d, 0, 0, 0, -d], np.int64), f"pads{d}"))
        nodes += [
            helper.make_node("Pad", ["right", f"pads{d}"], [f"shifted{d}"]),
            helper.make_node("Sub", ["left", f"shifted{d}"], [f"difference{d}"]),
            helper.make_node("Abs", [f"difference{d}"], [f"absolute{d}"]),
            helper.make_node("Conv", [f"absolute{d}", "mean"], [f"grey{d}"]),
            helper.make_node(
                "AveragePool", [f"grey{d}"], [f"cost{d}"], kernel_shape=[9, 9], pads=[4, 4, 4, 4]
            ),
        ]
        costs.append(f"cost{d}")
    nodes += [
        helper.make_node("Concat", costs, ["costs"], axis=1),
        helper.make_node("ArgMin", ["costs"], ["best"], axis=1),
        helper.make_node("Cast", ["best"], ["disparity"], to=TensorProto.FLOAT),
    ]
    shape = [1, channels, *size]
    inputs = [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name in ("left", "right")]
    output = helper.make_tensor_value_info("disparity", TensorProto.FLOAT, [1, 1, *size])
    graph = helper.make_graph(nodes, "stereo", inputs, [output], constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    onnx.checker.check_model(model)
    onnx.save(model, str(file))
    return file
