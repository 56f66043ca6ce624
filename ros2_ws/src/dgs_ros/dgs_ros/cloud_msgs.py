"""sensor_msgs/PointCloud2 <-> numpy, without a loop over points."""

from __future__ import annotations

from array import array

import numpy as np
from builtin_interfaces.msg import Time
from numpy.typing import ArrayLike, NDArray
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from dgs_description.errors import DgsError, ErrorCode

_FLOATS = {PointField.FLOAT32: "f4", PointField.FLOAT64: "f8"}
_POINT_STEP = 12
_MOST_POINT_STEP = 2**31 - 1
"""Of numpy's structured types [bytes]."""


def cloud_to_numpy(msg: PointCloud2) -> NDArray[np.float32]:
    """Points of a cloud, read by the message's own fields, offsets, steps and byte order.

    It may be organised; padding behind points and rows and further fields are skipped.

    Returns:
        (N, 3) float32 x y z [m] in the frame of `msg.header`, row by row. Invalid points (NaN) are kept: the caller
        decides. (0, 3) if the message has no points.

    Raises:
        DgsError: CLOUD_FORMAT if x, y or z is missing, doubled or no float, or if the sizes do not fit the data.
    """
    rows, columns = int(msg.height), int(msg.width)
    if rows * columns == 0 and len(msg.data) == 0:
        return np.empty((0, 3), dtype=np.float32)
    layout = _layout(msg)
    if msg.row_step < columns * msg.point_step:
        needed = f"width {columns} times point_step {msg.point_step}"
        raise _refuse(f"row_step {msg.row_step} is less than {needed}")
    if len(msg.data) != rows * msg.row_step:
        came = f"{len(msg.data)} bytes of data came"
        raise _refuse(f"{came} instead of height {rows} times row_step {msg.row_step}")
    records: NDArray = np.ndarray(
        (rows, columns), dtype=layout, buffer=memoryview(msg.data), strides=(msg.row_step, msg.point_step)
    )
    points = np.empty((rows, columns, 3), dtype=np.float32)
    # A double beyond float32 becomes infinite and is dropped with the other invalid points.
    with np.errstate(over="ignore"):
        for k, axis in enumerate("xyz"):
            points[..., k] = records[axis]
    return points.reshape(-1, 3)


def cloud_in(msg: PointCloud2, frame_id: str) -> NDArray[np.float32]:
    """As `cloud_to_numpy`, of a cloud that must be in a frame. Raises also DgsError FRAME_UNKNOWN."""
    if msg.header.frame_id != frame_id:
        where = f"the cloud is in {msg.header.frame_id!r}, needed is {frame_id!r}"
        raise DgsError(ErrorCode.FRAME_UNKNOWN, where)
    return cloud_to_numpy(msg)


def numpy_to_cloud(points: ArrayLike, frame_id: str, stamp: Time | None = None) -> PointCloud2:
    """An unordered cloud with fields x y z float32 of (N, 3) points [m]. Raises DgsError CLOUD_FORMAT."""
    packed = np.ascontiguousarray(points, dtype="<f4")
    if packed.ndim != 2 or packed.shape[1] != 3:
        raise _refuse(f"an array of shape {packed.shape} is no cloud; (N, 3) is wanted")
    # array.array is handed over as it is; bytes or lists are copied number by number by the generated message class.
    data = array("B")
    data.frombytes(packed.reshape(-1).view(np.uint8).data)
    return PointCloud2(
        header=Header(frame_id=frame_id, stamp=Time() if stamp is None else stamp),
        height=1,
        width=len(packed),
        fields=[
            PointField(name=axis, offset=4 * k, datatype=PointField.FLOAT32, count=1)
            for k, axis in enumerate("xyz")
        ],
        point_step=_POINT_STEP,
        row_step=_POINT_STEP * len(packed),
        data=data,
        is_dense=bool(np.isfinite(packed).all()),
    )


def _layout(msg: PointCloud2) -> np.dtype:
    """Structured type of one point: x, y and z at their offsets, everything else skipped."""
    if msg.point_step > _MOST_POINT_STEP:
        raise _refuse(f"point_step {msg.point_step} is more than {_MOST_POINT_STEP} bytes")
    order = ">" if msg.is_bigendian else "<"
    layout: dict[str, tuple[str, int]] = {}
    for axis in "xyz":
        fields = [field for field in msg.fields if field.name == axis]
        if len(fields) != 1:
            names = ", ".join(field.name for field in msg.fields) or "none"
            raise _refuse(f"field {axis!r} must be there once; the fields are: {names}")
        (field,) = fields
        if field.datatype not in _FLOATS or field.count > 1:
            other = f"datatype {field.datatype} x {field.count}"
            raise _refuse(f"field {axis!r} must be one float32 or float64, not {other}")
        code = order + _FLOATS[field.datatype]
        if field.offset + np.dtype(code).itemsize > msg.point_step:
            raise _refuse(f"field {axis!r} at offset {field.offset} lies beyond point_step {msg.point_step}")
        layout[axis] = (code, field.offset)
    formats, offsets = zip(*layout.values(), strict=True)
    return np.dtype(
        {"names": list("xyz"), "formats": formats, "offsets": offsets, "itemsize": msg.point_step}
    )


def _refuse(what: str) -> DgsError:
    return DgsError(ErrorCode.CLOUD_FORMAT, f"the cloud cannot be read: {what}")
