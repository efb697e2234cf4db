//! Sets up a device of the kernel: which channels it records, its rate, its trigger and its buffer.

use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use nalgebra::{Matrix3, Vector3};
use rustix::fs::{Mode, OFlags};
use rustix::io::Errno;

use super::attributes::{Attributes, failed};
use super::records::Records;
use super::source::{Decode, ImuSetup, Source, Times};
use super::{
    Axis, Decoder, Element, ImuConfig, ImuError, ImuPlace, Layout, Place, Roots, Triad,
    mount_matrix, rate,
};

const GYROSCOPE: &str = "in_anglvel";
const ACCELEROMETER: &str = "in_accel";
const TIMESTAMP: &str = "in_timestamp";
const AXES: [&str; 3] = ["x", "y", "z"];
/// The kernel keeps this many records while the thread is late: a quarter of a second at the highest rate.
const BUFFER_RECORDS: &str = "256";
/// A gyroscope without one axis may be tilted by this sine of 6 degrees, by which the rate about the vertical is 0.5 % wrong.
const MOST_TILT: f64 = 0.1;

/// A device whose buffer is on. Dropping it switches the buffer off, so that the sensor sleeps.
pub(super) struct KernelDevice {
    attributes: Attributes,
}

impl KernelDevice {
    /// Whether the device is no longer there. A read that waits is not told.
    pub(super) fn is_gone(&self) -> bool {
        !self.attributes.folder().exists()
    }
}

impl Drop for KernelDevice {
    fn drop(&mut self) {
        // A device that is gone needs no switching off.
        _ = self.attributes.set("buffer/enable", "0");
    }
}

/// Opens the configured device and starts it.
pub(super) fn open(
    config: &ImuConfig,
    name: &Arc<str>,
    roots: &Roots,
) -> Result<(Source, OwnedFd), ImuError> {
    let folder = find(config, name, roots)?;
    // Opening the node first excludes other programs before anything is changed.
    let node = open_node(&roots.node(&folder))?;
    let device = Device { attributes: Attributes::new(folder), name: Arc::clone(name) };
    let (source, device) = device.start(config, roots)?;
    Ok((Source { device: Some(device), ..source }, node))
}

fn find(config: &ImuConfig, name: &Arc<str>, roots: &Roots) -> Result<PathBuf, ImuError> {
    let folder = match config.place() {
        ImuPlace::Folder(path) => path.to_owned(),
        _ => roots.device(name)?,
    };
    // The folder may be a link; the name of the node is that of the folder itself.
    folder.canonicalize().map_err(|source| ImuError::Absent {
        device: Arc::clone(name),
        what: format!("there is no such folder ({source})"),
    })
}

fn open_node(path: &Path) -> Result<OwnedFd, ImuError> {
    let flags = OFlags::RDONLY | OFlags::NONBLOCK | OFlags::CLOEXEC;
    rustix::fs::open(path, flags, Mode::empty()).map_err(|errno: Errno| {
        failed(path.to_owned(), "cannot be opened".to_owned(), errno.into())
    })
}

/// A device that is being set up.
struct Device {
    attributes: Attributes,
    name: Arc<str>,
}

impl Device {
    fn start(self, config: &ImuConfig, roots: &Roots) -> Result<(Source, KernelDevice), ImuError> {
        self.require_buffer()?;
        // Nothing can be changed while the buffer is on.
        self.attributes.set("buffer/enable", "0")?;
        let times = self.choose_clock()?;
        self.choose_channels(times)?;
        let layout = self.layout()?;
        self.choose_trigger(config, roots)?;
        let rate_hz = self.choose_rate(config, roots)?;
        // Scales are read last, because they may depend on the rate.
        let decoder = self.decoder(&layout, times, config)?;
        let setup = ImuSetup {
            name: self.attributes.read("name")?,
            rate_hz,
            has_force: Some(layout.place(&channel(ACCELEROMETER, "x")).is_some()),
            times,
        };
        let records = Records::new(decoder.record_bytes());
        let decode = Decode::Kernel(Box::new(decoder));
        let attributes = self.attributes;
        attributes.set("buffer/length", BUFFER_RECORDS)?;
        if attributes.has("buffer/watermark") {
            attributes.set("buffer/watermark", "1")?;
        }
        let device = KernelDevice { attributes };
        device.attributes.set("buffer/enable", "1")?;
        Ok((Source { setup, records, decode, device: None }, device))
    }

    fn unsupported(&self, what: String) -> ImuError {
        ImuError::Unsupported { device: Arc::clone(&self.name), what }
    }

    fn require_buffer(&self) -> Result<(), ImuError> {
        if self.attributes.has("buffer/enable") && self.attributes.has("scan_elements") {
            return Ok(());
        }
        Err(self.unsupported(
            "its kernel driver has no buffer for it, often because the unit's interrupt line is not in the board's device tree"
                .to_owned(),
        ))
    }

