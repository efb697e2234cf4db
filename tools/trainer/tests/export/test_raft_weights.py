"""Conversion of princeton-vl's RAFT weights to torchvision's names."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torchvision.models.optical_flow import raft_large, raft_small

from embodied_depth_trainer.export.flow import FlowExport, build, shifted_images
from embodied_depth_trainer.export.onnx_writer import ExportError
from embodied_depth_trainer.export.raft_weights import from_princeton, torchvision_name
from embodied_depth_trainer.networks.state_dict import load_state_dict


def test_every_published_weight_maps_to_one_name(raft_small_weights: Path) -> None:
    weights = load_state_dict(raft_small_weights)
    mapped = from_princeton(weights)
    assert len(mapped) == len(weights)
    expected = raft_small(weights=None).state_dict()
    assert mapped.keys() == expected.keys()
    assert all(mapped[name].shape == expected[name].shape for name in expected)


def test_the_published_weights_find_a_known_motion(raft_small_weights: Path) -> None:
    graph, source = build(FlowExport("raft_small", (128, 160), 8, raft_small_weights))
    assert source.startswith("princeton-vl")
    first, second = shifted_images((128, 160), 3)
    with torch.no_grad():
        flow = graph(first, second)[0, :, 16:-16, 16:-16]
    error = (flow - torch.tensor([5.0, 3.0]).view(2, 1, 1)).norm(dim=0).median()
    assert error < 0.3


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("fnet.conv1.weight", "feature_encoder.convnormrelu.0.weight"),
        ("cnet.norm1.running_mean", "context_encoder.convnormrelu.1.running_mean"),
        ("cnet.layer2.0.downsample.1.bias", "context_encoder.layer2.0.downsample.1.bias"),
        ("update_block.gru.convz2.bias", "update_block.recurrent_block.convgru2.convz.bias"),
        ("update_block.mask.2.weight", "mask_predictor.conv.weight"),
    ],
)
def test_names_of_the_large_network_match_torchvision(old: str, new: str) -> None:
    assert torchvision_name(old) == new
    assert new in raft_large(weights=None).state_dict()


def test_an_unknown_weight_is_refused_by_name() -> None:
    with pytest.raises(ExportError, match=r"decoder\.conv"):
        from_princeton({"module.decoder.conv": torch.zeros(1)})
    with pytest.raises(ExportError, match=r"update_block\.head"):
        from_princeton({"module.update_block.head": torch.zeros(1)})


def test_the_two_names_of_one_norm_must_agree() -> None:
    block = "module.cnet.layer2.0"
    weights = {f"{block}.norm3.bias": torch.zeros(2), f"{block}.downsample.1.bias": torch.zeros(2)}
    assert list(from_princeton(weights)) == ["context_encoder.layer2.0.downsample.1.bias"]
    with pytest.raises(ExportError, match="differ"):
        from_princeton({**weights, f"{block}.norm3.bias": torch.ones(2)})
