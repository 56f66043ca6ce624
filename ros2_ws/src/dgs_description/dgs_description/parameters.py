"""Node parameters as frozen dataclasses: type, default, bounds and description stand at the field. No ROS.

@dataclass(frozen=True)
class CameraParameters:
    source: str = parameter("depth_topics", "Where depth comes from.", choices=("realsense", "depth_topics"))
    rate: float = parameter(10.0, "Clouds per second [Hz].", 0.1, 30.0)  # smallest and largest value
    voxel: float = parameter(CropSettings.height, "Height of what is kept [m].", 0.0)  # default stands there

Settings whose fields are parameters may be a base class of the node's parameters, which are such settings then.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from functools import partial
from types import UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

from dgs_description.errors import DgsError, ErrorCode

_SCALARS = (bool, int, float, str)
_METADATA = "dgs_parameter"
P = TypeVar("P")
_refuse = partial(DgsError, ErrorCode.PARAMETER_INVALID)


@dataclasses.dataclass(frozen=True)
class Constraints:
    """What a value must satisfy besides its type. Bounds and choices hold for every element of a list."""

    description: str
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[Any, ...] | None = None
    optional: bool = False

    def text(self) -> str:
        """The bounds or choices in words; empty if there are none."""
        if self.choices is not None:
            return "one of " + ", ".join(repr(choice) for choice in self.choices)
        if self.minimum is not None and self.maximum is not None:
            return f"{self.minimum:g} to {self.maximum:g}"
        if self.minimum is not None:
            return f"at least {self.minimum:g}"
        return f"at most {self.maximum:g}" if self.maximum is not None else ""


def parameter(
    default: Any,
    description: str,
    minimum: float | None = None,
    maximum: float | None = None,
    *,
    choices: Sequence[Any] | None = None,
    optional: bool = False,
) -> Any:
    """A dataclass field that is a node parameter.

    Args:
        default: value if none is given; lists are written as tuples.
        description: one line with the unit in [brackets].
        minimum, maximum: bounds of a number, or of every number of a list.
        optional: of the name of a topic or service: it may be empty, for none.
    """
    allowed = None if choices is None else tuple(choices)
    constraints = Constraints(description, minimum, maximum, allowed, optional)
    return dataclasses.field(default=default, metadata={_METADATA: constraints})


@dataclasses.dataclass(frozen=True)
class ManagedParameters:
    """What every node with a lifecycle has."""

    autostart: bool = parameter(True, "Become active by itself; if not, ros2 lifecycle set does it.")


def declared(kind: type) -> dict[str, dataclasses.Field]:
    """The fields of a dataclass that `parameter` made, by name; plain fields are no parameters."""
    return {field.name: field for field in dataclasses.fields(kind) if _METADATA in field.metadata}


def constraints_of(field: dataclasses.Field) -> Constraints:
    """The constraints of a field made by `parameter`."""
    return field.metadata[_METADATA]


def from_values(kind: type[P], values: Mapping[str, Any]) -> P:
    """An instance of a parameter dataclass from named values; defaults fill what is not given.

    Args:
        kind: a frozen dataclass whose fields are bool, int, float, str or tuples of them.
        values: by field name, as they came from a command line or a YAML file. Whole numbers may stand for floats.

    Raises:
        DgsError: PARAMETER_INVALID: unknown name, wrong type, value out of bounds; what the dataclass itself refuses.
    """
    fields = declared(kind)
    unknown = sorted(set(values) - set(fields))
    if unknown:
        known = ", ".join(sorted(fields))
        raise _refuse(f"unknown parameter {', '.join(map(repr, unknown))}; there are: {known}")
    hints = get_type_hints(kind)
    # Defaults are checked too: a default outside its own bounds is a mistake of the programmer.
    checked = {
        name: _check(name, values.get(name, field.default), hints[name], constraints_of(field))
        for name, field in fields.items()
    }
    try:
        return kind(**checked)
    except (TypeError, ValueError) as error:
        raise _refuse(f"parameters do not fit together: {error}") from error


def _check(name: str, value: Any, hint: Any, constraints: Constraints) -> Any:
    """The value in its declared type, or DgsError PARAMETER_INVALID."""
    if get_origin(hint) in (Union, UnionType):
        raise TypeError(f"parameter {name}: optional types are not supported, use an empty value instead")
    if get_origin(hint) is not tuple:
        return _scalar(name, value, hint, constraints)
    kinds = get_args(hint)
    if isinstance(value, str) or not isinstance(value, Sequence) and not hasattr(value, "tolist"):
        raise _refuse(f"parameter {name!r} must be a list, got {value!r}")
    items = list(value)
    if kinds[-1] is not Ellipsis and len(items) != len(kinds):
        raise _refuse(f"parameter {name!r} must have {len(kinds)} values, got {len(items)}: {items}")
    each = kinds[:1] * len(items) if kinds[-1] is Ellipsis else kinds
    return tuple(_scalar(name, item, kind, constraints) for item, kind in zip(items, each, strict=True))


def _scalar(name: str, value: Any, kind: Any, constraints: Constraints) -> Any:
    if kind not in _SCALARS:
        raise TypeError(f"parameter {name}: type {kind} is not supported")
    if hasattr(value, "item"):
        value = value.item()
    if kind is float and type(value) is int:
        value = float(value)
    if type(value) is not kind:
        got = f"{value!r} ({type(value).__name__})"
        raise _refuse(f"parameter {name!r} must be a {kind.__name__}, got {got}")
    if kind is float and not math.isfinite(value):
        raise _refuse(f"parameter {name!r} must be a finite number, got {value!r}")
    low, high, choices = constraints.minimum, constraints.maximum, constraints.choices
    if (
        (choices is not None and value not in choices)
        or (low is not None and value < low)
        or (high is not None and value > high)
    ):
        raise _refuse(f"parameter {name!r} must be {constraints.text()}, got {value!r}")
    return value
