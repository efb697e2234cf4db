"""The losses that the authors of each network train it with."""

from __future__ import annotations

from embodied_depth_trainer.losses.reprojection import LossOptions

# Weights of Bian et al. 2019 (SC-SfMLearner). Networks that are not listed use the defaults.
RECIPES = {"sc_depth_r18": LossOptions(smoothness=0.1, geometry=0.5, auto_mask=True, both_ways=True)}


def recipe(network: str) -> LossOptions:
    """The options of the loss that the network's authors train it with."""
    return RECIPES.get(network, LossOptions())
