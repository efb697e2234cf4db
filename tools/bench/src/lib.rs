//! What the project promises to be fast at, room by room. `cargo xtask bench` builds this in release and prints the table.
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

/// Measures one room, when it is called.
pub type Measure = fn() -> anyhow::Result<Vec<Row>>;

/// Every room that has something to measure, in the order of the table.
pub const ROOMS: &[(&str, Measure)] = &[
    ("simulator", simulator::rows),
    ("mapping", mapping::measure),
    ("network", network::rows),
    ("perception", perception_rows),
    ("drivers", driver_rows),
    ("trainer", trainer::rows),
    ("data", data_rows),
];

/// From a device's bytes to a decision, and back to frames.
fn driver_rows() -> anyhow::Result<Vec<Row>> {
    let mut rows = lidar::rows()?;
    rows.extend(can::measure()?);
    Ok(rows)
}

/// What is recorded, how it comes to the workstation, and how the robot judges what comes back.
fn data_rows() -> anyhow::Result<Vec<Row>> {
    let mut rows = recorder::rows()?;
    rows.extend(data::rows()?);
    rows.extend(gate::rows()?);
    Ok(rows)
}

/// From the camera's bytes to coarse depth, and optical flow.
fn perception_rows() -> anyhow::Result<Vec<Row>> {
    let mut rows = perception::rows()?;
    rows.extend(imaging::rows()?);
    rows.extend(flow::rows()?);
    Ok(rows)
}
