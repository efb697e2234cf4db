//! The `hil hokuyo` command.

use std::error::Error;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;

use clap::Args;
use drivers::scip::Model;
use hal::Clock;
use monotonic_clock::MonotonicClock;
use monotonic_clock::monotonic_ns;

use super::faults::{EventKind, FaultPlan};
use super::{Health, Room, SimulatedHokuyo, WireFaults};

/// Simulate a Hokuyo scanner in a room of 6 x 4 m in which a person walks around it.
#[derive(Debug, Clone, Args)]
pub struct HokuyoArgs {
    /// Create a pty and a symbolic link to it at this path, as udev creates /dev/serial/by-id/...
    #[arg(long, required_unless_present_any = ["tcp", "serial"])]
    pub pty: Option<PathBuf>,
    /// Listen on this local TCP port instead, as the Ethernet models do on port 10940.
    #[arg(long, conflicts_with = "pty")]
    pub tcp: Option<u16>,
    /// Use this serial port instead; its other end is connected to the host.
    #[arg(long, conflicts_with_all = ["pty", "tcp"])]
    pub serial: Option<PathBuf>,
    /// Model: urg-04lx, utm-30lx, ust-10lx or ust-20lx.
    #[arg(long, default_value = "utm-30lx")]
    pub model: Model,
    /// Faults and their times:
    /// stall@5+0.5,unplug@10+2,reboot@15+1,noise@20,blind@25,motor@30,laser@35,flip=0.01,cut=0.01,
    /// drift=200. Times are BEGIN+DURATION in seconds after the start; flip and cut are fractions
    /// of messages; drift is in parts per million.
    #[arg(long, default_value = "")]
    pub faults: FaultPlan,
    /// End after this time, seconds; without it, when interrupted.
    #[arg(long)]
    pub seconds: Option<f64>,
}

/// Runs until interrupted or until the given time.
///
/// # Errors
/// Returns an error when the pty or the port cannot be opened.
pub fn run(args: &HokuyoArgs) -> Result<(), Box<dyn Error>> {
    let source = Box::new(Room::new(args.model));
    let device = match (&args.pty, &args.serial, args.tcp) {
        (_, Some(port), _) => SimulatedHokuyo::on_serial(args.model, port, source)
            .map_err(|error| format!("cannot open the serial port {}: {error}", port.display()))?,
        (Some(link), ..) => SimulatedHokuyo::on_pty(args.model, link, source).map_err(|error| {
            format!(
                "cannot create a pty at {}: {error}; does another file exist there?",
                link.display()
            )
        })?,
        (None, None, port) => {
            let port = port.unwrap_or_default();
            SimulatedHokuyo::on_tcp(
                args.model,
                SocketAddr::from((Ipv4Addr::LOCALHOST, port)),
                source,
            )
            .map_err(|error| {
                format!("cannot listen on TCP port {port}: {error}; choose another with --tcp")
            })?
        }
    };
    match (args.pty.as_ref().or(args.serial.as_ref()), device.address()) {
        (Some(link), _) => println!("{} on {}", args.model, link.display()),
        (None, Some(address)) => println!("{} on tcp:{address}", args.model),
        (None, None) => {}
    }
    device.set_wire(args.faults.wire);
    device.set_clock_ppm(args.faults.drift_ppm);
    play(args, &device)
}

fn play(args: &HokuyoArgs, device: &SimulatedHokuyo) -> Result<(), Box<dyn Error>> {
    let begin_ns = monotonic_ns();
    let mut clock = MonotonicClock;
    let mut scans_before = 0;
    for step in 0_u64.. {
        clock.sleep_until_ns(begin_ns + step * 100_000_000);
        let now_s = step as f64 * 0.1;
        if args.seconds.is_some_and(|seconds| now_s >= seconds) {
            break;
        }
        for event in &args.faults.events {
            if is_due(event.begin_s, step) {
                println!("{now_s:6.1} s  {} begins", event.kind);
                begin(device, event.kind, event.end_s - event.begin_s, args.faults.wire);
            }
            if is_due(event.end_s, step) {
                println!("{now_s:6.1} s  {} ends", event.kind);
                end(device, event.kind, args.faults.wire)?;
            }
        }
        if step % 10 == 0 {
            let (scans, is_streaming) = device.scans();
            let what = match (device.is_plugged_in(), is_streaming) {
                (false, _) => "unplugged",
                (true, true) => "sending",
                (true, false) => "waiting for a request",
            };
            println!(
                "{now_s:6.1} s  {what}, {} scans/s",
                scans - std::mem::replace(&mut scans_before, scans)
            );
        }
    }
    Ok(())
}

fn is_due(at_s: f64, step: u64) -> bool {
    (at_s * 10.0).round() as u64 == step
}

fn begin(device: &SimulatedHokuyo, kind: EventKind, length_s: f64, wire: WireFaults) {
    match kind {
        EventKind::Stall => device.set_wire(WireFaults { is_stalled: true, ..wire }),
        EventKind::Unplug => device.unplug(),
        EventKind::Reboot => device.reboot((length_s * 1e9) as u64),
        EventKind::Noise => device.set_wire(WireFaults { noise_bytes: 500, ..wire }),
        EventKind::Blind => device.set_health(Health::Blind),
        EventKind::Motor => device.set_health(Health::MotorFault),
        EventKind::Laser => device.set_health(Health::LaserOff),
    }
}

fn end(device: &SimulatedHokuyo, kind: EventKind, wire: WireFaults) -> std::io::Result<()> {
    match kind {
        EventKind::Stall | EventKind::Noise => device.set_wire(wire),
        EventKind::Unplug => device.plug_in()?,
        EventKind::Reboot => {}
        EventKind::Blind | EventKind::Motor | EventKind::Laser => device.set_health(Health::Well),
    }
    Ok(())
}
