"""The small U-Net: sizes, and its weights there and back."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.unet import UNet

WIDTHS = (8, 12, 16)


@pytest.mark.parametrize("size", [(240, 424), (120, 160), (50, 70)])
def test_any_even_size_goes_through(size: tuple[int, int]) -> None:
    assert UNet(4, 3, WIDTHS).eval()(torch.zeros(2, 4, *size)).shape == (2, 3, *size)


def test_weights_there_and_back_and_what_is_none_is_refused(tmp_path: Path) -> None:
    torch.manual_seed(0)
    net, file = UNet(4, 3, WIDTHS).eval(), tmp_path / "sub/net.pt"
    net.save(file, {"step": 1})
    x = torch.rand(1, 4, 32, 48)
    with torch.inference_mode():
        again = UNet(4, 3, WIDTHS).loaded(file, ErrorCode.DEPTH_SOURCE, "make it")
        torch.testing.assert_close(again(x), net(x), atol=2e-2, rtol=2e-2)
    (tmp_path / "text.pt").write_text("no weights")
    torch.save({"weights": {"other": torch.zeros(1)}}, tmp_path / "other.pt")
    for name, words in (
        ("none", "make them with `make it`"),
        ("text", "holds other"),
        ("other", "holds other"),
    ):
        with pytest.raises(DgsError, match=words) as refused:
            UNet(4, 3, WIDTHS).loaded(tmp_path / f"{name}.pt", ErrorCode.DEPTH_SOURCE, "make it")
        assert refused.value.code == ErrorCode.DEPTH_SOURCE
