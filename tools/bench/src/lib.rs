//! Benchmarks of the workspace, area by area. `cargo xtask bench` builds this in release and prints the table.
#![forbid(unsafe_code)]

pub mod can;
pub mod data;
mod data_sshd;
mod flow;
pub mod gate;
pub mod imaging;
pub mod lidar;
pub mod mapping;
pub mod network;
pub mod peers;
pub mod perception;
pub mod recorder;
pub mod report;
pub mod simulator;
pub mod trainer;

use report::Row;

/// Measures the rows of one area.
pub type Measure = fn() -> anyhow::Result<Vec<Row>>;

/// All areas in the order of the table.
pub const AREAS: &[(&str, Measure)] = &[
    ("simulator", simulator::rows),
    ("mapping", mapping::measure),
    ("network", network::rows),
    ("perception", perception_rows),
    ("drivers", driver_rows),
    ("trainer", trainer::rows),
    ("data", data_rows),
];

/// Decoders and encoders of devices.
fn driver_rows() -> anyhow::Result<Vec<Row>> {
    let mut rows = lidar::rows()?;
    rows.extend(can::measure()?);
    Ok(rows)
}

/// Recorder, transfer of recordings to the workstation, and the gate for new models.
fn data_rows() -> anyhow::Result<Vec<Row>> {
    let mut rows = recorder::rows()?;
    rows.extend(data::rows()?);
    rows.extend(gate::rows()?);
    Ok(rows)
}

/// Front end, coarse depth and optical flow.
fn perception_rows() -> anyhow::Result<Vec<Row>> {
    let mut rows = perception::rows()?;
    rows.extend(imaging::rows()?);
    rows.extend(flow::rows()?);
    Ok(rows)
}
