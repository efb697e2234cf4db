//! Checks the Hokuyo driver on the kernel's USB serial port (ftdi_sio), with the simulated scanner
//! at the other end of the cable.

use std::error::Error;
use std::path::{Path, PathBuf};

use drivers::DeviceState;
use drivers::hokuyo::{HokuyoConfig, HokuyoError, HokuyoLidar, Port};
use drivers::scip::Model;
use hal::{Clock, Error as _, ErrorKind, LaserScan, Lidar};
use monotonic_clock::MonotonicClock;
use monotonic_clock::monotonic_ns;

use super::check;
use crate::hokuyo::{ScanSource, SimulatedHokuyo, WireFaults};

/// Ports at the two ends of the cable.
#[derive(Debug, clap::Args)]
pub struct LidarProbe {
    /// Serial port of the robot, by its stable path.
    #[arg(long)]
    port: PathBuf,
    /// Serial port of the simulated scanner.
    #[arg(long)]
    scanner: PathBuf,
    /// Sysfs folder of the robot's USB device; its `authorized` attribute simulates plugging.
    #[arg(long)]
    usb: PathBuf,
}

const MS: u64 = 1_000_000;
const TIMEOUT_NS: u64 = 20_000 * MS;
/// 10 Hz and 21 kB/s. The emulated port carries 86 kB/s, less than the 134 kB/s of a UTM-30LX.
const MODEL: Model = Model::Urg04lx;

/// A different range for every step, the same in every scan.
struct Ramp;

impl ScanSource for Ramp {
    fn ranges_mm(&mut self, _: u64, out: &mut [u32]) {
        out.iter_mut().zip(0..).for_each(|(range, step)| *range = ramp_mm(step));
    }
}

fn ramp_mm(step: u32) -> u32 {
    100 + 5 * step
}

/// Runs all checks.
///
/// # Errors
/// Returns an error when the probe cannot be set up or the scanner never delivers a scan.
pub fn run(probe: &LidarProbe) -> Result<(), Box<dyn Error>> {
    let scanner = SimulatedHokuyo::on_serial(MODEL, &probe.scanner, Box::new(Ramp))?;
    let config =
        HokuyoConfig { model: MODEL, ..HokuyoConfig::new(Port::Serial(probe.port.clone())) };
    let lidar = HokuyoLidar::open(config)?;
    let mut bench = Bench { scan: LaserScan::empty(lidar.geometry()), lidar };
    exact_scans(&mut bench)?;
    corrupted_scans(&mut bench, &scanner)?;
    silence(&mut bench, &scanner)?;
    replug(&mut bench, &probe.usb)
}

struct Bench {
    lidar: HokuyoLidar,
    scan: LaserScan,
}

impl Bench {
    /// Polls every 2 ms until `done`. Returns the elapsed time, milliseconds.
    fn until(
        &mut self,
        what: &str,
        mut done: impl FnMut(Result<Option<&LaserScan>, HokuyoError>) -> bool,
    ) -> Result<u64, Box<dyn Error>> {
        let start_ns = monotonic_ns();
        loop {
            let polled = self.lidar.poll_scan(&mut self.scan);
            if done(polled.map(|is_new| is_new.then_some(&self.scan))) {
                return Ok((monotonic_ns() - start_ns) / MS);
            }
            let now_ns = monotonic_ns();
            if now_ns - start_ns > TIMEOUT_NS {
                let status = self.lidar.status();
                let problem = self.lidar.monitor().problem();
                return Err(format!("timed out waiting for {what}; {status:?}, {problem:?}").into());
            }
            MonotonicClock.sleep_until_ns(now_ns + 2 * MS);
        }
    }

    fn until_scan(&mut self) -> Result<u64, Box<dyn Error>> {
        self.until("a scan", |polled| matches!(polled, Ok(Some(_))))
    }

    fn until_error(&mut self, kind: ErrorKind) -> Result<u64, Box<dyn Error>> {
        self.until(&format!("{kind:?}"), |polled| polled.is_err_and(|error| error.kind() == kind))
    }

