"""Recorded ticks as ROS messages. The recording already uses ROS frames and units (REP-103, REP-105)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import rosbags.typesys.stores.ros2_humble as ros
from numpy.typing import NDArray

from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.exports.grid import Grid
from embodied_depth_trainer.exports.poses import Pose, number
from embodied_depth_trainer.exports.sentences import LOST, Sentence

Time = ros.builtin_interfaces__msg__Time
Quaternion = tuple[float, float, float, float]
Translation = tuple[float, float, float]

# The recording stores the 32 bits of a hit that is not finite in the payload of a NaN with this prefix
# (`runtime/src/recording/scan.rs`).
_NOT_FINITE_HIT = np.uint64(0x7FF8_0001_0000_0000)
_PAYLOAD = np.uint64(0xFFFF_FFFF)
# The names that ROS uses; that of Kannala and Brandt is `equidistant`.
_DISTORTIONS = {"none": "plumb_bob", "plumb_bob": "plumb_bob", "kannala_brandt": "equidistant"}
_UNDISTORTED = [0.0] * 5


def time(time_ns: int) -> Time:
    """Seconds have 31 bits."""
    seconds, nanoseconds = divmod(time_ns, 1_000_000_000)
    if seconds >= 1 << 31:
        raise TrainerError(
            f"a time of {time_ns} ns exceeds the 68 years of a ROS time; the robot's clock was wrong, so this run can "
            "only be exported in other formats"
        )
    return Time(sec=seconds, nanosec=nanoseconds)


def _header(stamp: Time, frame: str) -> ros.std_msgs__msg__Header:
    return ros.std_msgs__msg__Header(stamp=stamp, frame_id=frame)


def _vector(x: float, y: float, z: float) -> ros.geometry_msgs__msg__Vector3:
    return ros.geometry_msgs__msg__Vector3(x=x, y=y, z=z)


def _quaternion(rotation_xyzw: Quaternion) -> ros.geometry_msgs__msg__Quaternion:
    x, y, z, w = rotation_xyzw
    return ros.geometry_msgs__msg__Quaternion(x=x, y=y, z=z, w=w)


def _pose(pose: Pose) -> ros.geometry_msgs__msg__Pose:
    position = ros.geometry_msgs__msg__Point(x=pose.x_m, y=pose.y_m, z=0.0)
    return ros.geometry_msgs__msg__Pose(position=position, orientation=_quaternion(pose.rotation_xyzw))


def image(stamp: Time, rgb: NDArray[np.uint8]) -> ros.sensor_msgs__msg__Image:
    height, width, _ = rgb.shape
    return ros.sensor_msgs__msg__Image(
        header=_header(stamp, "camera_optical"),
        height=height,
        width=width,
        encoding="rgb8",
        is_bigendian=0,
        step=3 * width,
        data=rgb.reshape(-1),
    )


def camera_info(stamp: Time, camera: dict[str, Any]) -> ros.sensor_msgs__msg__CameraInfo:
    fx, fy, cx, cy = (float(camera[key]) for key in ("fx", "fy", "cx", "cy"))
    distortion = camera["distortion"]
    return ros.sensor_msgs__msg__CameraInfo(
        header=_header(stamp, "camera_optical"),
        height=camera["height"],
        width=camera["width"],
        distortion_model=_DISTORTIONS[distortion["model"]],
        d=np.array(distortion.get("coefficients", _UNDISTORTED), np.float64),
        k=np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1], np.float64),
        r=np.eye(3).reshape(-1),
        p=np.array([fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0], np.float64),
        binning_x=0,
        binning_y=0,
        # The whole image.
        roi=ros.sensor_msgs__msg__RegionOfInterest(x_offset=0, y_offset=0, height=0, width=0, do_rectify=False),
    )


def first_beam_ns(recorded: dict[str, Any]) -> int:
    """Time of the beam that a scan measures first, on the robot's clock. A revolution begins straight behind."""
    first, _ = _first_beam(recorded)
    rotated = 0.5 + (-first if recorded.get("clockwise", False) else first) / math.tau
    return int(recorded["time_ns"]) + round(rotated * int(recorded["period_ns"]))


def _first_beam(recorded: dict[str, Any]) -> tuple[float, float]:
    """Direction of the beam that is measured first, and the angle from it to the next; negative for clockwise."""
    first, step = number(recorded["angle_min_rad"]), number(recorded["angle_increment_rad"])
    if recorded.get("clockwise", False):
        return first + step * max(0, recorded["beams"] - 1), -step
    return first, step


def laser_scan(stamp: Time, recorded: dict[str, Any], ranges: NDArray[np.float64]) -> ros.sensor_msgs__msg__LaserScan:
    """The beams in the order in which they were measured, as ROS has them; `stamp` is the time of the first one. Beams
    without a distance follow REP-117: no return is +infinity, too near is -infinity, not measured is NaN."""
    first, step = _first_beam(recorded)
    ordered = ranges[::-1] if recorded.get("clockwise", False) else ranges
    period_s = recorded["period_ns"] * 1e-9
    return ros.sensor_msgs__msg__LaserScan(
        header=_header(stamp, "laser"),
        angle_min=first,
        angle_max=first + step * max(0, len(ranges) - 1),
        angle_increment=step,
        time_increment=period_s * abs(step) / math.tau,
        scan_time=period_s,
        range_min=number(recorded["range_min_m"]),
        range_max=number(recorded["range_max_m"]),
        ranges=distances(ordered),
        intensities=np.zeros(0, np.float32),
    )


