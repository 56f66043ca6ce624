"""Weights files: half-precision tensors, a JSON sidecar with configuration and SHA-256, and the checks at load."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.files import atomic_write
from dgs_description.hand import DEFAULT, HAND, check_hand
from dgs_grasp_planner.network.config import NetworkConfig
from dgs_grasp_planner.network.dgs_net import DGSNet

SUFFIX = ".pt"


@dataclass(frozen=True)
class ModelInfo:
    """What a weights file says about itself: name, SHA-256 (hex) of the file, configuration, free notes, hand."""

    model_id: str
    sha256: str
    config: NetworkConfig
    notes: dict[str, Any] = field(default_factory=dict)
    hand: str = DEFAULT


def file_sha256(path: Path) -> str:
    """Hex SHA-256 of a file's bytes."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def save_network(
    net: DGSNet, directory: Path | str, name: str, notes: dict[str, Any] | None = None
) -> ModelInfo:
    """Write `<name>.pt` (fp16) and `<name>.json` to `directory`; the notes (data, step) are for the model card."""
    path = Path(directory) / f"{name}{SUFFIX}"
    state = {key: value.detach().cpu().half().clone() for key, value in net.state_dict().items()}
    with atomic_write(path) as file:
        torch.save(state, file)
    info = ModelInfo(name, file_sha256(path), net.config, dict(notes or {}), HAND.name)
    sidecar = {
        "model_id": info.model_id,
        "file": path.name,
        "sha256": info.sha256,
        "hand": info.hand,
        "parameters": net.parameter_count,
        "config": info.config.to_dict(),
        "notes": info.notes,
    }
    with atomic_write(path.with_suffix(".json"), "w") as file:
        file.write(json.dumps(sidecar, indent=1) + "\n")
    return info


def read_info(directory: Path | str, name: str) -> ModelInfo:
    """The sidecar of a model, after comparing the weights file with its SHA-256.

    Raises:
        DgsError: WEIGHTS_MISSING or WEIGHTS_ALTERED.
    """
    path = Path(directory) / f"{name}{SUFFIX}"
    sidecar = path.with_suffix(".json")
    for file in (path, sidecar):
        if not file.is_file():
            raise DgsError(
                ErrorCode.WEIGHTS_MISSING,
                f"weights file {file} does not exist: check the models directory and the name",
            )
    try:
        values = json.loads(sidecar.read_text(encoding="utf-8"))
        name, sha256, notes = str(values["model_id"]), str(values["sha256"]), dict(values["notes"])
        config, hand = NetworkConfig.from_dict(values["config"]), str(values.get("hand", DEFAULT))
        info = ModelInfo(name, sha256, config, notes, hand)
    except (ValueError, KeyError, TypeError, AttributeError, DgsError) as error:
        raise DgsError(
            ErrorCode.WEIGHTS_ALTERED, f"{sidecar} is no valid description of a model: {error}"
        ) from error
    actual = file_sha256(path)
    if actual != info.sha256:
        raise DgsError(
            ErrorCode.WEIGHTS_ALTERED,
            f"{path} has SHA-256 {actual[:12]}..., {sidecar.name} says {info.sha256[:12]}...: fetch the file again",
        )
    return info


def load_trunk(net: DGSNet, directory: Path | str, name: str) -> ModelInfo:
    """Take over all tensors; of weights for another hand those that do not depend on it.

    Those are all but the rows of the last layer that answer joints (the offset comes first), and fixed shapes.

    Raises:
        DgsError: WEIGHTS_MISSING or WEIGHTS_ALTERED.
    """
    info = read_info(directory, name)
    given = torch.load(Path(directory) / f"{name}{SUFFIX}", map_location="cpu", weights_only=True)
    own = net.state_dict()
    foreign = info.hand != HAND.name
    for key, value in given.items():
        if foreign and key.startswith("two.out."):
            own[key] = torch.cat([value[:3].to(own[key].dtype), own[key][3:]])
        elif not (foreign and key == "two.shapes"):
            own[key] = value
    net.load_state_dict(own)
    return info


def mean_of(net: DGSNet, other: DGSNet, share: float) -> DGSNet:
    """The network whose weights are `share` of the other's, and the rest of the first one's.

    Raises:
        DgsError: REQUEST_INVALID: their configurations differ.
    """
    if net.config != other.config:
        raise DgsError(ErrorCode.REQUEST_INVALID, "weights of different configurations have no mean")
    mean, mine, theirs = DGSNet(net.config), net.state_dict(), other.state_dict()
    mean.load_state_dict({key: torch.lerp(mine[key], theirs[key], share) for key in mine})
    return mean.eval()


def load_network(
    directory: Path | str, name: str, device: torch.device | str = "cpu", dtype: torch.dtype = torch.float32
) -> tuple[DGSNet, ModelInfo]:
    """Network in evaluation mode with the weights of `<name>.pt`.

    Raises:
        DgsError: WEIGHTS_MISSING, WRONG_HAND, or WEIGHTS_ALTERED (checksum, or tensors that do not fit the
            configuration).
    """
    info = read_info(directory, name)
    check_hand(info.hand, f"the weights {name}")
    path = Path(directory) / f"{name}{SUFFIX}"
    net = DGSNet(info.config)
    try:
        net.load_state_dict(torch.load(path, map_location="cpu", weights_only=True))
    except Exception as error:  # torch raises many kinds here; all mean the same to the user
        raise DgsError(
            ErrorCode.WEIGHTS_ALTERED, f"{path} does not fit its configuration: {error}"
        ) from error
    return net.to(device=device, dtype=dtype).eval(), info