    /// Waits for `count` scans. Returns how many of them were exactly the ramp, and the elapsed
    /// time in milliseconds.
    fn scans(&mut self, count: u32) -> Result<(u32, u64), Box<dyn Error>> {
        let mut received = 0;
        let mut exact = 0;
        let ms = self.until("scans", |polled| {
            if let Ok(Some(scan)) = polled {
                received += 1;
                exact += u32::from(is_ramp(scan));
            }
            received == count
        })?;
        Ok((exact, ms))
    }
}

fn is_ramp(scan: &LaserScan) -> bool {
    scan.ranges.iter().zip(0..).all(|(range, step)| {
        // The model's maximum range ends the ramp.
        range.hit_m().is_none_or(|metres| (f64::from(metres) - ramp_m(step)).abs() < 5e-4)
    }) && scan.ranges.iter().filter(|range| range.hit_m().is_some()).count() > scan.ranges.len() / 2
}

fn ramp_m(step: u32) -> f64 {
    f64::from(ramp_mm(step)) * 1e-3
}

fn exact_scans(bench: &mut Bench) -> Result<(), Box<dyn Error>> {
    let first = bench.until_scan()?;
    let (exact, ms) = bench.scans(30)?;
    let status = bench.lidar.status();
    let figure =
        format!("{exact} of 30 in {ms} ms, the first after {first} ms, {} bad", status.bad);
    check("scans arrive over USB serial unchanged", figure, exact == 30);
    Ok(())
}

fn corrupted_scans(bench: &mut Bench, scanner: &SimulatedHokuyo) -> Result<(), Box<dyn Error>> {
    let before = bench.lidar.status();
    scanner.set_wire(WireFaults { flip_share: 0.3, ..WireFaults::default() });
    let (exact, _) = bench.scans(20)?;
    scanner.set_wire(WireFaults::default());
    let bad = bench.lidar.status().bad - before.bad;
    let figure = format!("{bad} dropped, {exact} of 20 returned scans were exact");
    check("a scan with a flipped bit is never returned", figure, exact == 20 && bad > 0);
    Ok(())
}

fn silence(bench: &mut Bench, scanner: &SimulatedHokuyo) -> Result<(), Box<dyn Error>> {
    bench.until_scan()?;
    let last_ns = bench.lidar.status().last_good_ns;
    scanner.set_wire(WireFaults { is_stalled: true, ..WireFaults::default() });
    bench.until_error(ErrorKind::Timeout)?;
    let ms = (monotonic_ns() - bench.lidar.status().last_good_ns.max(last_ns)) / MS;
    check(
        "a silent scanner is a timeout after two periods (200 ms)",
        format!("{ms} ms"),
        (190..400).contains(&ms),
    );
    scanner.set_wire(WireFaults::default());
    let ms = bench.until_scan()?;
    check(
        "a scanner that was silent delivers again without intervention",
        format!("{ms} ms"),
        true,
    );
    Ok(())
}

fn replug(bench: &mut Bench, usb: &Path) -> Result<(), Box<dyn Error>> {
    bench.until_scan()?;
    std::fs::write(usb.join("authorized"), "0")?;
    let noticed = bench.until_error(ErrorKind::Disconnected)?;
    let end_ns = monotonic_ns() + 1_000 * MS;
    let mut other_polls = 0;
    bench.until("a second without a scanner", |polled| {
        other_polls += u32::from(polled.is_ok());
        monotonic_ns() > end_ns
    })?;
    let figure = format!(
        "noticed in {noticed} ms, {other_polls} polls did not report it in the next second"
    );
    check(
        "a scanner whose USB plug is pulled is reported as disconnected",
        figure,
        other_polls == 0,
    );
    std::fs::write(usb.join("authorized"), "1")?;
    let ms = bench.until_scan()?;
    let passed = bench.lidar.status().state == DeviceState::Working;
    check(
        "a scanner that is plugged in again is found by its stable path",
        format!("a scan {ms} ms later"),
        passed,
    );
    let (exact, _) = bench.scans(10)?;
    check("scans after replugging are exact again", format!("{exact} of 10"), exact == 10);
    Ok(())
}
