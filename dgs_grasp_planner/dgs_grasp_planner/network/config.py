"""The network's configuration: one frozen, validated dataclass, and its presets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

from dgs_description.errors import DgsError, ErrorCode

FEATURE_WIDTHS = {"ones": 1, "height": 1, "xyz": 3, "ray": 3, "residual": 3}
"""Channels of every input feature; see `batch.input_features` and `batch.collate`."""

ORDERS = ("h", "ht", "z", "zt")
"""Space-filling curves: Hilbert and Morton (z), and both with x and y exchanged."""


def _refuse(message: str) -> DgsError:
    return DgsError(ErrorCode.REQUEST_INVALID, f"network configuration: {message}")


@dataclass(frozen=True)
class NetworkConfig:
    """Everything that defines the network's shape and its input.

    Raises:
        DgsError: REQUEST_INVALID, with the offending value and the allowed range.
    """

    name: str = "fast"
    frame: str = "table"
    """Input frame: `table` (gravity aligned, origin on the table top) or `camera` (optical frame, as in the paper)."""
    keep_table: bool = False
    """Give the network all table points, as in the paper; else only those near objects."""
    features: tuple[str, ...] = ("ones", "height", "ray", "residual")
    voxel_size: float = 0.008
    """Edge of a voxel at the finest level [m]."""
    grid_bits: int = 10
    """Bits per axis of a voxel's address: a cloud may extend over 2^grid_bits voxels."""
    encoder_channels: tuple[int, ...] = (32, 64, 64, 96, 160)
    encoder_depths: tuple[int, ...] = (2, 2, 2, 2, 2)
    decoder_channels: tuple[int, ...] = (32, 64, 64, 96)
    decoder_depths: tuple[int, ...] = (2, 2, 2, 2)
    head_dim: int = 32
    mlp_ratio: int = 4
    patch_size: int = 128
    orders: tuple[str, ...] = ORDERS
    stem_convolutions: int = 1
    """Stacked 3x3x3 convolutions in the stem; two see the 5x5x5 voxels of PTv3's stem."""
    drop_path: float = 0.0
    rotation_hypotheses: int = 8
    """Rotations per point: 1 is the paper; more compete for ambiguous grasps and are ranked by their own logits."""
    fixed_shapes: int = 0
    """So many shapes of the hand in module II's place, one per hypothesis (`FixedShapes`); 0 = module II."""
    module_two_width: int = 64
    module_two_layers: int = 1
    module_two_convolutions: int = 1
    offset_scale: float = 0.05
    """Metres that one unit of the offset head's output stands for."""

    def __post_init__(self) -> None:
        self._check_input()
        self._check_backbone()
        for name in (
            "rotation_hypotheses",
            *(f"module_two_{what}" for what in ("width", "layers", "convolutions")),
        ):
            if getattr(self, name) < 1:
                raise _refuse(f"{name} is {getattr(self, name)}, it must be at least 1")
        if self.fixed_shapes not in (0, self.rotation_hypotheses):
            raise _refuse(
                f"fixed_shapes is {self.fixed_shapes}, it must be 0 or rotation_hypotheses, {self.rotation_hypotheses}"
            )
        if not 0.0 < self.offset_scale <= 1.0:
            raise _refuse(f"offset_scale is {self.offset_scale} m, it must lie in (0, 1]")
        if self._splits_a_head(self.module_two_width):
            raise _refuse(
                f"module_two_width {self.module_two_width} is no multiple of head_dim {self.head_dim}"
            )

    def _check_input(self) -> None:
        if self.frame not in ("table", "camera"):
            raise _refuse(f"frame is '{self.frame}', it must be 'table' or 'camera'")
        unknown = [name for name in self.features if name not in FEATURE_WIDTHS]
        if unknown or not self.features or len(set(self.features)) != len(self.features):
            raise _refuse(f"features are {self.features}, choose each once from {', '.join(FEATURE_WIDTHS)}")
        if self.frame == "camera" and "height" in self.features:
            raise _refuse("features: 'height' needs the frame 'table'")
        if not 0.001 <= self.voxel_size <= 0.05:
            raise _refuse(f"voxel_size is {self.voxel_size} m, it must lie in [0.001, 0.05]")
        if not self.levels <= self.grid_bits <= 14:
            raise _refuse(f"grid_bits is {self.grid_bits}, it must lie in [{self.levels}, 14]")
        if not self.orders or any(order not in ORDERS for order in self.orders):
            raise _refuse(f"orders are {self.orders}, choose from {', '.join(ORDERS)}")

    def _check_backbone(self) -> None:
        levels = self.levels
        if levels < 2 or len(self.encoder_depths) != levels:
            raise _refuse("encoder_channels and encoder_depths need the same length of at least 2")
        if len(self.decoder_channels) != levels - 1 or len(self.decoder_depths) != levels - 1:
            raise _refuse(
                f"decoder_channels and decoder_depths need {levels - 1} entries, one less than the encoder"
            )
        depths = (*self.encoder_depths, *self.decoder_depths)
        if min(*depths, self.head_dim, self.mlp_ratio, self.stem_convolutions) < 1:
            raise _refuse("depths, head_dim, mlp_ratio and stem_convolutions must be at least 1")
        for name in ("encoder_channels", "decoder_channels"):
            widths = getattr(self, name)
            if any(width < 1 or self._splits_a_head(width) for width in widths):
                raise _refuse(f"{name} are {widths}, each must be a multiple of head_dim {self.head_dim}")
        if not 2 <= self.patch_size <= 4096:
            raise _refuse(f"patch_size is {self.patch_size}, it must lie in [2, 4096]")
        if not 0.0 <= self.drop_path < 1.0:
            raise _refuse(f"drop_path is {self.drop_path}, it must lie in [0, 1)")

    def _splits_a_head(self, width: int) -> bool:
        return width > self.head_dim and width % self.head_dim > 0

    @property
    def levels(self) -> int:
        """Number of resolutions of the encoder."""
        return len(self.encoder_channels)

    @property
    def point_features(self) -> tuple[str, ...]:
        """The features that are computed per point; `residual` is computed per voxel."""
        return tuple(name for name in self.features if name != "residual")

    @property
    def feature_width(self) -> int:
        """Input channels of the network."""
        return sum(FEATURE_WIDTHS[name] for name in self.features)

    def to_dict(self) -> dict[str, Any]:
        """Plain lists, numbers and strings, for JSON."""
        return {
            key: list(value) if isinstance(value, tuple) else value for key, value in asdict(self).items()
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> NetworkConfig:
        """Inverse of `to_dict`; a missing key takes its default, an unknown or wrongly typed one is refused."""
        defaults = {field.name: getattr(cls(), field.name) for field in fields(cls)}
        unknown = sorted(set(values) - set(defaults))
        if unknown:
            raise _refuse(f"unknown keys {', '.join(unknown)}; known are {', '.join(defaults)}")
        return cls(**{key: _typed(key, value, defaults[key]) for key, value in values.items()})


def _typed(key: str, value: Any, default: Any) -> Any:
    """`value` as the type of `default`; lists become tuples, integers pass for floats."""
    if isinstance(default, tuple):
        if not isinstance(value, (list, tuple)) or any(type(item) is not type(default[0]) for item in value):
            raise _refuse(f"{key} is {value!r}, it must be a list of {type(default[0]).__name__}")
        return tuple(value)
    if isinstance(default, float) and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if type(value) is not type(default):
        raise _refuse(f"{key} is {value!r}, it must be a {type(default).__name__}")
    return value


_FAST = NetworkConfig()
_PAPER = NetworkConfig(
    name="paper",
    frame="camera",
    keep_table=True,
    features=("ones", "xyz"),
    voxel_size=0.004,
    encoder_channels=(32, 64, 128, 256, 512),
    encoder_depths=(2, 2, 2, 6, 2),
    decoder_channels=(64, 64, 128, 256),
    decoder_depths=(2, 2, 2, 2),
    head_dim=16,
    patch_size=1024,
    stem_convolutions=2,
    drop_path=0.3,
    rotation_hypotheses=1,
    module_two_convolutions=2,
)
PRESETS: dict[str, NetworkConfig] = {
    "paper": _PAPER,
    "fast": _FAST,
    "shapes": replace(_FAST, name="shapes", rotation_hypotheses=5, fixed_shapes=5),
    "tiny": replace(
        _FAST,
        name="tiny",
        encoder_channels=(16, 16, 32),
        encoder_depths=(1, 1, 1),
        decoder_channels=(16, 16),
        decoder_depths=(1, 1),
        head_dim=16,
        patch_size=32,
        rotation_hypotheses=2,
        module_two_width=16,
    ),
}
"""`paper`: PTv3-base widths, one rotation, camera frame. `fast`: what is shipped. `shapes`: as it, with five fixed
shapes of the hand in module II's place, to compare with. `tiny`: for tests."""
