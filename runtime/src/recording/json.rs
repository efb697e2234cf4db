//! The plain data of `hal` in JSON.
//!
//! A finite number is written as the shortest text that is read back to the same bits. NaN and infinities, which JSON
//! does not have, are written as strings of their bits, because a replay needs them too.

use crate::imu::ImuInput;
use crate::outside_pose::{OutsideInput, OutsidePose};
use hal::{CameraModel, Distortion, Pose2, Pose3, ScanGeometry, Twist2, WheelFeedback};
use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error as _};

/// An `f64` that survives JSON bit for bit.
#[derive(Debug, Clone, Copy)]
pub(super) struct Exact(pub f64);

#[derive(Deserialize)]
#[serde(untagged)]
enum NumberOrBits {
    Number(f64),
    Bits(String),
}

impl Serialize for Exact {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if self.0.is_finite() {
            serializer.serialize_f64(self.0)
        } else {
            serializer.collect_str(&format_args!("{:016x}", self.0.to_bits()))
        }
    }
}

impl<'de> Deserialize<'de> for Exact {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        match NumberOrBits::deserialize(deserializer)? {
            NumberOrBits::Number(number) => Ok(Self(number)),
            NumberOrBits::Bits(text) => {
                let bits = u64::from_str_radix(&text, 16)
                    .map_err(|_| D::Error::custom(format!("`{text}` is not a number")))?;
                Ok(Self(f64::from_bits(bits)))
            }
        }
    }
}

/// [`WheelFeedback`] without nested objects, so that plotting tools list its fields.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct WheelJson {
    time_ns: u64,
    x_m: Exact,
    y_m: Exact,
    yaw_rad: Exact,
    linear_mps: Exact,
    angular_radps: Exact,
    contact: bool,
    /// Absent in recordings of bases without cliff sensors, and in older ones.
    #[serde(default, skip_serializing_if = "core::ops::Not::not")]
    cliff: bool,
}

impl From<&WheelFeedback> for WheelJson {
    fn from(wheel: &WheelFeedback) -> Self {
        Self {
            time_ns: wheel.time_ns,
            x_m: Exact(wheel.odom.x_m),
            y_m: Exact(wheel.odom.y_m),
            yaw_rad: Exact(wheel.odom.yaw_rad),
            linear_mps: Exact(wheel.twist.linear_mps),
            angular_radps: Exact(wheel.twist.angular_radps),
            contact: wheel.contact,
            cliff: wheel.cliff,
        }
    }
}

impl From<&WheelJson> for WheelFeedback {
    fn from(json: &WheelJson) -> Self {
        Self {
            time_ns: json.time_ns,
            // Not `Pose2::new`: that wraps the yaw, and a replay needs the bits that were recorded.
            odom: Pose2 { x_m: json.x_m.0, y_m: json.y_m.0, yaw_rad: json.yaw_rad.0 },
            twist: Twist2 { linear_mps: json.linear_mps.0, angular_radps: json.angular_radps.0 },
            contact: json.contact,
            cliff: json.cliff,
        }
    }
}

/// A [`Pose2`] in JSON.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(super) struct PoseJson {
    x_m: Exact,
    y_m: Exact,
    yaw_rad: Exact,
}

impl From<&Pose2> for PoseJson {
    fn from(pose: &Pose2) -> Self {
        Self { x_m: Exact(pose.x_m), y_m: Exact(pose.y_m), yaw_rad: Exact(pose.yaw_rad) }
    }
}

impl From<&PoseJson> for Pose2 {
    fn from(json: &PoseJson) -> Self {
        // Not `Pose2::new`: that wraps the yaw, and a replay needs the bits that were recorded.
        Self { x_m: json.x_m.0, y_m: json.y_m.0, yaw_rad: json.yaw_rad.0 }
    }
}

/// An [`ImuInput`] in JSON.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct ImuJson {
    gaps: u32,
    yaw_rad: Exact,
    yaw_at_scan_rad: Exact,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    tilt_rad: Option<Exact>,
}

impl From<&ImuInput> for ImuJson {
    fn from(imu: &ImuInput) -> Self {
        Self {
            gaps: imu.gaps,
            yaw_rad: Exact(imu.yaw_rad),
            yaw_at_scan_rad: Exact(imu.yaw_at_scan_rad),
            tilt_rad: imu.tilt_rad.map(Exact),
        }
    }
}

impl From<&ImuJson> for ImuInput {
    fn from(json: &ImuJson) -> Self {
        Self {
            gaps: json.gaps,
            yaw_rad: json.yaw_rad.0,
            yaw_at_scan_rad: json.yaw_at_scan_rad.0,
            tilt_rad: json.tilt_rad.as_ref().map(|angle| angle.0),
        }
    }
}

/// An [`OutsideInput`] in JSON.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct OutsideJson {
    time_ns: u64,
    pose: PoseJson,
    wheel_odom: PoseJson,
}

impl From<&OutsideInput> for OutsideJson {
    fn from(OutsideInput { outside, wheel_odom }: &OutsideInput) -> Self {
        Self {
            time_ns: outside.time_ns,
            pose: PoseJson::from(&outside.pose),
            wheel_odom: PoseJson::from(wheel_odom),
        }
    }
}

impl From<&OutsideJson> for OutsideInput {
    fn from(json: &OutsideJson) -> Self {
        let outside = OutsidePose { time_ns: json.time_ns, pose: Pose2::from(&json.pose) };
        Self { outside, wheel_odom: Pose2::from(&json.wheel_odom) }
    }
}