    /// Has the kernel take its times from the monotonic clock, where it can.
    fn choose_clock(&self) -> Result<Times, ImuError> {
        const CLOCK: &str = "current_timestamp_clock";
        let has_times = self.has_channel(TIMESTAMP) && self.attributes.has(CLOCK);
        if !has_times {
            return Ok(Times::Read);
        }
        self.attributes.set(CLOCK, "monotonic")?;
        Ok(Times::Measured)
    }

    fn has_channel(&self, channel: &str) -> bool {
        self.attributes.has(&format!("scan_elements/{channel}_en"))
    }

    /// Records the angular velocities, the forces and the time, and no other channel.
    fn choose_channels(&self, times: Times) -> Result<(), ImuError> {
        let mut wanted = AXES.map(|axis| channel(GYROSCOPE, axis)).to_vec();
        let forces = AXES.map(|axis| channel(ACCELEROMETER, axis));
        if forces.iter().all(|channel| self.has_channel(channel)) {
            wanted.extend(forces);
        }
        if times == Times::Measured {
            wanted.push(TIMESTAMP.to_owned());
        }
        // The others are switched off first, because some chips record a limited number of channels at once.
        for (is_wanted, value) in [(false, "0"), (true, "1")] {
            for channel in self.channels()? {
                if wanted.contains(&channel) == is_wanted {
                    self.attributes.set(&format!("scan_elements/{channel}_en"), value)?;
                }
            }
        }
        Ok(())
    }

    fn channels(&self) -> Result<Vec<String>, ImuError> {
        let names = self.attributes.names("scan_elements")?;
        Ok(names.iter().filter_map(|name| name.strip_suffix("_en")).map(str::to_owned).collect())
    }

    /// The layout of the channels that are switched on, which the device may have made more than asked for.
    fn layout(&self) -> Result<Layout, ImuError> {
        let mut elements = Vec::new();
        for name in self.channels()? {
            let attribute =
                |what: &str| self.attributes.read(&format!("scan_elements/{name}_{what}"));
            if attribute("en")? != "1" {
                continue;
            }
            let index = attribute("index")?;
            let index = index.parse().map_err(|_| {
                self.unsupported(format!("{name}_index is `{index}`, which is no number"))
            })?;
            let kind = attribute("type")?;
            let kind = kind
                .parse()
                .map_err(|error| self.unsupported(format!("{name}_type is `{kind}`: {error}")))?;
            elements.push(Element { name, index, kind });
        }
        Ok(Layout::new(elements))
    }

    /// A device with a trigger folder needs a trigger: its own, or the configured one.
    fn choose_trigger(&self, config: &ImuConfig, roots: &Roots) -> Result<(), ImuError> {
        const CURRENT: &str = "trigger/current_trigger";
        if !self.attributes.has(CURRENT) {
            return Ok(());
        }
        let is_chosen = !config.trigger.is_empty();
        if !is_chosen && !self.attributes.read(CURRENT)?.is_empty() {
            return Ok(());
        }
        let own = self.own_trigger()?;
        let wanted = if is_chosen { &config.trigger } else { &own };
        if roots.trigger(wanted).is_none() {
            return Err(self.unsupported(format!(
                "there is no trigger `{wanted}`; set `trigger` to one of: {}",
                roots.triggers()
            )));
        }
        self.attributes.set(CURRENT, wanted)
    }

    /// The name that kernel drivers give to a device's own trigger: `bmi160-dev0`.
    fn own_trigger(&self) -> Result<String, ImuError> {
        let folder = self.attributes.folder().file_name().unwrap_or_default().to_string_lossy();
        let number = folder.trim_start_matches("iio:device");
        Ok(format!("{}-dev{number}", self.attributes.read("name")?))
    }

    /// Sets the rate of the sensors and of the trigger, wherever they have one, and reads the gyroscope's back.
    fn choose_rate(&self, config: &ImuConfig, roots: &Roots) -> Result<Option<f64>, ImuError> {
        set_rate(&self.attributes, ACCELEROMETER, config.rate_hz)?;
        let of_sensor = set_rate(&self.attributes, GYROSCOPE, config.rate_hz)?;
        let trigger = self.attributes.find("trigger/current_trigger")?.unwrap_or_default();
        let of_trigger = match roots.trigger(&trigger) {
            Some(folder) => set_rate(&Attributes::new(folder), "", config.rate_hz)?,
            None => None,
        };
        let rate_hz = of_trigger.or(of_sensor);
        if let Some(rate_hz) = rate_hz.filter(|rate_hz| *rate_hz < ImuConfig::LEAST_HZ) {
            return Err(self.unsupported(format!(
                "it gives {rate_hz} samples per second, and angles between two samples need {} or more; set `rate_hz` to a higher rate \
                 that it has",
                ImuConfig::LEAST_HZ
            )));
        }
        let least_ms = rate_hz.map_or(0, ImuConfig::least_timeout_ms);
        if config.timeout_ms < least_ms {
            return Err(self.unsupported(format!(
                "it gives {} samples per second, so that each would be late; raise `timeout_ms` to {least_ms} or more",
                rate_hz.unwrap_or_default()
            )));
        }
        Ok(rate_hz)
    }

