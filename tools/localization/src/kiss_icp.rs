//! LiDAR odometry by KISS-ICP, of the Python package `kiss-icp`, as a peer: the same scans in the same run.

use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use anyhow::{Context, Result, ensure};
use hal::{LaserScan, Pose2, Range};

/// Size of the voxels of its map, metres: its default for this range. On the first home, 0.02, 0.05 and 0.1 were less exact than it or
/// equal, and slower.
const VOXEL_M: &str = "0.3";
/// Range of the scanner, metres.
const MAX_RANGE_M: &str = "30";

/// The running script.
pub struct KissIcp {
    child: Child,
    input: ChildStdin,
    output: BufReader<ChildStdout>,
}

impl KissIcp {
    /// Starts it with the Python interpreter in `LOCALIZATION_PYTHON`; `None` if that is not set.
    ///
    /// # Errors
    /// When the script does not start.
    pub fn start() -> Result<Option<Self>> {
        let Some(python) = std::env::var_os("LOCALIZATION_PYTHON") else { return Ok(None) };
        let script =
            Path::new(env!("CARGO_MANIFEST_DIR")).join("../bench/peers/kiss_icp_odometry.py");
        let mut child = Command::new(python)
            .arg(&script)
            .args([VOXEL_M, MAX_RANGE_M])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .with_context(|| script.display().to_string())?;
        let input = child.stdin.take().context("KISS-ICP without input")?;
        let output = BufReader::new(child.stdout.take().context("KISS-ICP without output")?);
        let mut peer = Self { child, input, output };
        let answer = peer.line()?;
        ensure!(answer == "ready", "KISS-ICP answered `{answer}` instead of `ready`");
        Ok(Some(peer))
    }

    /// The milliseconds that it takes for a scan, and the scanner's pose in the frame of the first scan.
    ///
    /// # Errors
    /// When the script ends.
    pub fn update(&mut self, scan: &LaserScan) -> Result<(f64, Pose2)> {
        self.input.write_all(&points(scan)).context("KISS-ICP has ended")?;
        self.input.flush().context("KISS-ICP has ended")?;
        let answer = self.line()?;
        let numbers: Vec<f64> = answer
            .split_whitespace()
            .map(str::parse)
            .collect::<Result<_, _>>()
            .with_context(|| format!("KISS-ICP answered `{answer}`"))?;
        let [seconds, x_m, y_m, yaw_rad] = numbers[..] else {
            anyhow::bail!("KISS-ICP answered `{answer}`")
        };
        Ok((1e3 * seconds, Pose2::new(x_m, y_m, yaw_rad)))
    }

    fn line(&mut self) -> Result<String> {
        let mut line = String::new();
        self.output.read_line(&mut line).context("KISS-ICP")?;
        ensure!(!line.is_empty(), "KISS-ICP ended early; its output is above");
        Ok(line.trim().to_owned())
    }
}

impl Drop for KissIcp {
    fn drop(&mut self) {
        // It may have ended already.
        _ = self.child.kill();
        _ = self.child.wait();
    }
}

/// The number of hits, then x and y of each in the scanner's frame.
fn points(scan: &LaserScan) -> Vec<u8> {
    let mut bytes = vec![0; 4];
    let mut count = 0_u32;
    for (beam, range) in scan.ranges.iter().enumerate() {
        let Range::Hit(range_m) = range else { continue };
        let (sin, cos) = scan.geometry.angle_rad(beam).sin_cos();
        for along in [cos, sin] {
            bytes.extend((*range_m * along as f32).to_le_bytes());
        }
        count += 1;
    }
    bytes[..4].copy_from_slice(&count.to_le_bytes());
    bytes
}

#[cfg(test)]
mod tests {
    use hal::ScanGeometry;

    use super::*;

    #[test]
    fn only_hits_are_sent_and_each_as_x_and_y() {
        let mut scan = LaserScan::empty(ScanGeometry::UTM_30LX);
        scan.ranges = vec![Range::NoReturn; scan.geometry.beams];
        scan.ranges[540] = Range::Hit(2.0);
        let bytes = points(&scan);
        assert_eq!(bytes[..4], 1_u32.to_le_bytes());
        assert_eq!(bytes.len(), 12);
        assert_eq!(bytes[4..8], 2.0_f32.to_le_bytes());
    }
}
