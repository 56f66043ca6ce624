"""Depth from two rectified infrared images: semi-global matching, or a learned stereo network from an ONNX file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dgs_description.camera import PinholeCamera
from dgs_description.errors import DgsError, ErrorCode

Picture = NDArray[np.uint8]
Image = NDArray[np.float32]
Matcher = Callable[[Picture, Picture], Image]
"""Left and right image (H, W) -> disparity of the left one (H, W) [px], 0 or less = none."""

NEAREST, FARTHEST = 0.30, 6.0
"""Depth outside of this range is none [m]."""
SMOOTHING = (9, 1.0, 3.0)
"""Of the disparity (bilateral): diameter [px], range [px of disparity], radius [px]."""
BLOCK = 5
"""Side of the squares that semi-global matching compares [px]."""
_FAR_OFF = 50.0
MULTIPLE = 32
"""Sizes of images for networks that take any size."""


def stereo_depth(
    matcher: Matcher, left: Picture, right: Picture, camera: PinholeCamera, baseline: float
) -> Image:
    """Depth image in the left imager's place: z = f b / d.

    Args:
        left, right: (H, W) rectified images.
        baseline: distance of the imagers [m].

    Returns:
        (H, W) float32 [m], 0 = none.

    Raises:
        DgsError: DEPTH_FORMAT: the images are of different sizes or not of the camera's.
    """
    size = (camera.height, camera.width)
    if left.shape != size or right.shape != size:
        came = f"images of {left.shape[::-1]} and {right.shape[::-1]} px"
        must = f"both must have the camera's {size[::-1]} px"
        raise DgsError(ErrorCode.DEPTH_FORMAT, f"Stereo got {came}; {must}.")
    disparity, scale = matcher(left, right), np.float32(camera.fx * baseline)
    near = (disparity >= scale / FARTHEST) & (disparity <= scale / NEAREST)
    return np.divide(scale, disparity, out=np.zeros(size, np.float32), where=near)


class SemiGlobalMatcher:
    """Semi-global matching with left-right check and speckle filter (Hirschmueller, PAMI 2008; OpenCV's form of it)."""

    def __init__(self, camera: PinholeCamera, baseline: float) -> None:
        """Search as far as `NEAREST` needs."""
        self._range = -(-int(camera.fx * baseline / NEAREST) // 16) * 16
        # A quarter of the smoothness that OpenCV's documentation recommends, and a stricter best match: smoother
        # settings fill surfaces better, but make things where there are none. Both images must agree within a pixel.
        self._matcher = cv2.StereoSGBM_create(
            minDisparity=0,
            numDisparities=self._range,
            blockSize=BLOCK,
            P1=2 * BLOCK**2,
            P2=8 * BLOCK**2,
            disp12MaxDiff=1,
            preFilterCap=63,
            uniquenessRatio=15,
            speckleWindowSize=400,
            speckleRange=1,
            mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
        )

    def __call__(self, left: Picture, right: Picture) -> Image:
        """Disparity; the left band, where the matcher does not search, is searched in an image made wider."""
        wide = (cv2.copyMakeBorder(im, 0, 0, self._range, 0, cv2.BORDER_REPLICATE) for im in (left, right))
        steps = self._matcher.compute(*wide)[:, self._range :]
        found = steps > 0
        disparity = np.where(found, steps / np.float32(cv2.StereoMatcher_DISP_SCALE), -_FAR_OFF).astype(
            np.float32
        )
        # Over what lies within a pixel of disparity: edges and holes stay.
        return np.where(found, cv2.bilateralFilter(disparity, *SMOOTHING), 0.0)


class OnnxMatcher:
    """A stereo network: two images (1, 1 or 3, H, W) float32 in 0..255 in, disparity of the first (..., H, W) [px] out.

    Images are padded below and at the right; larger than a network of fixed size, they are shrunk before.
    """

    def __init__(self, file: Path) -> None:
        """Load the network. Raises DgsError DEPTH_SOURCE with what is wrong."""
        try:
            import onnxruntime
        except ImportError as error:
            need = f"a stereo network needs onnxruntime ({error}): pip install onnxruntime"
            raise DgsError(ErrorCode.DEPTH_SOURCE, need) from error
        if not file.is_file():
            raise DgsError(ErrorCode.DEPTH_SOURCE, f"there is no stereo network at {file}")
        try:
            self._session = onnxruntime.InferenceSession(
                str(file), providers=onnxruntime.get_available_providers()
            )
        except Exception as error:  # its own kinds of exceptions
            raise DgsError(ErrorCode.DEPTH_SOURCE, f"{file} is no ONNX network: {error}") from error
        self.file, inputs = file, self._session.get_inputs()
        shapes = [one.shape for one in inputs]
        if (
            len(shapes) != 2
            or any(len(s) != 4 or s[1] not in (1, 3) for s in shapes)
            or shapes[0] != shapes[1]
        ):
            must = "two images (1, 1 or 3, H, W) are wanted"
            raise DgsError(ErrorCode.DEPTH_SOURCE, f"{file} takes {shapes}; {must}")
        self._names = [one.name for one in inputs]
        self._channels, *size = shapes[0][1:]
        self._size: tuple[int, int] | None = (
            (size[0], size[1]) if all(isinstance(n, int) for n in size) else None
        )

    def __call__(self, left: Picture, right: Picture) -> Image:
        """Disparity. Raises DgsError DEPTH_SOURCE if the network answers something else."""
        height, width = left.shape
        factor = 1.0 if self._size is None else min(1.0, self._size[0] / height, self._size[1] / width)
        rows, columns = round(height * factor), round(width * factor)
        full = self._size or (-(-rows // MULTIPLE) * MULTIPLE, -(-columns // MULTIPLE) * MULTIPLE)
        feed = {
            name: self._tensor(cv2.resize(im, (columns, rows), interpolation=cv2.INTER_AREA), full)
            for name, im in zip(self._names, (left, right), strict=True)
        }
        try:
            answer: Any = np.asarray(self._session.run(None, feed)[0], np.float32)
            disparity = answer.reshape(full)[:rows, :columns]
        except Exception as error:
            wrong = f"the stereo network {self.file} failed on images of {width} x {height} px: {error}"
            raise DgsError(ErrorCode.DEPTH_SOURCE, wrong) from error
        scale = np.float32(width / columns)
        return cv2.resize(disparity, (width, height), interpolation=cv2.INTER_NEAREST) * scale

    def _tensor(self, image: Picture, size: tuple[int, int]) -> Image:
        below, right = size[0] - image.shape[0], size[1] - image.shape[1]
        padded = cv2.copyMakeBorder(image, 0, below, 0, right, cv2.BORDER_REPLICATE).astype(np.float32)
        return np.repeat(padded[None, None], self._channels, axis=1)
