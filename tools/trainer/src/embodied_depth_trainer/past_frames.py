"""The paper's own coarse depth: dense optical flow to one or two past frames, a fixed number of frames apart, and the
depth that fits their rays best in least squares (Liu et al., Embodied Depth Prediction; its code takes one, 5 before).

With it EDN can be trained as in the paper. The robot computes coarse depth in another way, with references chosen by
their parallax (`runtime/src/perception`), and that is what an exported network would get there: this is for comparison.

A pixel's ray b (z = 1) at depth z lies at z R b + t in a past camera, where flow says it is seen along the unit
bearing o. Its distance to that ray is |z s + r| with s = o x R b and r = o x t; summed over past frames,
z = -sum s.r / sum s.s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .errors import TrainerError
from .frames import Frames, Intrinsics

# The code's `--video_interval`.
GAP = 5
# Depth that the paper takes, metres.
RANGE_M = (0.1, 20.0)
# Standard deviation of the flow, pixels; it makes parallax a probability.
FLOW_ERROR_PX = 0.5
RIGHT = np.log(1.25)
# Farther apart, two pictures are no neighbours in a video.
MAX_BASELINE_M = 1.0
# A step shorter than this is noise of the pose.
MIN_BASELINE_M = 1e-3

Planes = NDArray[np.float64]


@dataclass(frozen=True)
class PastFrames:
    """Which past frames coarse depth is computed from."""

    count: int
    """1 or 2."""
    gap: int = GAP
    """Frames to the last one, and from that to the one before."""

    def __post_init__(self) -> None:
        if self.count not in (1, 2) or self.gap < 1:
            raise TrainerError(f"{self.count} past frames {self.gap} apart are none; give 1 or 2, at least 1 apart")

    def of(self, frames: Frames, target: int) -> list[int]:
        """Those of one picture that are in its run and moved."""
        found = []
        for past in range(target - self.gap, target - self.gap * self.count - 1, -self.gap):
            if past < 0 or frames.run[past] != frames.run[target]:
                break
            step = frames.t_world_camera[past, :3, 3] - frames.t_world_camera[target, :3, 3]
            if MIN_BASELINE_M <= np.linalg.norm(step) <= MAX_BASELINE_M:
                found.append(past)
        return found


def with_past_coarse(frames: Frames, past: PastFrames) -> Frames:
    """The frames with coarse depth from their own past."""
    grey = [_grey(picture) for picture in frames.rgb]
    planes = []
    for target in range(len(frames)):
        poses, flows = [], []
        for index in past.of(frames, target):
            poses.append(np.linalg.inv(frames.t_world_camera[index]) @ frames.t_world_camera[target])
            flows.append(_flow(grey[target], grey[index]))
        depth_m, confidence = triangulate(frames.camera, flows, poses)
        planes.append(np.stack([1000 * depth_m, 65535 * confidence]).round().astype(np.uint16))
    return replace(frames, coarse=np.stack(planes))


def triangulate(camera: Intrinsics, flows: Sequence[Planes], t_past_target: Sequence[Planes]) -> tuple[Planes, Planes]:
    """z-depth in metres (0: none) and the probability that it is right within 25 %, [H, W] each. `flows` [H, W, 2]
    lead from this picture's pixels to those of each past camera."""
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    rays = _rays(camera, u, v)
    information, product = np.zeros(u.shape), np.zeros(u.shape)
    for flow, pose in zip(flows, t_past_target, strict=True):
        there_u, there_v = u + flow[..., 0], v + flow[..., 1]
        bearings = _rays(camera, there_u, there_v)
        bearings /= np.linalg.norm(bearings, axis=-1, keepdims=True)
        s, r = np.cross(bearings, rays @ pose[:3, :3].T), np.cross(bearings, pose[:3, 3])
        own_information, own_product = (s * s).sum(-1), (s * r).sum(-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            own_m = -own_product / own_information
        inside = (there_u >= 0) & (there_u <= camera.width - 1) & (there_v >= 0) & (there_v <= camera.height - 1)
        # NaN, as without any parallax, is in no range.
        counts = inside & (own_m > RANGE_M[0]) & (own_m < RANGE_M[1])
        information += np.where(counts, own_information, 0)
        product += np.where(counts, own_product, 0)
    there = information > 0
    depth_m = np.where(there, -product / np.where(there, information, 1), 0)
    # The standard deviation of ln depth is that of a bearing over the sine of the parallax.
    sine = np.sqrt(information) / np.linalg.norm(rays, axis=-1)
    return depth_m, np.where(there, 1 - np.exp(-RIGHT * sine * camera.fx / FLOW_ERROR_PX), 0)


def _rays(camera: Intrinsics, u: Planes, v: Planes) -> Planes:
    return np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)


def _grey(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    grey: NDArray[np.uint8] = (picture @ np.array([0.299, 0.587, 0.114])).round().astype(np.uint8)
    return grey


def _flow(target: NDArray[np.uint8], past: NDArray[np.uint8]) -> Planes:
    """By dense inverse search (Kroeger et al. 2016): the paper's RAFT takes 100 times as long on a CPU."""
    try:
        import cv2
    except ImportError:
        raise TrainerError(
            "past frames need optical flow, and OpenCV is not installed; `pip install opencv-python-headless`"
        ) from None
    found = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM).calc(target, past, None)  # type: ignore[call-overload]
    flow: Planes = np.asarray(found, np.float64)
    return flow
