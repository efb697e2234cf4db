//! Configuration of a camera.

use std::fmt;
use std::path::Path;

use hal::PixelFormat;
use hal::settings::{ConfigValue, Kind, OutOfRange, Range};
use serde::de::{Error as _, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::error::V4l2Error;
use super::node::FourCc;

hal::settings! {
    /// The camera, by V4L2. A setting that is absent stays as the camera has it.
    pub struct CameraDeviceConfig {
        /// Path that stays the same after the camera was unplugged, such as `/dev/v4l/by-id/...`, or `unix:/path` of a
        /// simulated camera.
        device: String = "/dev/video0".to_owned();
        /// Columns that the camera is asked for; an even number.
        width: u32 = 640, in 16..=16384, unit "pixels";
        /// Rows that the camera is asked for; an even number.
        height: u32 = 480, in 16..=16384, unit "pixels";
        /// Pixel format: YUV 4:2:2 packed (`yuyv`, which every USB camera has), YUV 4:2:0 (`nv12`, image processors of
        /// boards), RGB, or Motion JPEG (large images over USB 2).
        format: CameraFormat = CameraFormat::Yuyv;
        /// Frame rate.
        #[serde(skip_serializing_if = "Option::is_none")]
        fps: Option<f64> = Some(30.0), in 0.1..=1000.0, unit "Hz";
        /// Exposure time. Cameras count it in steps of 100 us.
        #[serde(skip_serializing_if = "Option::is_none")]
        exposure_us: Option<Setting> = None, in 100..=10000000, unit "us";
        /// Gain in the camera's own units.
        #[serde(skip_serializing_if = "Option::is_none")]
        gain: Option<Setting> = None;
        /// Colour temperature of the light, in kelvin.
        #[serde(skip_serializing_if = "Option::is_none")]
        white_balance_k: Option<Setting> = None;
        /// A frame older than this is dropped.
        max_age_ms: u32 = 200, in 10..=10000, unit "ms", source "a robot at 0.5 m/s drives 10 cm in this time";
        /// Time from the middle of the exposure to the frame's timestamp, beyond what a configured exposure time explains:
        /// readout, the camera's own processing, USB. It is subtracted from every timestamp. `firmware-host camera-latency`
        /// measures it.
        latency_ms: f64 = 0.0, in -100.0..=300.0, unit "ms";
    }
}

/// Pixel format of the camera's images.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum CameraFormat {
    /// YUV 4:2:2 packed, which every USB camera has.
    Yuyv,
    /// YUV 4:2:0, which the image processors of boards have.
    Nv12,
    /// Red, green and blue, 8 bits each.
    Rgb24,
    /// Motion JPEG, for large images over USB 2.
    Mjpeg,
}

hal::choices!(CameraFormat: "yuyv", "nv12", "rgb24", "mjpeg");

impl CameraFormat {
    /// Every format that the driver reads.
    pub const ALL: [Self; 4] = [Self::Yuyv, Self::Nv12, Self::Rgb24, Self::Mjpeg];

    /// The codes that V4L2 drivers use for this format, the usual one first.
    #[must_use]
    pub fn names(self) -> &'static [FourCc] {
        match self {
            Self::Yuyv => &[FourCc::YUYV],
            Self::Nv12 => &[FourCc::NV12],
            Self::Rgb24 => &[FourCc::RGB24],
            Self::Mjpeg => &[FourCc::MJPEG, FourCc::JPEG],
        }
    }

    /// The corresponding format in [`hal`].
    #[must_use]
    pub fn pixels(self) -> PixelFormat {
        match self {
            Self::Yuyv => PixelFormat::Yuyv,
            Self::Nv12 => PixelFormat::Nv12,
            Self::Rgb24 => PixelFormat::Rgb8,
            Self::Mjpeg => PixelFormat::Mjpeg,
        }
    }

    /// Bytes of a row of the first plane without padding; 0 for a format without rows.
    #[must_use]
    pub fn row_bytes(self, width: u32) -> u32 {
        match self {
            Self::Yuyv => width.saturating_mul(2),
            Self::Nv12 => width,
            Self::Rgb24 => width.saturating_mul(3),
            Self::Mjpeg => 0,
        }
    }
}

/// A fixed value, or the camera's automatic control.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Setting {
    /// The camera chooses and changes the value.
    Auto,
    /// The value is fixed.
    Manual(i32),
}

impl ConfigValue for Setting {
    const KIND: Kind = Kind::AutoOrInteger;

    fn first_outside(&self, range: &Range) -> Option<f64> {
        match self {
            Self::Auto => None,
            Self::Manual(value) => value.first_outside(range),
        }
    }
}

impl Serialize for Setting {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Auto => serializer.serialize_str("auto"),
            Self::Manual(value) => serializer.serialize_i32(*value),
        }
    }
}

