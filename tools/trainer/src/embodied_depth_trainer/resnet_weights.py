"""ImageNet's weights for the ResNet18 that look at pictures: from a file, or torchvision's published ones where there
is a network.

Godard et al. 2019 and the paper begin with them. Nothing here needs them: without, weights are random.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from urllib.error import URLError

from torch import Tensor, nn
from torchvision.models import ResNet18_Weights

from .errors import TrainerError
from .networks import Encoder
from .onnx_file import load_state_dict, load_strictly

PUBLISHED = "imagenet"
# The classifier, which no encoder has.
CLASSIFIER = "fc."
# An encoder's names and ResNet18's.
_PLACES = [(r"^stem\.0\.", "conv1."), (r"^stem\.1\.", "bn1.")]


def begin_with(network: nn.Module, source: str) -> None:
    """Gives every encoder of pictures the weights of `source`: a file with the state dict of a ResNet18 under
    torchvision's names, or `imagenet` for the published ones."""
    encoders = [module for name, module in network.named_modules() if name.split(".")[-1] == "rgb"]
    if not encoders:
        raise TrainerError("this network has no ResNet18 to begin with; leave --encoder out")
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
            f"torchvision's weights {weights} cannot be fetched ({problem}); give --encoder FILE, or leave it out"
        ) from None
    return found


def resnet18_name(name: str) -> str:
    """What torchvision calls an encoder's weight."""
    for pattern, place in _PLACES:
        name = re.sub(pattern, place, name)
    return re.sub(r"^layers\.(\d)\.", lambda found: f"layer{int(found[1]) + 1}.", name)


def _for_encoder(encoder: Encoder, weights: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Under the encoder's names; what has no place keeps its own and is refused."""
    places = {resnet18_name(name): name for name in encoder.state_dict()}
    return {places.get(name, name): value for name, value in weights.items() if not name.startswith(CLASSIFIER)}
