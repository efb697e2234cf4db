"""ImageNet weights for the ResNet18 image encoders, from a file or downloaded from torchvision.

Godard et al. 2019 and the paper start from them. They are optional: without them, weights are random.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from urllib.error import URLError

from torch import Tensor, nn
from torchvision.models import ResNet18_Weights

from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.networks.resnet import Encoder
from embodied_depth_trainer.networks.state_dict import load_state_dict, load_strictly

PUBLISHED = "imagenet"
# Prefix of the classifier's weights, which encoders do not have.
CLASSIFIER = "fc."
# Names in an encoder and in torchvision's ResNet18.
_PLACES = [(r"^stem\.0\.", "conv1."), (r"^stem\.1\.", "bn1.")]


def load_imagenet(network: nn.Module, source: str) -> None:
    """Loads the weights of `source` into every image encoder: a file with the state dict of a ResNet18 under
    torchvision's names, or `imagenet` for the published ones."""
    encoders = [module for name, module in network.named_modules() if name.split(".")[-1] == "rgb"]
    if not encoders:
        raise TrainerError("this network has no ResNet18 image encoder; omit --encoder")
    weights = _published() if source == PUBLISHED else load_state_dict(Path(source))
    for encoder in encoders:
        assert isinstance(encoder, Encoder)
        load_strictly(encoder, _for_encoder(encoder, weights), source)


def _published() -> Mapping[str, Tensor]:
    weights = ResNet18_Weights.IMAGENET1K_V1
    try:
        found: Mapping[str, Tensor] = weights.get_state_dict(progress=False, check_hash=True)
    except (URLError, OSError) as problem:
        raise TrainerError(
            f"torchvision's weights {weights} cannot be downloaded ({problem}); give --encoder FILE, or omit it"
        ) from None
    return found


def resnet18_name(name: str) -> str:
    """torchvision's name of an encoder's weight."""
    for pattern, place in _PLACES:
        name = re.sub(pattern, place, name)
    return re.sub(r"^layers\.(\d)\.", lambda found: f"layer{int(found[1]) + 1}.", name)


def _for_encoder(encoder: Encoder, weights: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Renames the weights to the encoder's names; unknown ones keep their names, so that loading refuses them."""
    places = {resnet18_name(name): name for name in encoder.state_dict()}
    return {places.get(name, name): value for name, value in weights.items() if not name.startswith(CLASSIFIER)}
