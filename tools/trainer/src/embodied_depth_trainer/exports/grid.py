"""The map that the robot records for viewers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

# Bytes of a cell: four of colour, then the occupancy.
CELL_BYTES = 5


class FoxgloveGrid(Protocol):
    """The fields used of `foxglove.Grid`; the class itself comes from the recording's schema."""

    pose: Any
    cell_size: Any
    column_count: int
    cell_stride: int
    data: bytes


@dataclass(frozen=True)
class Grid:
    """A map as in nav_msgs/OccupancyGrid."""

    origin_m: tuple[float, float]
    """Corner of the first cell, in `map`."""
    cell_m: float
    occupancy: NDArray[np.int8]
    """[rows, columns]: -1 unknown, 0 free to 100 occupied."""

    @staticmethod
    def of(message: FoxgloveGrid) -> Grid | None:
        """`None` when the message is not one that the recorder writes."""
        row_bytes = CELL_BYTES * message.column_count
        if message.cell_stride != CELL_BYTES or row_bytes == 0 or len(message.data) % row_bytes:
            return None
        cells = np.frombuffer(message.data, np.int8).reshape(-1, message.column_count, CELL_BYTES)
        at = message.pose.position
        return Grid((at.x, at.y), message.cell_size.x, cells[:, :, CELL_BYTES - 1])
