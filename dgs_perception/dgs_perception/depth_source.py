"""Where depth comes from: the camera, its two infrared images, or the camera and a network that fills in glass."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dgs_description.camera import PinholeCamera
from dgs_description.errors import DgsError, ErrorCode

RAW, COMPLETED, STEREO = NAMES = ("raw", "completed", "stereo")
ONNX = ".onnx"

Image = NDArray[np.float32]
Picture = NDArray[np.uint8]


class DepthSource:
    """One way to a depth image.

    Attributes:
        imagers: infrared images that it needs: 0, 1 (left) or 2.
        needs_depth: whether it needs the camera's depth image.
    """

    def __init__(self, depth_from: str) -> None:
        """Get ready; weights and networks are loaded here.

        Args:
            depth_from: "raw", "completed", "stereo", or the path of a stereo network (.onnx).

        Raises:
            DgsError: PARAMETER_INVALID: there is no such source. DEPTH_SOURCE: its file is missing or unfit.
        """
        check_name(depth_from)
        self.imagers = {RAW: 0, COMPLETED: 1}.get(depth_from, 2)
        self.needs_depth = self.imagers < 2
        self._make: Callable[..., Image] = _raw
        # Torch and onnxruntime are loaded only where they are asked for.
        if depth_from == COMPLETED:
            from dgs_perception.completion import DepthCompletion

            complete = DepthCompletion()
            self._make = lambda depth, left, right, camera, baseline: complete(depth, left, camera)[0]
        elif self.imagers == 2:
            from dgs_perception import stereo

            semi_global = cache(stereo.SemiGlobalMatcher)
            network = None if depth_from == STEREO else stereo.OnnxMatcher(Path(depth_from).expanduser())
            self._make = lambda depth, left, right, camera, baseline: stereo.stereo_depth(
                network or semi_global(camera, baseline), left, right, camera, baseline
            )

    def __call__(
        self,
        depth: Image | None,
        left: Picture | None,
        right: Picture | None,
        camera: PinholeCamera,
        baseline: float,
    ) -> Image:
        """The depth image.

        Args:
            depth: (H, W) of the camera [m], 0 = none; None where it is not needed.
            left, right: (H, W) rectified infrared images; None where they are not needed.
            camera: of all images, in the left imager's place.
            baseline: distance of the imagers [m].

        Returns:
            (H, W) float32 [m], 0 = none.
        """
        return self._make(depth, left, right, camera, baseline)


def check_name(depth_from: str) -> None:
    """Raise DgsError PARAMETER_INVALID if there is no such source."""
    if depth_from not in NAMES and not depth_from.endswith(ONNX):
        there_are = f"there are {', '.join(NAMES)} and files that end in {ONNX}"
        raise DgsError(ErrorCode.PARAMETER_INVALID, f"no depth source named {depth_from!r}; {there_are}")


def _raw(depth: Image, left: object, right: object, camera: object, baseline: object) -> Image:
    return depth
