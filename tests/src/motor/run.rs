//! The `hil motor` command.

use std::error::Error;
use std::io::{IsTerminal, Write, stdout};
use std::path::Path;
use std::str::FromStr;

use clap::{Args, ValueEnum};
use drivers::can::{CanBus, Protocol, SocketBus};
use hal::Clock;
use monotonic_clock::MonotonicClock;

use super::hub::Hub;
use super::node::MotorNode;
use super::outbox::Outbox;
use super::rig;

const STEP_NS: u64 = 1_000_000;
const SECOND_NS: u64 = 1_000_000_000;

/// Simulate two motor controllers on a CAN bus.
#[derive(Debug, Args)]
pub struct MotorArgs {
    /// Bus: `unix:PATH` opens a bus between processes there; any other value is a CAN interface
    /// such as can0 or vcan0.
    #[arg(long, default_value = "unix:/tmp/can")]
    bus: String,
    /// Protocol of the controllers.
    #[arg(long, value_enum, default_value_t = ProtocolArg::Odrive)]
    protocol: ProtocolArg,
    /// Node of the left wheel; the right wheel has the next number.
    #[arg(long, default_value_t = 1)]
    node: u8,
    /// Fault at a time in seconds, such as `block@5`: block, reverse, silent, break, forget, reboot
    /// (all of the left motor) or bus-off; `heal` ends all faults. May be given several times.
    #[arg(long = "fault", value_name = "FAULT@SECONDS")]
    faults: Vec<Scheduled>,
    /// End after this time, seconds.
    #[arg(long)]
    seconds: Option<f64>,
    /// Print one line with the monotonic time in ns whenever a wheel begins or ceases to be driven.
    #[arg(long)]
    events: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum ProtocolArg {
    /// ODrive controllers, with the protocol CANSimple.
    Odrive,
    /// VESC controllers, with extended CAN frames.
    Vesc,
    /// CANopen drives, with the profile CiA 402.
    Cia402,
}

impl ProtocolArg {
    /// The value of the command-line option.
    pub fn name(self) -> String {
        format!("{self:?}").to_lowercase()
    }
}

impl From<ProtocolArg> for Protocol {
    fn from(protocol: ProtocolArg) -> Self {
        match protocol {
            ProtocolArg::Odrive => Self::Odrive,
            ProtocolArg::Vesc => Self::Vesc,
            ProtocolArg::Cia402 => Self::Cia402,
        }
    }
}

#[derive(Debug, Clone, PartialEq)]
struct Scheduled {
    fault: String,
    at_ns: u64,
}

impl FromStr for Scheduled {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        const KNOWN: [&str; 8] =
            ["block", "reverse", "silent", "break", "forget", "reboot", "bus-off", "heal"];
        let (fault, seconds) =
            text.split_once('@').ok_or("write FAULT@SECONDS, such as block@5")?;
        if !KNOWN.contains(&fault) {
            return Err(format!("`{fault}` is not a fault; the faults are {}", KNOWN.join(", ")));
        }
        match seconds.parse::<f64>() {
            Ok(seconds) if (0.0..1e6).contains(&seconds) => {
                Ok(Self { fault: fault.to_owned(), at_ns: (seconds * 1e9) as u64 })
            }
            _ => Err(format!("`{seconds}` is not a time in seconds")),
        }
    }
}

/// The bus of the controllers.
enum Wire {
    Hub(Hub),
    Interface(SocketBus),
}