    fn decoder(
        &self,
        layout: &Layout,
        times: Times,
        config: &ImuConfig,
    ) -> Result<Decoder, ImuError> {
        let Some(angular) = self.triad(layout, GYROSCOPE)? else {
            return Err(self.unsupported(
                "it has no gyroscope (no channel in_anglvel_*); sensors of one chip may be separate devices, such as \
                 `lsm6dsox_gyro` and `lsm6dsox_accel`: name the gyroscope"
                    .to_owned(),
            ));
        };
        self.require_vertical(&angular, config)?;
        let force = self.triad(layout, ACCELEROMETER)?;
        let time = layout.place(TIMESTAMP).filter(|_| times == Times::Measured);
        Ok(Decoder::new(layout, angular, force, time))
    }

    /// A sensor's axes that are recorded; `None` if there are none.
    fn triad(&self, layout: &Layout, sensor: &str) -> Result<Option<Triad>, ImuError> {
        let mut axes = [None; 3];
        for (axis, letter) in axes.iter_mut().zip(AXES) {
            if let Some(place) = layout.place(&channel(sensor, letter)) {
                *axis = Some(self.axis(place, sensor, letter)?);
            }
        }
        if axes == [None; 3] {
            return Ok(None);
        }
        Ok(Some(Triad { axes, matrix: self.mount_matrix(sensor)? }))
    }

    fn axis(&self, place: Place, sensor: &str, letter: &str) -> Result<Axis, ImuError> {
        let scale = self.number(sensor, letter, "scale")?.filter(|scale| *scale != 0.0);
        let scale = scale.ok_or_else(|| {
            self.unsupported(format!(
                "it has no {sensor}_scale other than 0, so that its units are unknown"
            ))
        })?;
        let offset = self.number(sensor, letter, "offset")?.unwrap_or(0.0);
        Ok(Axis { place, offset, scale })
    }

    /// An attribute of one axis, or else the one that all axes share.
    fn number(&self, sensor: &str, letter: &str, what: &str) -> Result<Option<f64>, ImuError> {
        let of_axis = format!("{sensor}_{letter}_{what}");
        let of_all = format!("{sensor}_{what}");
        let Some((name, text)) = self.attributes.first(&[&of_axis, &of_all])? else {
            return Ok(None);
        };
        let number = text.parse().ok().filter(|number: &f64| number.is_finite());
        number
            .map(Some)
            .ok_or_else(|| self.unsupported(format!("{name} is `{text}`, which is no number")))
    }

    /// The kernel's mounting matrix of a sensor: of its type, of all inputs, or of the device.
    fn mount_matrix(&self, sensor: &str) -> Result<Matrix3<f64>, ImuError> {
        let of_type = format!("{sensor}_mount_matrix");
        let names = [of_type.as_str(), "in_mount_matrix", "mount_matrix"];
        let Some((name, text)) = self.attributes.first(&names)? else {
            return Ok(Matrix3::identity());
        };
        mount_matrix::parse(&text).ok_or_else(|| {
            self.unsupported(format!(
                "{name} is `{text}`, which is no rotation; correct `mount-matrix` in the board's device tree"
            ))
        })
    }

    /// The robot needs the rotation about the vertical. An axis that the chip lacks must not be part of it.
    fn require_vertical(&self, angular: &Triad, config: &ImuConfig) -> Result<(), ImuError> {
        let up: Vector3<f64> = angular.matrix.transpose() * config.mount().up();
        for ((axis, letter), part) in angular.axes.iter().zip(AXES).zip(up.iter()) {
            if axis.is_none() && part.abs() > MOST_TILT {
                return Err(self.unsupported(format!(
                    "it has no {}, but by `roll_deg`, `pitch_deg` and `yaw_deg` this axis measures part of the rotation about the \
                     vertical; correct these angles or mount the unit in another way",
                    channel(GYROSCOPE, letter)
                )));
            }
        }
        Ok(())
    }
}

fn channel(sensor: &str, axis: &str) -> String {
    format!("{sensor}_{axis}")
}

/// Sets a rate of a sensor, or of a whole device or trigger, and reads it back. `None` if it has no rate.
fn set_rate(attributes: &Attributes, sensor: &str, rate_hz: f64) -> Result<Option<f64>, ImuError> {
    const NAME: &str = "sampling_frequency";
    let of_sensor = format!("{sensor}_{NAME}");
    let Some((name, text)) = attributes.first(&[&of_sensor, NAME])? else { return Ok(None) };
    let number = |text: &str| text.parse::<f64>().ok();
    if number(&text) == Some(rate_hz) {
        return Ok(Some(rate_hz));
    }
    let available = attributes.find(&format!("{name}_available"))?;
    attributes.set(name, &rate::nearest(rate_hz, available.as_deref()))?;
    Ok(number(&attributes.read(name)?).filter(|hz| *hz > 0.0))
}
