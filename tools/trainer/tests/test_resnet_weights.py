"""ResNet18's published weights in the networks' encoders. The files here have random weights: the shape is the same."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import Tensor
from torchvision.models import resnet18

from embodied_depth_trainer.batches import to_depth
from embodied_depth_trainer.depth_networks import build_network, output_of
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.networks import Encoder
from embodied_depth_trainer.pairs import PairRule, pairs_by_baseline
from embodied_depth_trainer.resnet_weights import begin_with
from embodied_depth_trainer.training import Settings, Trainer

from .rooms import room

RANGE_M = (0.1, 20.0)


@pytest.fixture
def published(tmp_path: Path) -> Path:
    """A file such as torchvision publishes."""
    torch.manual_seed(7)
    file = tmp_path / "resnet18.pth"
    torch.save(resnet18(weights=None).state_dict(), file)
    return file


def torchvisions(file: Path, planes: Tensor) -> list[Tensor]:
    """The feature maps of torchvision's own ResNet18."""
    net = resnet18(weights=None).eval()
    net.load_state_dict(torch.load(file, weights_only=True))
    features = [net.relu(net.bn1(net.conv1(planes)))]
    last = net.maxpool(features[0])
    for layer in (net.layer1, net.layer2, net.layer3, net.layer4):
        last = layer(last)
        features.append(last)
    return features


@pytest.mark.parametrize("name", ["monodepth2_r18", "sc_depth_r18", "manydepth_r18", "edn_r18", "edn_r18_concat"])
def test_every_encoder_of_pictures_sees_what_torchvisions_network_sees(name: str, published: Path) -> None:
    network = build_network(name, RANGE_M, seed=1).eval()
    begin_with(network, str(published))
    seeing = {place: module for place, module in network.named_modules() if isinstance(module, Encoder)}
    picture = torch.rand(1, 3, 32, 64)
    for place, encoder in seeing.items():
        planes = (picture - encoder.mean) / encoder.std
        pairs = zip(encoder(picture), torchvisions(published, planes), strict=True)
        # EDN's second encoder looks at coarse depth, which ImageNet knows nothing of.
        is_picture = place != "coarse"
        assert all(torch.allclose(ours, theirs, atol=1e-5) for ours, theirs in pairs) == is_picture, place


def test_manydepths_teacher_begins_with_them_too(published: Path) -> None:
    network = build_network("manydepth_r18", RANGE_M, seed=1)
    begin_with(network, str(published))
    weights = network.state_dict()
    assert torch.equal(weights["rgb.stem.0.weight"], weights["teacher.rgb.stem.0.weight"])


def test_a_network_without_a_resnet18_a_broken_file_and_one_of_another_network_are_refused(
    published: Path, tmp_path: Path
) -> None:
    with pytest.raises(TrainerError, match="leave --encoder out"):
        begin_with(build_network("student", RANGE_M, seed=1), str(published))
    network = build_network("monodepth2_r18", RANGE_M, seed=1)
    with pytest.raises(TrainerError, match="does not exist"):
        begin_with(network, str(tmp_path / "none.pth"))
    weights = torch.load(published, weights_only=True)
    torch.save({**weights, "layer5.0.conv1.weight": torch.zeros(1)}, published)
    with pytest.raises(TrainerError, match="layer5"):
        begin_with(network, str(published))
    del weights["layer4.1.bn2.running_mean"]
    torch.save(weights, published)
    with pytest.raises(TrainerError, match="running_mean"):
        begin_with(network, str(published))


def test_a_training_begins_with_them_and_its_checkpoint_says_so(published: Path) -> None:
    frames = room(24)
    pairs, settings = pairs_by_baseline(frames, PairRule()), Settings(network="monodepth2_r18", encoder=str(published))
    trainer = Trainer(frames, pairs, settings)
    stem = trainer.checkpoint().weights["rgb.stem.0.weight"]
    assert torch.equal(stem, torch.load(published, weights_only=True)["conv1.weight"])
    assert trainer.checkpoint().settings["encoder"] == str(published)


@pytest.mark.parametrize("name", ["monodepth2_r18", "manydepth_r18", "edn_r18"])
def test_an_untrained_network_begins_in_the_middle_of_a_room_whatever_its_range(name: str) -> None:
    for near, far, about_m in ((0.1, 20.0, 2.5), (0.3, 10.0, 2.5), (3.0, 20.0, 3.03)):
        network = build_network(name, (near, far), seed=1).eval()
        volume, coarse = torch.zeros(1, 96, 8, 16), torch.zeros(1, 3, 32, 64)
        rgb, second = torch.rand(1, 3, 32, 64), volume if name == "manydepth_r18" else coarse
        with torch.no_grad():
            x, _ = output_of(network, rgb, second)
        depth_m = to_depth(x, (near, far)).median().item()
        assert depth_m == pytest.approx(about_m, rel=0.25), (near, far)
