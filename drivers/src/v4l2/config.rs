//! Which camera, and how it shall be set.

use std::fmt;
use std::path::Path;

use hal::PixelFormat;
use serde::de::{Error as _, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::error::V4l2Error;
use super::node::FourCc;

/// One camera. What is absent is left as the camera has it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CameraDeviceConfig {
    /// `/dev/v4l/by-id/...`, which stays the same over a replug, or `unix:/path` of a simulated camera.
    pub device: String,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// How the pictures come.
    pub format: CameraFormat,
    /// Pictures a second.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fps: Option<f64>,
    /// Exposure time, microseconds, or `"auto"`. Cameras count it in steps of 100.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub exposure_us: Option<Setting>,
    /// Gain in the camera's own units, or `"auto"`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gain: Option<Setting>,
    /// Colour temperature of the light, kelvin, or `"auto"`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub white_balance_k: Option<Setting>,
    /// A picture older than this when it is looked at is dropped, milliseconds. By default 200: a robot at 0.5 m/s has gone
    /// 10 cm since.
    pub max_age_ms: u32,
    /// How much later a picture is stamped than the middle of its exposure, beside what a configured exposure time explains,
    /// milliseconds: readout, the camera's own processing, USB. Taken off every stamp. `firmware-host camera-latency` measures it.
    pub latency_ms: f64,
}

/// How pictures come from the camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum CameraFormat {
    /// YUV 4:2:2 packed: what every USB camera has.
    Yuyv,
    /// YUV 4:2:0: what image processors of boards have.
    Nv12,
    /// Red, green, blue.
    Rgb24,
    /// Motion JPEG: large pictures over USB 2.
    Mjpeg,
}

impl CameraFormat {
    /// All that can be read.
    pub const ALL: [Self; 4] = [Self::Yuyv, Self::Nv12, Self::Rgb24, Self::Mjpeg];

    /// The names that V4L2 drivers have for it, the usual one first.
    #[must_use]
    pub fn names(self) -> &'static [FourCc] {
        match self {
            Self::Yuyv => &[FourCc::YUYV],
            Self::Nv12 => &[FourCc::NV12],
            Self::Rgb24 => &[FourCc::RGB24],
            Self::Mjpeg => &[FourCc::MJPEG, FourCc::JPEG],
        }
    }

    /// Our name of it.
    #[must_use]
    pub fn pixels(self) -> PixelFormat {
        match self {
            Self::Yuyv => PixelFormat::Yuyv,
            Self::Nv12 => PixelFormat::Nv12,
            Self::Rgb24 => PixelFormat::Rgb8,
            Self::Mjpeg => PixelFormat::Mjpeg,
        }
    }

    /// Bytes of a row of the first plane without padding; 0 where there are no rows.
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

/// A value, or what the camera thinks best.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Setting {
    /// Chosen by the camera, changing.
    Auto,
    /// Fixed.
    Manual(i32),
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

impl Default for CameraDeviceConfig {
    /// The first camera of a computer that has one, at the size that every webcam has.
    fn default() -> Self {
        Self { fps: Some(30.0), ..Self::new("/dev/video0", 640, 480, CameraFormat::Yuyv) }
    }
}

impl CameraDeviceConfig {
    /// A camera whose settings are left as they are.
    #[must_use]
    pub fn new(device: &str, width: u32, height: u32, format: CameraFormat) -> Self {
        Self {
            device: device.to_owned(),
            width,
            height,
            format,
            fps: None,
            exposure_us: None,
            gain: None,
            white_balance_k: None,
            max_age_ms: 200,
            latency_ms: 0.0,
        }
    }

    /// The path of a simulated camera's socket, if this is one.
    #[must_use]
    pub fn socket(&self) -> Option<&Path> {
        self.device.strip_prefix("unix:").map(Path::new)
    }

    /// The least `max_age_ms` with which pictures of this latency are looked at, and not always just too old: one waits for the
    /// next, or for the next look, 0.1 s at most.
    #[must_use]
    pub fn least_max_age_ms(&self) -> u32 {
        let waits_ms = self.fps.map_or(100.0, |fps| (1000.0 / fps).min(100.0));
        (self.latency_ms.abs() + waits_ms).ceil() as u32
    }

