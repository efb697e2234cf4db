//! Checks the driver for inertial measurement units on the kernel's IIO, with a HID gyroscope whose samples are known.

use std::error::Error;

use drivers::iio::{IioImu, ImuConfig, ImuPollError, Times};
use drivers::{DeviceState, DeviceStatus};
use hal::{Clock, Error as _, ErrorKind, Imu, ImuSample};
use monotonic_clock::MonotonicClock;
use monotonic_clock::monotonic_ns;

use super::check;
use super::hid_gyroscope::{HidGyroscope, STEP_RADPS, raw};

/// The name that hid-sensor-gyro-3d gives to its devices.
const NAME: &str = "gyro_3d";
const MS: u64 = 1_000_000;
const PATIENCE_NS: u64 = 20_000 * MS;

/// Runs all checks.
///
/// # Errors
/// Returns an error when the sensor cannot be simulated or never delivers a sample.
pub fn run() -> Result<(), Box<dyn Error>> {
    let gyroscope = HidGyroscope::plug_in()?;
    let config = ImuConfig { device: NAME.to_owned(), ..ImuConfig::default() };
    let imu = IioImu::open(&config)?.ok_or("the configuration names no unit")?;
    let mut bench = Bench { imu };
    setting_up(&mut bench)?;
    exact_samples(&mut bench, &gyroscope)?;
    second_program(&config)?;
    silence(&mut bench, &gyroscope)?;
    let _gyroscope = replug(&mut bench, gyroscope)?;
    closing(bench)
}

struct Bench {
    imu: IioImu,
}

impl Bench {
    /// Polls every 2 ms until `done`. Returns the elapsed time, milliseconds.
    fn until(
        &mut self,
        what: &str,
        mut done: impl FnMut(Result<Option<ImuSample>, ImuPollError>) -> bool,
    ) -> Result<u64, Box<dyn Error>> {
        let start_ns = monotonic_ns();
        loop {
            if done(self.imu.poll_sample()) {
                return Ok((monotonic_ns() - start_ns) / MS);
            }
            let now_ns = monotonic_ns();
            if now_ns - start_ns > PATIENCE_NS {
                let problem = self.imu.monitor().problem();
                return Err(format!(
                    "timed out waiting for {what}; {:?}, {problem:?}",
                    self.status()
                )
                .into());
            }
            MonotonicClock.sleep_until_ns(now_ns + 2 * MS);
        }
    }

    fn until_sample(&mut self) -> Result<u64, Box<dyn Error>> {
        self.until("a sample", |polled| matches!(polled, Ok(Some(_))))
    }

    fn until_error(&mut self, kind: ErrorKind) -> Result<u64, Box<dyn Error>> {
        self.until(&format!("{kind:?}"), |polled| polled.is_err_and(|error| error.kind() == kind))
    }

    fn samples(&mut self, count: usize) -> Result<Vec<ImuSample>, Box<dyn Error>> {
        let mut samples = Vec::new();
        self.until("samples", |polled| {
            samples.extend(polled.ok().flatten());
            samples.len() >= count
        })?;
        Ok(samples)
    }

    fn status(&self) -> DeviceStatus {
        self.imu.status()
    }
}

fn setting_up(bench: &mut Bench) -> Result<(), Box<dyn Error>> {
    let ms = bench.until_sample()?;
    let setup = bench.imu.monitor().setup().ok_or("no setup")?;
    let passed = setup.rate_hz == Some(100.0)
        && setup.times == Times::Measured
        && setup.has_force == Some(false);
    check(
        "a HID gyroscope is found by its name and set up: rate, trigger, clock and buffer",
        format!("{setup}; the first sample after {ms} ms"),
        passed,
    );
    Ok(())
}

/// The index of the sample with exactly these values. The kernel gives the scale in decimals, so that only rounding remains.
fn index_of(sample: &ImuSample) -> Option<i32> {
    let index = (sample.angular_radps[0] / STEP_RADPS).round() as i32;
    let expected = raw(index).map(|raw| f64::from(raw) * STEP_RADPS);
    let is_exact = sample
        .angular_radps
        .iter()
        .zip(expected)
        .all(|(value, expected)| (value - expected).abs() < 1e-9);
    is_exact.then_some(index)
}