/// Time and geometry of a scan, because `foxglove.LaserScan` has neither the angle increment nor the range limits.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct ScanJson {
    pub time_ns: u64,
    angle_min_rad: Exact,
    angle_increment_rad: Exact,
    beams: usize,
    range_min_m: Exact,
    range_max_m: Exact,
    period_ns: u64,
    #[serde(skip_serializing_if = "std::ops::Not::not", default)]
    clockwise: bool,
}

impl ScanJson {
    pub(super) fn new(time_ns: u64, geometry: &ScanGeometry) -> Self {
        Self {
            time_ns,
            angle_min_rad: Exact(geometry.angle_min_rad),
            angle_increment_rad: Exact(geometry.angle_increment_rad),
            beams: geometry.beams,
            range_min_m: Exact(f64::from(geometry.range_min_m)),
            range_max_m: Exact(f64::from(geometry.range_max_m)),
            period_ns: geometry.period_ns,
            clockwise: geometry.clockwise,
        }
    }

    pub(super) fn geometry(&self) -> ScanGeometry {
        ScanGeometry {
            angle_min_rad: self.angle_min_rad.0,
            angle_increment_rad: self.angle_increment_rad.0,
            beams: self.beams,
            range_min_m: self.range_min_m.0 as f32,
            range_max_m: self.range_max_m.0 as f32,
            period_ns: self.period_ns,
            clockwise: self.clockwise,
        }
    }
}

/// [`Pose3`] for `#[serde(with)]`: translation in metres, rotation as quaternion x y z w.
pub(super) mod pose3 {
    use super::*;

    #[derive(Serialize, Deserialize)]
    struct Json {
        translation_m: [f64; 3],
        rotation_xyzw: [f64; 4],
    }

    pub(crate) fn serialize<S: Serializer>(pose: &Pose3, serializer: S) -> Result<S::Ok, S::Error> {
        let t = &pose.translation;
        let q = &pose.rotation;
        Json { translation_m: [t.x, t.y, t.z], rotation_xyzw: [q.i, q.j, q.k, q.w] }
            .serialize(serializer)
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Pose3, D::Error> {
        let json = Json::deserialize(deserializer)?;
        let [x, y, z] = json.translation_m;
        let [i, j, k, w] = json.rotation_xyzw;
        let rotation = Quaternion::new(w, i, j, k);
        if (rotation.norm() - 1.0).abs() > 1e-6 {
            return Err(D::Error::custom("rotation_xyzw is not a unit quaternion"));
        }
        // Normalising it again would change its last bits.
        Ok(Pose3::from_parts(Translation3::new(x, y, z), UnitQuaternion::new_unchecked(rotation)))
    }
}

/// [`CameraModel`] for `#[serde(with)]`.
pub(super) mod camera_model {
    use super::*;

    #[derive(Serialize, Deserialize)]
    struct Json {
        width: usize,
        height: usize,
        fx: f64,
        fy: f64,
        cx: f64,
        cy: f64,
        distortion: DistortionJson,
    }

    #[derive(Serialize, Deserialize)]
    #[serde(tag = "model", content = "coefficients", rename_all = "snake_case")]
    enum DistortionJson {
        None,
        PlumbBob([f64; 5]),
        KannalaBrandt([f64; 4]),
    }

    pub(crate) fn serialize<S: Serializer>(
        model: &CameraModel,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        let distortion = match model.distortion {
            Distortion::None => DistortionJson::None,
            Distortion::PlumbBob(coefficients) => DistortionJson::PlumbBob(coefficients),
            Distortion::Fisheye(coefficients) => DistortionJson::KannalaBrandt(coefficients),
            _ => {
                return Err(serde::ser::Error::custom(
                    "a lens model that the recording format does not know",
                ));
            }
        };
        let CameraModel { width, height, fx, fy, cx, cy, .. } = *model;
        Json { width, height, fx, fy, cx, cy, distortion }.serialize(serializer)
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<CameraModel, D::Error> {
        let Json { width, height, fx, fy, cx, cy, distortion } = Json::deserialize(deserializer)?;
        let distortion = match distortion {
            DistortionJson::None => Distortion::None,
            DistortionJson::PlumbBob(coefficients) => Distortion::PlumbBob(coefficients),
            DistortionJson::KannalaBrandt(coefficients) => Distortion::Fisheye(coefficients),
        };
        let model = CameraModel { width, height, fx, fy, cx, cy, distortion };
        if model.is_sound() {
            Ok(model)
        } else {
            Err(D::Error::custom(
                "the camera model has a focal length, size or centre that no camera has",
            ))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn every_f64_is_read_back_bit_for_bit(bits in any::<u64>()) {
            let text = serde_json::to_string(&Exact(f64::from_bits(bits))).unwrap();
            let back: Exact = serde_json::from_str(&text).unwrap();
            prop_assert_eq!(back.0.to_bits(), bits, "{}", text);
        }
    }

    #[test]
    fn special_numbers_are_read_back_bit_for_bit() {
        for value in [
            0.0,
            -0.0,
            f64::NAN,
            -f64::NAN,
            f64::INFINITY,
            f64::NEG_INFINITY,
            f64::MIN_POSITIVE,
            5e-324,
            1e308,
        ] {
            let text = serde_json::to_string(&Exact(value)).unwrap();
            let back: Exact = serde_json::from_str(&text).unwrap();
            assert_eq!(back.0.to_bits(), value.to_bits(), "{text}");
        }
    }
}