    /// Refuses what no camera can do.
    ///
    /// # Errors
    /// The first field that cannot be, with its value and what it may be.
    pub fn check(&self) -> Result<(), V4l2Error> {
        let wrong = |field, value: &dyn fmt::Display, way_out| {
            Err(V4l2Error::Config { field, value: value.to_string(), way_out })
        };
        let path = self.socket().unwrap_or(Path::new(&self.device));
        if !path.is_absolute() {
            return wrong(
                "device",
                &self.device,
                "give a path such as /dev/v4l/by-id/usb-...-video-index0 or unix:/path",
            );
        }
        // The odd ones are refused by `ImageView` as well; 16384 keeps every size within 32 bits.
        if !(16..=16384).contains(&self.width) || !self.width.is_multiple_of(2) {
            return wrong("width", &self.width, "give an even number from 16 to 16384");
        }
        if !(16..=16384).contains(&self.height) || !self.height.is_multiple_of(2) {
            return wrong("height", &self.height, "give an even number from 16 to 16384");
        }
        if let Some(fps) = self.fps
            && !(0.1..=1000.0).contains(&fps)
        {
            return wrong("fps", &fps, "give pictures a second, from 0.1 to 1000");
        }
        if let Some(Setting::Manual(us)) = self.exposure_us
            && !(100..=10_000_000).contains(&us)
        {
            return wrong(
                "exposure_us",
                &us,
                "give microseconds, from 100 to 10000000, or \"auto\"",
            );
        }
        if !(10..=10_000).contains(&self.max_age_ms) {
            return wrong("max_age_ms", &self.max_age_ms, "give milliseconds, from 10 to 10000");
        }
        if !(-100.0..=300.0).contains(&self.latency_ms) {
            return wrong("latency_ms", &self.latency_ms, "give milliseconds, from -100 to 300");
        }
        if self.latency_ms != 0.0 && self.max_age_ms < self.least_max_age_ms() {
            return wrong(
                "latency_ms",
                &self.latency_ms,
                "every picture would be too old; raise max_age_ms as well",
            );
        }
        Ok(())
    }
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
    fn a_configuration_is_read_and_written_as_an_engineer_writes_it() {
        let config: CameraDeviceConfig = toml::from_str(TEXT).unwrap();
        config.check().unwrap();
        assert_eq!(
            (config.exposure_us, config.gain),
            (Some(Setting::Manual(8000)), Some(Setting::Auto))
        );
        assert_eq!((config.white_balance_k, config.max_age_ms), (None, 200));
        assert_eq!(
            toml::from_str::<CameraDeviceConfig>(&toml::to_string(&config).unwrap()).unwrap(),
            config
        );
    }

    #[test]
    fn a_wrong_value_is_refused_with_the_field_the_value_and_what_it_may_be() {
        let good: CameraDeviceConfig = toml::from_str(TEXT).unwrap();
        let refused = |change: &dyn Fn(&mut CameraDeviceConfig)| {
            let mut config = good.clone();
            change(&mut config);
            config.check().unwrap_err().to_string()
        };
        assert!(refused(&|config| config.device = "video0".into()).contains("device = video0"));
        assert!(refused(&|config| config.width = 0).contains("width = 0"));
        assert!(refused(&|config| config.height = 481).contains("height = 481"));
        assert!(refused(&|config| config.fps = Some(f64::NAN)).contains("fps = NaN"));
        assert!(
            refused(&|config| config.exposure_us = Some(Setting::Manual(0)))
                .contains("exposure_us = 0")
        );
        assert!(refused(&|config| config.max_age_ms = 0).contains("max_age_ms = 0"));
        assert!(refused(&|config| config.latency_ms = f64::NAN).contains("latency_ms = NaN"));
        assert!(refused(&|config| config.latency_ms = 190.0).contains("raise max_age_ms"));
        assert!(
            refused(&|config| (config.latency_ms, config.max_age_ms) = (-100.0, 50))
                .contains("raise max_age_ms")
        );
        let error = toml::from_str::<CameraDeviceConfig>(&TEXT.replace("\"auto\"", "\"much\""))
            .unwrap_err();
        assert!(error.to_string().contains("\"auto\" or a whole number"), "{error}");
    }
}
