"""ImageNet weights in the encoders. The files here have random weights of the same shape."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import Tensor
from torchvision.models import resnet18

from embodied_depth_trainer.data.batches import to_depth
from embodied_depth_trainer.data.pairs import PairRule, pairs_by_baseline
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.networks.imagenet_weights import load_imagenet
from embodied_depth_trainer.networks.registry import build_network, output_of
from embodied_depth_trainer.networks.resnet import Encoder
from embodied_depth_trainer.training.settings import Settings
from embodied_depth_trainer.training.trainer import Trainer

from ..rooms import room

RANGE_M = (0.1, 20.0)


@pytest.fixture
def published(tmp_path: Path) -> Path:
    """A file in the format that torchvision publishes."""
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
def test_image_encoders_compute_the_features_of_torchvisions_network(name: str, published: Path) -> None:
    network = build_network(name, RANGE_M, seed=1).eval()
    load_imagenet(network, str(published))
    encoders = {place: module for place, module in network.named_modules() if isinstance(module, Encoder)}
    image = torch.rand(1, 3, 32, 64)
    for place, encoder in encoders.items():
        planes = (image - encoder.mean) / encoder.std
        pairs = zip(encoder(image), torchvisions(published, planes), strict=True)
        # EDN's second encoder takes coarse depth, for which there are no ImageNet weights.
        takes_images = place != "coarse"
        assert all(torch.allclose(ours, theirs, atol=1e-5) for ours, theirs in pairs) == takes_images, place


def test_manydepths_teacher_gets_imagenet_weights_too(published: Path) -> None:
    network = build_network("manydepth_r18", RANGE_M, seed=1)
    load_imagenet(network, str(published))
    weights = network.state_dict()
    assert torch.equal(weights["rgb.stem.0.weight"], weights["teacher.rgb.stem.0.weight"])


def test_unsuitable_networks_and_weight_files_are_refused(published: Path, tmp_path: Path) -> None:
    with pytest.raises(TrainerError, match="omit --encoder"):
        load_imagenet(build_network("student", RANGE_M, seed=1), str(published))
    network = build_network("monodepth2_r18", RANGE_M, seed=1)
    with pytest.raises(TrainerError, match="does not exist"):
        load_imagenet(network, str(tmp_path / "none.pth"))
    weights = torch.load(published, weights_only=True)
    torch.save({**weights, "layer5.0.conv1.weight": torch.zeros(1)}, published)
    with pytest.raises(TrainerError, match="layer5"):
        load_imagenet(network, str(published))
    del weights["layer4.1.bn2.running_mean"]
    torch.save(weights, published)
    with pytest.raises(TrainerError, match="running_mean"):
        load_imagenet(network, str(published))


def test_training_starts_from_imagenet_weights_and_records_it(published: Path) -> None:
    frames = room(24)
    pairs = pairs_by_baseline(frames, PairRule())
    settings = Settings(network="monodepth2_r18", encoder=str(published))
    trainer = Trainer(frames, pairs, settings)
    stem = trainer.checkpoint().weights["rgb.stem.0.weight"]
    assert torch.equal(stem, torch.load(published, weights_only=True)["conv1.weight"])
    assert trainer.checkpoint().settings["encoder"] == str(published)


@pytest.mark.parametrize("name", ["monodepth2_r18", "manydepth_r18", "edn_r18"])
def test_an_untrained_network_predicts_typical_indoor_depth_for_any_range(name: str) -> None:
    for near, far, about_m in ((0.1, 20.0, 2.5), (0.3, 10.0, 2.5), (3.0, 20.0, 3.03)):
        network = build_network(name, (near, far), seed=1).eval()
        second = torch.zeros(1, 96, 8, 16) if name == "manydepth_r18" else torch.zeros(1, 3, 32, 64)
        rgb = torch.rand(1, 3, 32, 64)
        with torch.no_grad():
            x, _ = output_of(network, rgb, second)
        depth_m = to_depth(x, (near, far)).median().item()
        assert depth_m == pytest.approx(about_m, rel=0.25), (near, far)