fn exact_samples(bench: &mut Bench, gyroscope: &HidGyroscope) -> Result<(), Box<dyn Error>> {
    let samples = bench.samples(200)?;
    let indices: Vec<_> = samples.iter().map(index_of).collect();
    let exact = indices.iter().flatten().count();
    let in_order = indices
        .windows(2)
        .filter(|pair| matches!(pair, [Some(first), Some(second)] if *second == first + 1))
        .count();
    let figure = format!("{exact} of 200 exact, {in_order} of 199 follow the one before");
    check(
        "samples arrive unchanged, all of them, in order",
        figure,
        exact == 200 && in_order == 199,
    );

    let mut late_ns = Vec::new();
    for (sample, index) in samples.iter().zip(indices.iter().flatten()) {
        let sent_ns = gyroscope.sent_ns(*index).ok_or("a sample that was not sent")?;
        late_ns.push(sample.time_ns as i64 - sent_ns as i64);
    }
    let least = late_ns.iter().min().copied().unwrap_or(i64::MIN);
    let most = late_ns.iter().max().copied().unwrap_or(i64::MAX);
    let figure = format!("{} to {} us after sending", least / 1000, most / 1000);
    check("a sample's time is that of its measurement", figure, least >= 0 && most < 3_000_000);
    Ok(())
}

fn second_program(config: &ImuConfig) -> Result<(), Box<dyn Error>> {
    let mut second = Bench { imu: IioImu::open(config)?.ok_or("the configuration names no unit")? };
    let monitor = second.imu.monitor();
    second.until("a problem", |_| monitor.problem().is_some())?;
    let problem = monitor.problem().unwrap_or_default();
    let passed = problem.contains("used by another program");
    check("a unit that another program reads is left to it", problem, passed);
    Ok(())
}

fn silence(bench: &mut Bench, gyroscope: &HidGyroscope) -> Result<(), Box<dyn Error>> {
    bench.until_sample()?;
    gyroscope.set_paused(true);
    bench.until_error(ErrorKind::Timeout)?;
    let ms = (monotonic_ns() - bench.status().last_good_ns) / MS;
    let passed = (100..150).contains(&ms);
    check("a silent gyroscope is a timeout after 100 ms", format!("{ms} ms"), passed);
    gyroscope.set_paused(false);
    let ms = bench.until_sample()?;
    let status = bench.status();
    let passed = status.state == DeviceState::Working && status.reopened == 0;
    let figure = format!("{ms} ms, opened again {} times", status.reopened);
    check("a gyroscope that was silent delivers again without being opened again", figure, passed);
    Ok(())
}

fn replug(bench: &mut Bench, gyroscope: HidGyroscope) -> Result<HidGyroscope, Box<dyn Error>> {
    drop(gyroscope);
    let noticed = bench.until_error(ErrorKind::Disconnected)?;
    let end_ns = monotonic_ns() + 500 * MS;
    let mut other_polls = 0;
    bench.until("half a second without a gyroscope", |polled| {
        other_polls += u32::from(polled.is_ok());
        monotonic_ns() > end_ns
    })?;
    let problem = bench.imu.monitor().problem().unwrap_or_default();
    let figure =
        format!("noticed in {noticed} ms, {other_polls} polls did not report it; {problem}");
    let passed = other_polls == 0 && problem.contains("no such device");
    check("a gyroscope that is unplugged is reported as disconnected", figure, passed);

    let gyroscope = HidGyroscope::plug_in()?;
    let ms = bench.until_sample()?;
    let samples = bench.samples(50)?;
    let exact = samples.iter().filter_map(index_of).count();
    let status = bench.status();
    let figure = format!(
        "a sample {ms} ms later, {exact} of 50 exact, {} bad, opened again {} times",
        status.bad, status.reopened
    );
    let passed = exact == 50 && status.reopened == 1 && status.bad == 0;
    check("a gyroscope that is plugged in again works again", figure, passed);
    Ok(gyroscope)
}

fn closing(bench: Bench) -> Result<(), Box<dyn Error>> {
    const ENABLE: &str = "/sys/bus/iio/devices/iio:device0/buffer/enable";
    let before = std::fs::read_to_string(ENABLE)?;
    drop(bench);
    let after = std::fs::read_to_string(ENABLE)?;
    let figure = format!("buffer/enable was {} and is {}", before.trim(), after.trim());
    let passed = before.trim() == "1" && after.trim() == "0";
    check("a driver that ends switches the buffer off, so that the sensor sleeps", figure, passed);
    Ok(())
}
