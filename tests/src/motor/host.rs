//! The `hil base` command: runs the real base driver in a terminal and drives straight ahead.

use std::error::Error;

use clap::Args;
use drivers::can::{DifferentialBase, Phase, open_bus};
use hal::{Base, Clock, DriveCommand, Twist2};
use monotonic_clock::MonotonicClock;

use super::rig;
use super::run::ProtocolArg;

const TICK_NS: u64 = 10_000_000;

/// Arm the base with simulated controllers 1 and 2, and drive.
#[derive(Debug, Args)]
pub struct BaseArgs {
    /// Bus: `unix:PATH` or a CAN interface.
    #[arg(long, default_value = "unix:/tmp/can")]
    bus: String,
    /// Protocol of the controllers.
    #[arg(long, value_enum, default_value_t = ProtocolArg::Odrive)]
    protocol: ProtocolArg,
    /// Linear velocity, m/s.
    #[arg(long, default_value_t = 0.2, allow_negative_numbers = true)]
    speed: f64,
    /// Angular velocity, rad/s.
    #[arg(long, alias = "turn", default_value_t = 0.0, allow_negative_numbers = true)]
    yaw_rate: f64,
    /// End after this time, seconds.
    #[arg(long)]
    seconds: Option<f64>,
}

/// Runs until interrupted. It arms only once, so the base stays stopped after any trip.
///
/// # Errors
/// Returns an error when the base refuses its configuration.
pub fn run_base(args: &BaseArgs) -> Result<(), Box<dyn Error>> {
    let config = rig::config(args.protocol.into());
    let mut base = DifferentialBase::new(open_bus(&args.bus), &config)?;
    let mut clock = MonotonicClock;
    let start_ns = clock.now_ns();
    let mut counter = 0;
    let mut armed = false;
    let mut next_ns = start_ns;
    let mut last_message = String::new();
    let twist = Twist2 { linear_mps: args.speed, angular_radps: args.yaw_rate };
    loop {
        next_ns += TICK_NS;
        clock.sleep_until_ns(next_ns);
        // Missed ticks are skipped.
        next_ns = next_ns.max(clock.now_ns());
        let feedback = base.poll_feedback();
        armed = armed || base.arm().is_ok();
        if base.phase() == Phase::Armed {
            counter += 1;
            let _ = base.drive(&DriveCommand { twist, counter, plan_age_ns: 0 });
        }
        let message = base.explain();
        if message != last_message {
            println!("{:8.3} s  {message}", (clock.now_ns() - start_ns) as f64 * 1e-9);
            last_message = message;
        }
        if args.seconds.is_some_and(|seconds| (clock.now_ns() - start_ns) as f64 * 1e-9 >= seconds)
        {
            println!("feedback {feedback:?}");
            println!("counts {:?}", base.counts());
            return Ok(());
        }
    }
}