def distances(recorded: NDArray[np.float64]) -> NDArray[np.float32]:
    """As the scanner reported them, in 32 bits. Raises a `ValueError` for a number that the robot does not write."""
    found = recorded.astype(np.float32)
    differs = ~np.isnan(recorded) & (found.astype(np.float64) != recorded)
    if differs.any():
        raise ValueError(f"{recorded[differs][0]} is not a distance that the robot writes")
    bits = np.ascontiguousarray(recorded).view(np.uint64)
    hits = (bits & ~_PAYLOAD) == _NOT_FINITE_HIT
    found[hits] = (bits[hits] & _PAYLOAD).astype(np.uint32).view(np.float32)
    return found


def odometry(stamp: Time, t_odom_base: Pose, twist: tuple[float, float]) -> ros.nav_msgs__msg__Odometry:
    """The covariances are zero, which means unknown in ROS: they are not recorded."""
    linear_mps, angular_radps = twist
    velocity = ros.geometry_msgs__msg__Twist(
        linear=_vector(linear_mps, 0.0, 0.0), angular=_vector(0.0, 0.0, angular_radps)
    )
    return ros.nav_msgs__msg__Odometry(
        header=_header(stamp, "odom"),
        child_frame_id="base_link",
        pose=ros.geometry_msgs__msg__PoseWithCovariance(pose=_pose(t_odom_base), covariance=np.zeros(36)),
        twist=ros.geometry_msgs__msg__TwistWithCovariance(twist=velocity, covariance=np.zeros(36)),
    )


@dataclass(frozen=True)
class Frame:
    """The pose of the frame `child` in the frame `parent`."""

    parent: str
    child: str
    translation_m: Translation
    rotation_xyzw: Quaternion

    @staticmethod
    def of(parent: str, child: str, pose: Pose) -> Frame:
        return Frame(parent, child, (pose.x_m, pose.y_m, 0.0), pose.rotation_xyzw)

    @staticmethod
    def mount(child: str, recorded: dict[str, Any]) -> Frame:
        """Where a sensor is on the robot."""
        x, y, z = recorded["translation_m"]
        i, j, k, w = recorded["rotation_xyzw"]
        return Frame("base_link", child, (x, y, z), (i, j, k, w))


def transforms(stamp: Time, frames: Sequence[Frame]) -> ros.tf2_msgs__msg__TFMessage:
    return ros.tf2_msgs__msg__TFMessage(
        transforms=[
            ros.geometry_msgs__msg__TransformStamped(
                header=_header(stamp, frame.parent),
                child_frame_id=frame.child,
                transform=ros.geometry_msgs__msg__Transform(
                    translation=_vector(*frame.translation_m), rotation=_quaternion(frame.rotation_xyzw)
                ),
            )
            for frame in frames
        ]
    )


def occupancy_grid(stamp: Time, grid: Grid) -> ros.nav_msgs__msg__OccupancyGrid:
    rows, columns = grid.occupancy.shape
    return ros.nav_msgs__msg__OccupancyGrid(
        header=_header(stamp, "map"),
        info=ros.nav_msgs__msg__MapMetaData(
            map_load_time=stamp,
            resolution=grid.cell_m,
            width=columns,
            height=rows,
            origin=_pose(Pose(*grid.origin_m, 0.0)),
        ),
        data=grid.occupancy.reshape(-1),
    )


def diagnostics(
    stamp: Time, decision: dict[str, Any], sentences: Sequence[Sentence]
) -> ros.diagnostic_msgs__msg__DiagnosticArray:
    """One status: what the robot decided, and why."""
    status = ros.diagnostic_msgs__msg__DiagnosticStatus(
        level=max((sentence.level for sentence in sentences), default=0),
        name="embodied_depth: decision",
        message="; ".join(sentence.text for sentence in sentences),
        hardware_id="",
        values=[ros.diagnostic_msgs__msg__KeyValue(key=key, value=value) for key, value in _values(decision)],
    )
    return ros.diagnostic_msgs__msg__DiagnosticArray(header=_header(stamp, ""), status=[status])


def _values(decision: dict[str, Any]) -> list[tuple[str, str]]:
    """The numbers of a decision. What a decision does not have is absent."""
    values = [("tick", str(decision["tick"])), *_speeds("desired", decision["desired"])]
    if sent := decision.get("sent"):
        values += _speeds("sent", sent)
    if goal_m := decision.get("goal_m"):
        values += zip(("goal_x_m", "goal_y_m"), map(_digits, goal_m), strict=True)
    if lost := decision.get("lost"):
        values.append(("lost", LOST.get(lost, lost)))
    return values


def _speeds(name: str, command: dict[str, float]) -> list[tuple[str, str]]:
    return [
        (f"{name}_{unit}", _digits(command[key])) for unit, key in (("mps", "linear_mps"), ("radps", "angular_radps"))
    ]


def _digits(value: float) -> str:
    """The shortest decimal number that is read back to the same bits, without an exponent."""
    return np.format_float_positional(value, trim="-")
