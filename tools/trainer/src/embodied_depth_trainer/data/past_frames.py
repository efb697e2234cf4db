"""Coarse depth as the paper computes it, for comparison with the robot's own.

Dense optical flow leads to one or two past frames a fixed number of frames apart, and depth is the least-squares fit
to their rays (Liu et al., Embodied Depth Prediction; its code takes one frame, 5 before). With it, EDN can be trained
as in the paper. The robot computes coarse depth differently, with references chosen by their parallax
(`runtime/src/perception`), and that is what an exported network receives valid.

A pixel's ray b (z = 1) at depth z lies at z R b + t in a past camera, where flow observes it along the unit bearing o.
Its distance to that ray is |z s + r| with s = o x R b and r = o x t. Summed over past frames, z = -sum s.r / sum s.s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from embodied_depth_trainer.data.frames import Frames, Intrinsics
from embodied_depth_trainer.errors import TrainerError

# `--video_interval` of the paper's code.
GAP = 5
# Range of depths that the paper accepts, metres.
RANGE_M = (0.1, 20.0)
# Standard deviation of the flow in pixels; it converts parallax into a probability.
FLOW_ERROR_PX = 0.5
# Depth within 25 % of the truth is correct, as for the metric delta1.
LN_TOLERANCE = np.log(1.25)
# Frames farther apart than this are not neighbours in a video.
MAX_BASELINE_M = 1.0
# A baseline shorter than this is noise of the pose.
MIN_BASELINE_M = 1e-3

Planes = NDArray[np.float64]


@dataclass(frozen=True)
class PastFrames:
    """The past frames that coarse depth is computed from."""

    count: int
    """Number of past frames, 1 or 2."""
    gap: int = GAP
    """Frames from the target to the last past frame, and from that to the one before."""

    def __post_init__(self) -> None:
        if self.count not in (1, 2) or self.gap < 1:
            raise TrainerError(
                f"{self.count} past frames {self.gap} apart are not valid; give 1 or 2, at least 1 apart"
            )

    def of(self, frames: Frames, target: int) -> list[int]:
        """The past frames of one target that are in its run and at another position."""
        found = []
        for past in range(target - self.gap, target - self.gap * self.count - 1, -self.gap):
            if past < 0 or frames.run[past] != frames.run[target]:
                break
            step = frames.t_world_camera[past, :3, 3] - frames.t_world_camera[target, :3, 3]
            if MIN_BASELINE_M <= np.linalg.norm(step) <= MAX_BASELINE_M:
                found.append(past)
        return found


def with_past_coarse(frames: Frames, past: PastFrames) -> Frames:
    """Replaces coarse depth by depth computed from the frames' own past."""
    grey = [_grey(image) for image in frames.rgb]
    planes = []
    for target in range(len(frames)):
        poses = []
        flows = []
        for index in past.of(frames, target):
            poses.append(np.linalg.inv(frames.t_world_camera[index]) @ frames.t_world_camera[target])
            flows.append(_flow(grey[target], grey[index]))
        depth_m, confidence = triangulate(frames.camera, flows, poses)
        planes.append(np.stack([1000 * depth_m, 65535 * confidence]).round().astype(np.uint16))
    return replace(frames, coarse=np.stack(planes))


def triangulate(camera: Intrinsics, flows: Sequence[Planes], t_past_target: Sequence[Planes]) -> tuple[Planes, Planes]:
    """z-depth in metres (0: none) and the probability that it is correct within 25 %, [H, W] each. `flows` [H, W, 2]
    lead from the target's pixels to those of each past camera."""
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    rays = _rays(camera, u, v)
    information = np.zeros(u.shape)
    product = np.zeros(u.shape)
    for flow, pose in zip(flows, t_past_target, strict=True):
        past_u = u + flow[..., 0]
        past_v = v + flow[..., 1]
        bearings = _rays(camera, past_u, past_v)
        bearings /= np.linalg.norm(bearings, axis=-1, keepdims=True)
        s = np.cross(bearings, rays @ pose[:3, :3].T)
        r = np.cross(bearings, pose[:3, 3])
        own_information = (s * s).sum(-1)
        own_product = (s * r).sum(-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            own_m = -own_product / own_information
        inside = (past_u >= 0) & (past_u <= camera.width - 1) & (past_v >= 0) & (past_v <= camera.height - 1)
        # NaN, which is the result without parallax, fails both comparisons.
        counts = inside & (own_m > RANGE_M[0]) & (own_m < RANGE_M[1])
        information += np.where(counts, own_information, 0)
        product += np.where(counts, own_product, 0)
    valid = information > 0
    depth_m = np.where(valid, -product / np.where(valid, information, 1), 0)
    # The standard deviation of ln depth is that of a bearing over the sine of the parallax.
    sine = np.sqrt(information) / np.linalg.norm(rays, axis=-1)
    return depth_m, np.where(valid, 1 - np.exp(-LN_TOLERANCE * sine * camera.fx / FLOW_ERROR_PX), 0)


def _rays(camera: Intrinsics, u: Planes, v: Planes) -> Planes:
    return np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)


def _grey(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    grey: NDArray[np.uint8] = (image @ np.array([0.299, 0.587, 0.114])).round().astype(np.uint8)
    return grey


def _flow(target: NDArray[np.uint8], past: NDArray[np.uint8]) -> Planes:
    """Optical flow by dense inverse search (Kroeger et al. 2016): the paper's RAFT takes 100 times as long on a CPU."""
    try:
        import cv2
    except ImportError:
        raise TrainerError(
            "past frames need optical flow, which needs OpenCV; run `pip install opencv-python-headless`"
        ) from None
    found = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM).calc(target, past, None)  # type: ignore[call-overload]
    flow: Planes = np.asarray(found, np.float64)
    return flow
