"""The network's configuration: one frozen, validated dataclass, and its presets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

from dgs_description.parameters import from_values, parameter

FEATURE_WIDTHS = {"ones": 1, "height": 1, "xyz": 3, "ray": 3, "residual": 3}
"""Channels of every input feature; see `batch.input_features` and `batch.collate`."""

ORDERS = ("h", "ht", "z", "zt")
"""Space-filling curves: Hilbert and Morton (z), and both with x and y exchanged."""


@dataclass(frozen=True)
class NetworkConfig:
    """Everything that defines the network's shape and its input; refused with a ValueError where it does not fit."""

    name: str = parameter("fast", "Of the preset.")
    frame: str = parameter(
        "table",
        "Input frame: table (gravity aligned, origin on the table top) or camera (optical, as in the paper).",
        choices=("table", "camera"),
    )
    keep_table: bool = parameter(False, "All table points, as in the paper; else only those near objects.")
    features: tuple[str, ...] = parameter(
        ("ones", "height", "ray", "residual"), "Input features.", choices=tuple(FEATURE_WIDTHS)
    )
    voxel_size: float = parameter(0.008, "Edge of a voxel at the finest level [m].", 0.001, 0.05)
    grid_bits: int = parameter(
        10, "Per axis of a voxel's address: a cloud extends over 2^bits at most.", 2, 14
    )
    encoder_channels: tuple[int, ...] = parameter((32, 64, 64, 96, 160), "Per level, finest first.", 1)
    encoder_depths: tuple[int, ...] = parameter((2, 2, 2, 2, 2), "Blocks per level.", 1)
    decoder_channels: tuple[int, ...] = parameter((32, 64, 64, 96), "Per level but the coarsest.", 1)
    decoder_depths: tuple[int, ...] = parameter((2, 2, 2, 2), "Blocks per level.", 1)
    head_dim: int = parameter(32, "Channels of an attention head.", 1)
    mlp_ratio: int = parameter(4, "Hidden channels of an MLP per channel.", 1)
    patch_size: int = parameter(128, "Rows of an attention window.", 2, 4096)
    orders: tuple[str, ...] = parameter(ORDERS, "Curves that windows follow, block by block.", choices=ORDERS)
    stem_convolutions: int = parameter(1, "Stacked in the stem; two see the 5x5x5 voxels of PTv3's stem.", 1)
    drop_path: float = parameter(0.0, "Probability at the last block of the encoder.", 0.0, 0.99)
    rotation_hypotheses: int = parameter(
        8,
        "Rotations per point: 1 is the paper; more compete for ambiguous grasps, ranked by their logits.",
        1,
    )
    fixed_shapes: int = parameter(
        0, "So many shapes of the hand in module II's place, one per hypothesis (`FixedShapes`).", 0
    )
    module_two_width: int = parameter(64, "Channels.", 1)
    module_two_layers: int = parameter(1, "Of attention.", 1)
    module_two_convolutions: int = parameter(1, "After the attention.", 1)
    offset_scale: float = parameter(0.05, "Of one unit of the offset head's output [m].", 0.001, 1.0)

    def __post_init__(self) -> None:
        if not self.features or len(set(self.features)) != len(self.features):
            raise ValueError(f"features are {self.features}, each once is wanted")
        if self.frame == "camera" and "height" in self.features:
            raise ValueError("features: 'height' needs the frame 'table'")
        levels = self.levels
        if not self.orders or self.grid_bits < levels:
            raise ValueError(
                f"orders must not be empty, and grid_bits at least {levels}, the number of levels"
            )
        if levels < 2 or len(self.encoder_depths) != levels:
            raise ValueError("encoder_channels and encoder_depths need the same length of at least 2")
        if len(self.decoder_channels) != levels - 1 or len(self.decoder_depths) != levels - 1:
            raise ValueError(
                f"decoder_channels and decoder_depths need {levels - 1} entries, one less than the encoder"
            )
        if self.fixed_shapes not in (0, self.rotation_hypotheses):
            raise ValueError(f"fixed_shapes is {self.fixed_shapes}, it must be 0 or rotation_hypotheses")
        for width in (*self.encoder_channels, *self.decoder_channels, self.module_two_width):
            if width > self.head_dim and width % self.head_dim > 0:
                raise ValueError(
                    f"{width} of encoder_channels, decoder_channels, module_two_width is no multiple of head_dim"
                )

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
        """Inverse of `to_dict`; a missing key takes its default. Raises DgsError PARAMETER_INVALID, naming the key."""
        return from_values(cls, values)


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
