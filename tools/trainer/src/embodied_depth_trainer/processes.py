"""Data-parallel training by several processes (`torchrun --nproc-per-node N -m embodied_depth_trainer train ...`).

Each process computes its share of every batch. Up to rounding they learn what one process learns from the whole batch:
gradients, batch norms and the pixel counts that errors are divided by are combined over all shares. In a single
process every function here does nothing.
"""

from __future__ import annotations

import os
from typing import Any

import torch
from torch import Tensor, distributed, nn

from embodied_depth_trainer.errors import TrainerError


def start(device: str) -> str:
    """Joins the processes that `torchrun` started, if any, and returns this process's device; see `pick_device`."""
    device = pick_device(device)
    if int(os.environ.get("WORLD_SIZE", "1")) > 1 and not distributed.is_initialized():
        distributed.init_process_group("nccl" if device.startswith("cuda") else "gloo")
    return f"cuda:{os.environ['LOCAL_RANK']}" if device == "cuda" and count() > 1 else device


def pick_device(name: str) -> str:
    """The device that `auto`, `cpu` or `cuda` stands for: `auto` is the GPU if PyTorch can use one."""
    usable = torch.cuda.is_available()
    if name == "cuda" and not usable:
        raise TrainerError(
            "PyTorch can use no GPU here (--device cuda); install its CUDA build and a driver, or give --device cpu"
        )
    return "cuda" if name == "cuda" or (name == "auto" and usable) else "cpu"


def count() -> int:
    return distributed.get_world_size() if distributed.is_initialized() else 1


def rank() -> int:
    return distributed.get_rank() if distributed.is_initialized() else 0


def is_same_in_all(digits: str, device: str) -> bool:
    """Whether the first 15 hexadecimal digits are the same in all processes."""
    if count() == 1:
        return True
    number = int(digits[:15], 16)
    largest = torch.tensor([number, -number], device=device)
    distributed.all_reduce(largest, distributed.ReduceOp.MAX)
    return largest.tolist() == [number, -number]


def wait_for_all() -> None:
    if count() > 1:
        distributed.barrier()


class _Mean(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:  # noqa: ANN401
        total = x.detach().clone()
        distributed.all_reduce(total)
        return total / count()

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> Tensor:  # noqa: ANN401
        total = gradient.contiguous().clone()
        distributed.all_reduce(total)
        return total / count()


def mean(x: Tensor) -> Tensor:
    """Mean over all processes; differentiable."""
    if count() == 1:
        return x
    result: Tensor = _Mean.apply(x)
    return result


def average_gradients(network: nn.Module) -> None:
    """Replaces every gradient by its mean over all processes, in one transfer."""
    gradients = [weight.grad for weight in network.parameters() if weight.grad is not None]
    if count() == 1 or not gradients:
        return
    together = torch.cat([gradient.flatten() for gradient in gradients])
    distributed.all_reduce(together)
    together /= count()
    for gradient, part in zip(gradients, torch.split(together, [g.numel() for g in gradients]), strict=True):
        gradient.copy_(part.view(gradient.shape))


class _SharedBatchNorm(nn.BatchNorm2d):
    """Batch norm with the statistics of all processes' shares. PyTorch's SyncBatchNorm needs a GPU."""

    def forward(self, x: Tensor) -> Tensor:
        if not self.training or self.running_mean is None or self.running_var is None:
            return super().forward(x)
        planes = x.float()
        average, square = mean(torch.stack([planes.mean((0, 2, 3)), (planes * planes).mean((0, 2, 3))])).unbind()
        variance = square - average * average
        samples = count() * x.numel() / x.shape[1]
        with torch.no_grad():
            self.running_mean.lerp_(average, self.momentum or 0.0)
            self.running_var.lerp_(variance * (samples / (samples - 1)), self.momentum or 0.0)
            if self.num_batches_tracked is not None:
                self.num_batches_tracked.add_(1)
        scale = self.weight * torch.rsqrt(variance + self.eps)
        shift = self.bias - average * scale
        return torch.addcmul(shift.view(1, -1, 1, 1), planes, scale.view(1, -1, 1, 1)).to(x.dtype)


def share_batch_norms(network: nn.Module) -> nn.Module:
    """Makes the batch norms of a network use the statistics of all processes."""
    if count() > 1:
        for module in network.modules():
            if type(module) is nn.BatchNorm2d:
                # Changing the class keeps the weights and their names in checkpoints.
                module.__class__ = _SharedBatchNorm
    return network