/// Runs until interrupted.
///
/// # Errors
/// Returns an error when the bus cannot be opened.
pub fn run(args: &MotorArgs) -> Result<(), Box<dyn Error>> {
    let protocol = Protocol::from(args.protocol);
    let right = args.node.checked_add(1).ok_or("--node must be below 255")?;
    let mut nodes = [rig::node(protocol, args.node), rig::node(protocol, right)];
    let mut wire = match args.bus.strip_prefix("unix:") {
        Some(path) => {
            Wire::Hub(Hub::bind(Path::new(path)).map_err(|error| format!("{path}: {error}"))?)
        }
        None => Wire::Interface(SocketBus::new(&args.bus)),
    };
    println!(
        "{:?} nodes {} (left) and {right} (right) on {}; end with Ctrl-C",
        args.protocol, args.node, args.bus
    );
    let mut clock = MonotonicClock;
    let start_ns = clock.now_ns();
    let mut schedule = args.faults.clone();
    schedule.sort_by_key(|scheduled| std::cmp::Reverse(scheduled.at_ns));
    let mut now_ns = start_ns;
    let mut shown_ns = 0;
    let mut driven = [false; 2];
    let mut outbox = Outbox::default();
    loop {
        now_ns = (now_ns + STEP_NS).max(clock.now_ns());
        clock.sleep_until_ns(now_ns);
        while schedule.last().is_some_and(|next| now_ns - start_ns >= next.at_ns) {
            if let Some(next) = schedule.pop() {
                inject(&next.fault, &mut nodes, &mut wire);
                println!("\r{:8.3} s  {}", (now_ns - start_ns) as f64 * 1e-9, next.fault);
            }
        }
        match &mut wire {
            Wire::Hub(hub) => rig::step_nodes(&mut nodes, hub, now_ns, &mut outbox),
            Wire::Interface(bus) => rig::step_nodes(&mut nodes, bus, now_ns, &mut outbox),
        }
        if args.events {
            report_changes(&nodes, &mut driven, now_ns);
        } else if now_ns - shown_ns >= SECOND_NS / 5 {
            shown_ns = now_ns;
            show(&nodes, &wire, now_ns - start_ns)?;
        }
        if args.seconds.is_some_and(|seconds| (now_ns - start_ns) as f64 * 1e-9 >= seconds) {
            println!();
            return Ok(());
        }
    }
}

fn inject(fault: &str, nodes: &mut [Box<dyn MotorNode>; 2], wire: &mut Wire) {
    let [left, right] = nodes;
    match fault {
        "block" => left.wheel_mut().blocked = true,
        "reverse" => left.wheel_mut().encoder_reversed = true,
        "silent" => left.faults().silent = true,
        "break" => left.faults().broken = true,
        "forget" => left.faults().forgets_watchdog = true,
        "reboot" => left.faults().reboot = true,
        "bus-off" => {
            if let Wire::Hub(hub) = wire {
                hub.inject_bus_off();
            }
        }
        _ => {
            for node in [left, right] {
                *node.faults() = super::NodeFaults::default();
                node.wheel_mut().blocked = false;
                node.wheel_mut().encoder_reversed = false;
            }
        }
    }
}

/// A wheel is driven while its controller powers it with a target velocity other than zero.
fn report_changes(nodes: &[Box<dyn MotorNode>; 2], driven: &mut [bool; 2], now_ns: u64) {
    for ((node, driven), side) in nodes.iter().zip(driven).zip(["left", "right"]) {
        let is_driven =
            matches!(node.wheel().drive(), super::Drive::Velocity(velocity) if velocity != 0.0);
        if is_driven != *driven {
            *driven = is_driven;
            let what = if is_driven { "driven" } else { "released" };
            println!(
                "{now_ns} {side} {what} fed {} expired {}",
                node.watchdog().fed_ns,
                node.watchdog().expired
            );
            let _ = stdout().flush();
        }
    }
}

fn show(nodes: &[Box<dyn MotorNode>; 2], wire: &Wire, run_ns: u64) -> std::io::Result<()> {
    let [left, right] = nodes.each_ref().map(|node| {
        let watchdog = node.watchdog();
        let limit = watchdog
            .limit_ns
            .map_or_else(|| "off".to_owned(), |limit_ns| format!("{} ms", limit_ns / 1_000_000));
        let power = if node.is_powered() { "powered" } else { "idle   " };
        let velocity = node.wheel().velocity_radps();
        format!("{velocity:+7.2} rad/s {power} watchdog {limit}, expired {}", watchdog.expired)
    });
    let bus = match wire {
        Wire::Hub(hub) => format!("{} connected", hub.connections()),
        Wire::Interface(bus) => bus.name().to_owned(),
    };
    let line = format!("{:8.1} s  left {left} | right {right} | {bus}", run_ns as f64 * 1e-9);
    // In a terminal the line is updated in place; in a file every update is a line.
    if stdout().is_terminal() {
        print!("\r\x1b[K{line}");
    } else {
        println!("{line}");
    }
    stdout().flush()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_needs_a_name_and_a_time() {
        assert_eq!(
            "block@1.5".parse(),
            Ok(Scheduled { fault: "block".to_owned(), at_ns: 1_500_000_000 })
        );
        assert!("block".parse::<Scheduled>().is_err());
        assert!("burn@1".parse::<Scheduled>().is_err_and(|error| error.contains("reverse")));
        assert!("block@NaN".parse::<Scheduled>().is_err());
    }
}