impl<'de> Deserialize<'de> for Setting {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Either;
        impl Visitor<'_> for Either {
            type Value = Setting;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("\"auto\" or a whole number")
            }

            fn visit_str<E: serde::de::Error>(self, text: &str) -> Result<Setting, E> {
                if text == "auto" {
                    Ok(Setting::Auto)
                } else {
                    Err(E::custom("expected \"auto\" or a whole number"))
                }
            }

            fn visit_i64<E: serde::de::Error>(self, value: i64) -> Result<Setting, E> {
                i32::try_from(value).map(Setting::Manual).map_err(E::custom)
            }

            fn visit_u64<E: serde::de::Error>(self, value: u64) -> Result<Setting, E> {
                i32::try_from(value).map(Setting::Manual).map_err(E::custom)
            }
        }
        deserializer.deserialize_any(Either).map_err(D::Error::custom)
    }
}

impl From<OutOfRange> for V4l2Error {
    fn from(OutOfRange { key, value, allowed }: OutOfRange) -> Self {
        Self::Config { field: key, value: value.to_string(), way_out: allowed }
    }
}

impl CameraDeviceConfig {
    /// A camera whose frame rate and controls stay as they are.
    #[must_use]
    pub fn new(device: &str, width: u32, height: u32, format: CameraFormat) -> Self {
        Self { device: device.to_owned(), width, height, format, fps: None, ..Self::default() }
    }

    /// The path of the socket if the camera is simulated.
    #[must_use]
    pub fn socket(&self) -> Option<&Path> {
        self.device.strip_prefix("unix:").map(Path::new)
    }

    /// The smallest `max_age_ms` with which frames of this latency are not always too old. A frame waits for the next one or
    /// for the next poll, 0.1 s at most.
    #[must_use]
    pub fn least_max_age_ms(&self) -> u32 {
        let waits_ms = self.fps.map_or(100.0, |fps| (1000.0 / fps).min(100.0));
        (self.latency_ms.abs() + waits_ms).ceil() as u32
    }

    /// Checks every value, and the values together.
    ///
    /// # Errors
    /// The first field that is not allowed, with its value and the allowed values.
    pub fn check(&self) -> Result<(), V4l2Error> {
        let path = self.socket().unwrap_or(Path::new(&self.device));
        if !path.is_absolute() {
            let way_out = "give a path such as /dev/v4l/by-id/usb-...-video-index0 or unix:/path";
            return Err(refused("device", &self.device, way_out));
        }
        self.check_ranges()?;
        // `ImageView` refuses odd sizes too. 16384 keeps the bytes of an image within 32 bits.
        if !self.width.is_multiple_of(2) {
            return Err(refused("width", &self.width, "give an even number"));
        }
        if !self.height.is_multiple_of(2) {
            return Err(refused("height", &self.height, "give an even number"));
        }
        if self.latency_ms != 0.0 && self.max_age_ms < self.least_max_age_ms() {
            let way_out = "every frame would be too old; raise max_age_ms as well";
            return Err(refused("latency_ms", &self.latency_ms, way_out));
        }
        Ok(())
    }
}

fn refused(field: &'static str, value: &dyn fmt::Display, way_out: &'static str) -> V4l2Error {
    V4l2Error::Config { field, value: value.to_string(), way_out }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = r#"
        device = "/dev/v4l/by-id/usb-046d_C270-video-index0"
        width = 640
        height = 480
        format = "mjpeg"
        fps = 30.0
        exposure_us = 8000
        gain = "auto"
    "#;

    #[test]
    fn a_configuration_is_read_and_written_in_the_same_form() {
        let config: CameraDeviceConfig = toml::from_str(TEXT).unwrap();
        config.check().unwrap();
        assert_eq!(config.exposure_us, Some(Setting::Manual(8000)));
        assert_eq!(config.gain, Some(Setting::Auto));
        assert_eq!(config.white_balance_k, None);
        assert_eq!(config.max_age_ms, 200);
        assert_eq!(
            toml::from_str::<CameraDeviceConfig>(&toml::to_string(&config).unwrap()).unwrap(),
            config
        );
    }

    #[test]
    fn a_value_that_is_not_allowed_is_refused_with_the_field_and_the_allowed_values() {
        let good: CameraDeviceConfig = toml::from_str(TEXT).unwrap();
        let exposure_us = Some(Setting::Manual(0));
        for (bad, message) in [
            (CameraDeviceConfig { device: "video0".into(), ..good.clone() }, "device = video0"),
            (CameraDeviceConfig { width: 0, ..good.clone() }, "width = 0"),
            (CameraDeviceConfig { height: 481, ..good.clone() }, "height = 481"),
            (CameraDeviceConfig { fps: Some(f64::NAN), ..good.clone() }, "fps = NaN"),
            (CameraDeviceConfig { exposure_us, ..good.clone() }, "exposure_us = 0"),
            (CameraDeviceConfig { max_age_ms: 0, ..good.clone() }, "max_age_ms = 0"),
            (CameraDeviceConfig { latency_ms: f64::NAN, ..good.clone() }, "latency_ms = NaN"),
            (CameraDeviceConfig { latency_ms: 190.0, ..good.clone() }, "raise max_age_ms"),
            (
                CameraDeviceConfig { latency_ms: -100.0, max_age_ms: 50, ..good.clone() },
                "raise max_age_ms",
            ),
        ] {
            let error = bad.check().unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
        let error = toml::from_str::<CameraDeviceConfig>(&TEXT.replace("\"auto\"", "\"much\""))
            .unwrap_err();
        assert!(error.to_string().contains("\"auto\" or a whole number"), "{error}");
    }
}
