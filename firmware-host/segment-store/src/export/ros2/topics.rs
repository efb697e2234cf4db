//! The topics of the bag. The message definitions (those of ROS 2 Humble to Kilted) are included for readers without ROS.

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Topic {
    Image,
    CameraInfo,
    Scan,
    Odom,
    Tf,
    TfStatic,
    Map,
    Diagnostics,
}

impl Topic {
    pub(super) const ALL: [Self; 8] = [
        Self::Image,
        Self::CameraInfo,
        Self::Scan,
        Self::Odom,
        Self::Tf,
        Self::TfStatic,
        Self::Map,
        Self::Diagnostics,
    ];

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Image => "/camera/image",
            Self::CameraInfo => "/camera/camera_info",
            Self::Scan => "/scan",
            Self::Odom => "/odom",
            Self::Tf => "/tf",
            Self::TfStatic => "/tf_static",
            Self::Map => "/map",
            Self::Diagnostics => "/diagnostics",
        }
    }

    pub(super) fn message_type(self) -> &'static str {
        match self {
            Self::Image => "sensor_msgs/msg/Image",
            Self::CameraInfo => "sensor_msgs/msg/CameraInfo",
            Self::Scan => "sensor_msgs/msg/LaserScan",
            Self::Odom => "nav_msgs/msg/Odometry",
            Self::Tf | Self::TfStatic => "tf2_msgs/msg/TFMessage",
            Self::Map => "nav_msgs/msg/OccupancyGrid",
            Self::Diagnostics => "diagnostic_msgs/msg/DiagnosticArray",
        }
    }

    /// The offered QoS profile in the format of rosbag2; empty for the default. Static transforms and the map are latched, so that
    /// late subscribers receive them, as from Nav2's map_server.
    pub(super) fn qos(self) -> &'static str {
        if matches!(self, Self::TfStatic | Self::Map) { LATCHED } else { "" }
    }

    /// The message definition with all definitions that it uses, in MCAP's `ros2msg` format.
    pub(super) fn schema(self) -> String {
        let (own, uses): (_, &[(&str, &str)]) = match self {
            Self::Image => (IMAGE, &[HEADER, TIME]),
            Self::CameraInfo => (CAMERA_INFO, &[REGION_OF_INTEREST, HEADER, TIME]),
            Self::Scan => (LASER_SCAN, &[HEADER, TIME]),
            Self::Odom => (
                ODOMETRY,
                &[
                    POSE_COVARIANCE,
                    TWIST_COVARIANCE,
                    POSE,
                    TWIST,
                    POINT,
                    QUATERNION,
                    VECTOR,
                    HEADER,
                    TIME,
                ],
            ),
            Self::Tf | Self::TfStatic => {
                (TF_MESSAGE, &[TRANSFORM_STAMPED, TRANSFORM, VECTOR, QUATERNION, HEADER, TIME])
            }
            Self::Map => (OCCUPANCY_GRID, &[MAP_META_DATA, POSE, POINT, QUATERNION, HEADER, TIME]),
            Self::Diagnostics => (DIAGNOSTIC_ARRAY, &[DIAGNOSTIC_STATUS, KEY_VALUE, HEADER, TIME]),
        };
        let line = "=".repeat(80);
        uses.iter()
            .fold(own.to_owned(), |text, (name, used)| format!("{text}{line}\nMSG: {name}\n{used}"))
    }
}

/// Keep last 1, reliable, transient local, no deadline, no lifespan, automatic liveliness. The numbers are from `rmw/types.h`.
const LATCHED: &str = "- history: 1\n  depth: 1\n  reliability: 1\n  durability: 1\n  deadline:\n    sec: 0\n    nsec: 0\n  \
     lifespan:\n    sec: 0\n    nsec: 0\n  liveliness: 1\n  liveliness_lease_duration:\n    sec: 0\n    nsec: 0\n  \
     avoid_ros_namespace_conventions: false";

const IMAGE: &str = "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\n\
     uint8[] data\n";
const CAMERA_INFO: &str = "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\n\
     float64[9] k\nfloat64[9] r\nfloat64[12] p\nuint32 binning_x\nuint32 binning_y\nsensor_msgs/RegionOfInterest roi\n";
const LASER_SCAN: &str = "std_msgs/Header header\nfloat32 angle_min\nfloat32 angle_max\nfloat32 angle_increment\n\
     float32 time_increment\nfloat32 scan_time\nfloat32 range_min\nfloat32 range_max\nfloat32[] ranges\n\
     float32[] intensities\n";
const ODOMETRY: &str = "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n\
     geometry_msgs/TwistWithCovariance twist\n";
const TF_MESSAGE: &str = "geometry_msgs/TransformStamped[] transforms\n";

const OCCUPANCY_GRID: &str = "std_msgs/Header header\nnav_msgs/MapMetaData info\nint8[] data\n";
const DIAGNOSTIC_ARRAY: &str =
    "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status\n";

const TIME: (&str, &str) = ("builtin_interfaces/Time", "int32 sec\nuint32 nanosec\n");
const HEADER: (&str, &str) =
    ("std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id\n");
const REGION_OF_INTEREST: (&str, &str) = (
    "sensor_msgs/RegionOfInterest",
    "uint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\nbool do_rectify\n",
);
const POINT: (&str, &str) = ("geometry_msgs/Point", "float64 x\nfloat64 y\nfloat64 z\n");
const VECTOR: (&str, &str) = ("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z\n");
const QUATERNION: (&str, &str) =
    ("geometry_msgs/Quaternion", "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n");
const POSE: (&str, &str) =
    ("geometry_msgs/Pose", "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n");
const POSE_COVARIANCE: (&str, &str) =
    ("geometry_msgs/PoseWithCovariance", "geometry_msgs/Pose pose\nfloat64[36] covariance\n");
const TWIST: (&str, &str) =
    ("geometry_msgs/Twist", "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n");
const TWIST_COVARIANCE: (&str, &str) =
    ("geometry_msgs/TwistWithCovariance", "geometry_msgs/Twist twist\nfloat64[36] covariance\n");
const TRANSFORM: (&str, &str) = (
    "geometry_msgs/Transform",
    "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n",
);
const TRANSFORM_STAMPED: (&str, &str) = (
    "geometry_msgs/TransformStamped",
    "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n",
);
const MAP_META_DATA: (&str, &str) = (
    "nav_msgs/MapMetaData",
    "builtin_interfaces/Time map_load_time\nfloat32 resolution\nuint32 width\nuint32 height\ngeometry_msgs/Pose origin\n",
);
const DIAGNOSTIC_STATUS: (&str, &str) = (
    "diagnostic_msgs/DiagnosticStatus",
    "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\nbyte level\nstring name\nstring message\nstring hardware_id\n\
     diagnostic_msgs/KeyValue[] values\n",
);
const KEY_VALUE: (&str, &str) = ("diagnostic_msgs/KeyValue", "string key\nstring value\n");
