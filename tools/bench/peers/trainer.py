#!/usr/bin/env python3
"""The trainer and its textbook reference: steps of Monodepth2-R18 at 96x320, batch 12, and the loss alone.

Arguments: device and threads. The request `shares` is answered with the milliseconds of a step's parts instead of
seconds.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable

import numpy as np
import torch
from embodied_depth_trainer.data.frames import Frames, Intrinsics
from embodied_depth_trainer.losses.reprojection import LossOptions, View, self_supervision
from embodied_depth_trainer.networks.monodepth2 import Monodepth2
from embodied_depth_trainer.export.onnx_writer import random_image
from embodied_depth_trainer.data.pairs import pairs_by_gap
from embodied_depth_trainer.training.settings import Settings
from embodied_depth_trainer.training.trainer import Trainer
from embodied_depth_trainer.data.batches import to_depth
from textbook import TextbookLoss

SIZE = (96, 320)
BATCH = 12
FRAMES = 48
RANGE_M = (0.1, 20.0)
# Number of times that a step's parts are timed.
REPEATS = 5


def walk() -> Frames:
    """A straight path through random images, 3 cm per frame."""
    height, width = SIZE
    rgb = [(255 * random_image(SIZE, seed)[0].permute(1, 2, 0)).byte().numpy() for seed in range(FRAMES)]
    poses = np.tile(np.eye(4), (FRAMES, 1, 1))
    poses[:, 2, 3] = 0.03 * np.arange(FRAMES)
    camera = Intrinsics(width, height, width / 2, width / 2, (width - 1) / 2, (height - 1) / 2)
    return Frames(camera, np.stack(rgb), poses, np.arange(FRAMES, dtype=np.int64), np.zeros(FRAMES, np.int32))


class Bench:
    def __init__(self, device: str) -> None:
        frames = walk()
        pairs = pairs_by_gap(frames, 4)

        def trainer(amp: bool) -> Trainer:
            # The textbook does not fit the exposure either.
            settings = Settings("monodepth2_r18", batch=BATCH, amp=amp, loss=LossOptions(exposure=False))
            return Trainer(frames, pairs, settings, device)

        self.device = device
        self.float32 = trainer(False)
        self.bfloat16 = trainer(True)
        self.network = Monodepth2().to(device).train()
        self.optimizer = torch.optim.Adam(self.network.parameters(), lr=1e-4)
        self.textbook = TextbookLoss(*SIZE, self.float32.projector.k)
        self.textbook_steps = 0
        self.batch = self.float32.batch(0)
        self.depth_m = to_depth(random_image(SIZE, 99)[:, :1].repeat(BATCH, 1, 1, 1) ** 4, RANGE_M).to(device)
        self.depth_m.requires_grad_()

    def textbook_step(self) -> None:
        batch = self.float32.batch(self.textbook_steps)
        self.textbook_steps += 1
        self.optimizer.zero_grad()
        depth_m = to_depth(self.network(batch.augmented), RANGE_M)
        loss = self.textbook(depth_m, batch.image, batch.source_images, batch.t_source_target)
        loss.backward()
        self.optimizer.step()
        loss.item()

    def loss(self) -> None:
        batch = self.batch
        project = self.float32.projector
        sources = zip(batch.source_images, batch.t_source_target, strict=True)
        views = [View(image, project(self.depth_m, pose)) for image, pose in sources]
        loss = self_supervision(batch.image, 1 / self.depth_m, views, LossOptions(exposure=False))
        torch.autograd.grad(loss, self.depth_m)

    def textbook_loss(self) -> None:
        batch = self.batch
        loss = self.textbook(self.depth_m, batch.image, batch.source_images, batch.t_source_target)
        torch.autograd.grad(loss, self.depth_m)

    def seconds(self, work: Callable[[], object]) -> float:
        self.wait()
        start = time.perf_counter()
        work()
        self.wait()
        return time.perf_counter() - start

    def wait(self) -> None:
        if self.device != "cpu":
            torch.cuda.synchronize()

    def shares(self, trainer: Trainer) -> str:
        """Medians of the parts of a step, timed one after another, and the share of full steps spent waiting for data."""

        def forward() -> None:
            self.disparity = trainer.predict(batch.augmented, batch.coarse)

        def loss() -> None:
            self.value = trainer.loss_of(batch, *self.disparity)

        def backward() -> None:
            trainer.optimizer.zero_grad(set_to_none=True)
            self.value.backward()

        parts: dict[str, list[float]] = {}
        for _ in range(REPEATS):
            batch = trainer.batch(trainer.step)
            work = {"data": lambda: trainer.batch(trainer.step), "forward": forward, "loss": loss, "backward": backward}
            for name, part in (work | {"optimizer": trainer.optimizer.step}).items():
                parts.setdefault(name, []).append(self.seconds(part))
        waited = trainer.batches.waited_s
        whole = self.seconds(lambda: [trainer.advance() for _ in range(REPEATS)])
        idle = (trainer.batches.waited_s - waited) / whole
        return " ".join([f"{idle:.5f}", *(f"{name} {1000 * statistics.median(s):.0f} ms," for name, s in parts.items())])


def main() -> None:
    torch.set_num_threads(int(sys.argv[2]))
    bench = Bench(sys.argv[1])
    work: dict[str, Callable[[], object]] = {
        "step": bench.float32.advance,
        "step_amp": bench.bfloat16.advance,
        "textbook_step": bench.textbook_step,
        "loss": bench.loss,
        "textbook_loss": bench.textbook_loss,
    }
    print("ready", flush=True)
    for line in sys.stdin:
        name = line.strip()
        if name in ("shares", "shares_amp"):
            print(bench.shares(bench.bfloat16 if name.endswith("amp") else bench.float32), flush=True)
        else:
            # Runs the work once before it is timed, because a training runs without another process in between.
            work[name]()
            print(bench.seconds(work[name]), flush=True)


if __name__ == "__main__":
    main()
