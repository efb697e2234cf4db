"""The topics of a bag."""

from __future__ import annotations

from dataclasses import dataclass

from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

_UNLIMITED = QosTime(0, 0)
LATCHED = Qos(
    QosHistory.KEEP_LAST,
    1,
    QosReliability.RELIABLE,
    QosDurability.TRANSIENT_LOCAL,
    _UNLIMITED,
    _UNLIMITED,
    QosLiveliness.AUTOMATIC,
    _UNLIMITED,
    False,
)
"""Late subscribers receive the last message, as from Nav2's map_server."""


@dataclass(frozen=True)
class Topic:
    """A topic and the type of its messages."""

    name: str
    type: str
    qos: tuple[Qos, ...] = ()
    """The offered profile; empty for the default."""


IMAGE = Topic("/camera/image", "sensor_msgs/msg/Image")
CAMERA_INFO = Topic("/camera/camera_info", "sensor_msgs/msg/CameraInfo")
SCAN = Topic("/scan", "sensor_msgs/msg/LaserScan")
ODOM = Topic("/odom", "nav_msgs/msg/Odometry")
TF = Topic("/tf", "tf2_msgs/msg/TFMessage")
TF_STATIC = Topic("/tf_static", "tf2_msgs/msg/TFMessage", (LATCHED,))
MAP = Topic("/map", "nav_msgs/msg/OccupancyGrid", (LATCHED,))
DIAGNOSTICS = Topic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
