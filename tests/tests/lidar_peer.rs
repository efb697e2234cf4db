//! The simulated scanner works with an independent client, which reads the same ranges as our
//! driver.
#![allow(clippy::unwrap_used, reason = "a test that cannot set up its fixture has failed")]

use std::net::{Ipv4Addr, SocketAddr};
use std::path::Path;
use std::process::Command;

use drivers::scip::Model;
use hil::hokuyo::{ScanSource, SimulatedHokuyo};
use serde_json::Value;

/// Ranges that use all three characters of the encoding.
struct Ramp;

impl ScanSource for Ramp {
    fn ranges_mm(&mut self, _: u64, out: &mut [u32]) {
        for (step, range) in out.iter_mut().enumerate() {
            *range = ramp(step);
        }
    }
}

fn ramp(step: usize) -> u32 {
    100 + 27 * step as u32
}

#[test]
#[ignore = "needs tests/peers/requirements.txt; `cargo xtask test --all` installs it"]
fn hokuyolx_understands_every_line_of_the_simulated_scanner() {
    let python = std::env::var("HIL_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let any = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
    let device = SimulatedHokuyo::on_tcp(Model::Ust10lx, any, Box::new(Ramp)).unwrap();
    let address = device.address().unwrap();
    let client = Path::new(env!("CARGO_MANIFEST_DIR")).join("peers/hokuyolx_client.py");
    let output = Command::new(python)
        .arg(client)
        .args([address.ip().to_string(), address.port().to_string()])
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let read: Value = serde_json::from_slice(&output.stdout).unwrap();

    let expected: Vec<u32> = (0..1081).map(ramp).collect();
    for scan in ["once", "with_intensities", "last"] {
        let ranges: Vec<u32> = serde_json::from_value(read[scan].clone()).unwrap();
        assert_eq!(ranges, expected, "{scan}");
    }
    assert_eq!(read["parameters"]["AFRT"], 540);
    assert_eq!(read["version"]["SERI"], "H1000484");
    assert_eq!(read["state"]["STAT"], "Sensor works well.");
    let left: Vec<u32> = serde_json::from_value(read["left"].clone()).unwrap();
    assert_eq!(left, (0..20).rev().collect::<Vec<_>>());
    let steps_ms: Vec<u32> = serde_json::from_value(read["steps_ms"].clone()).unwrap();
    assert!(steps_ms.iter().all(|step| (24..=26).contains(step)), "{steps_ms:?}");
}
