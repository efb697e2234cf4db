"""What a training reads of frames, whether they are in memory or on the disk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, Literal, Protocol, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from embodied_depth_trainer.data.frames import Intrinsics
from embodied_depth_trainer.errors import TrainerError

GivenDepth = Literal["coarse", "dense"]
"""The depth that a network is given besides the image."""
Value = TypeVar("Value", bound=np.generic)
Value_co = TypeVar("Value_co", bound=np.generic, covariant=True)


class Planes(Protocol[Value_co]):
    """Images, depths or lines of N frames. `planes[index]` copies the planes of the frames with these indices."""

    @property
    def shape(self) -> tuple[int, ...]: ...

    def __len__(self) -> int: ...

    @overload
    def __getitem__(self, index: NDArray[np.int64], /) -> NDArray[Value_co]: ...

    @overload
    def __getitem__(self, index: int, /) -> NDArray[Value_co]: ...


class FrameSet(Protocol):
    """N frames of one camera; `Frames` describes the fields."""

    @property
    def camera(self) -> Intrinsics: ...

    @property
    def rgb(self) -> Planes[np.uint8]: ...

    @property
    def t_world_camera(self) -> NDArray[np.float64]: ...

    @property
    def time_ns(self) -> NDArray[np.int64]: ...

    @property
    def run(self) -> NDArray[np.int32]: ...

    @property
    def coarse(self) -> Planes[np.uint16] | None: ...

    @property
    def dense(self) -> Planes[np.uint16] | None: ...

    @property
    def labels(self) -> Planes[np.uint16] | None: ...

    @property
    def lidar(self) -> Planes[np.uint16] | None: ...

    @property
    def held_out(self) -> NDArray[np.bool_] | None: ...

    def __len__(self) -> int: ...


class Concatenated(Generic[Value]):
    """Planes that lie in several parts, one after the other."""

    def __init__(self, parts: Sequence[Planes[Value]]) -> None:
        self.parts = parts
        self.first = np.cumsum([0, *(len(part) for part in parts)])

    @property
    def shape(self) -> tuple[int, ...]:
        return (len(self), *self.parts[0].shape[1:])

    def __len__(self) -> int:
        return int(self.first[-1])

    @overload
    def __getitem__(self, index: NDArray[np.int64], /) -> NDArray[Value]: ...

    @overload
    def __getitem__(self, index: int, /) -> NDArray[Value]: ...

    def __getitem__(self, index: int | NDArray[np.int64], /) -> NDArray[Value]:
        chosen = np.atleast_1d(np.asarray(index, np.int64))
        outside = (chosen < 0) | (chosen >= len(self))
        if outside.any():
            raise IndexError(f"frame {chosen[outside][0]} does not exist; there are {len(self)}")
        place = np.searchsorted(self.first, chosen, side="right") - 1
        # Part by part, because a part may have to be downloaded first.
        rows = {at: self.parts[place[at]][int(chosen[at] - self.first[place[at]])] for at in np.argsort(place)}
        return rows[0] if isinstance(index, int) else np.stack([rows[at] for at in range(len(chosen))])


@dataclass(frozen=True)
class LazyFrames:
    """Frames whose planes are read when they are used; `Frames` describes the fields."""

    camera: Intrinsics
    rgb: Planes[np.uint8]
    t_world_camera: NDArray[np.float64]
    time_ns: NDArray[np.int64]
    run: NDArray[np.int32]
    coarse: Planes[np.uint16] | None
    dense: Planes[np.uint16] | None
    labels: Planes[np.uint16] | None
    lidar: Planes[np.uint16] | None
    held_out: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.rgb)


def joined(parts: Sequence[FrameSet], first_runs: Sequence[int]) -> LazyFrames:
    """The frames of all parts, of which there is at least one. `first_runs` numbers the first run of each part."""
    camera = parts[0].camera
    for part in parts:
        if part.camera != camera:
            raise TrainerError(f"the runs have different cameras, {camera} and {part.camera}; train on them separately")
    runs = [part.run + first for part, first in zip(parts, first_runs, strict=True)]
    return LazyFrames(
        camera,
        Concatenated([part.rgb for part in parts]),
        np.concatenate([part.t_world_camera for part in parts]),
        np.concatenate([part.time_ns for part in parts]),
        np.concatenate(runs).astype(np.int32),
        _all_or_none([part.coarse for part in parts]),
        _all_or_none([part.dense for part in parts]),
        _all_or_none([part.labels for part in parts]),
        _all_or_none([part.lidar for part in parts]),
        np.concatenate([_held_out(part) for part in parts]),
    )


def giving(frames: FrameSet, depth: GivenDepth) -> LazyFrames:
    """The frames with this depth in the place of coarse depth, as a network is given it."""
    if depth == "dense" and frames.dense is None:
        raise TrainerError(
            "the network is given dense depth, which these frames lack; prepare the recordings again, or dump the "
            "dataset again with this firmware-host"
        )
    given = frames.coarse if depth == "coarse" else frames.dense
    return LazyFrames(
        frames.camera,
        frames.rgb,
        frames.t_world_camera,
        frames.time_ns,
        frames.run,
        given,
        frames.dense,
        frames.labels,
        frames.lidar,
        _held_out(frames),
    )


def _all_or_none(planes: Sequence[Planes[np.uint16] | None]) -> Planes[np.uint16] | None:
    present = [part for part in planes if part is not None]
    return Concatenated(present) if len(present) == len(planes) else None


def _held_out(part: FrameSet) -> NDArray[np.bool_]:
    return np.zeros(len(part), np.bool_) if part.held_out is None else part.held_out
