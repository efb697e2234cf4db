//! `hil base`: the real driver in a terminal, driving straight on.

use std::error::Error;

use clap::Args;
use drivers::can::{DifferentialBase, Phase, open_bus};
use hal::{Base, Clock, DriveCommand, Twist2};
use monotonic_clock::MonotonicClock;

use super::rig;
use super::run::Spoken;

const TURN_NS: u64 = 10_000_000;

/// Arms the base of simulated controllers 1 and 2, and drives.
#[derive(Debug, Args)]
pub struct BaseArgs {
    /// `unix:PATH` or a CAN interface.
    #[arg(long, default_value = "unix:/tmp/can")]
    bus: String,
    /// What the controllers speak.
    #[arg(long, value_enum, default_value_t = Spoken::Odrive)]
    protocol: Spoken,
    /// Speed, m/s.
    #[arg(long, default_value_t = 0.2, allow_negative_numbers = true)]
    speed: f64,
    /// Turn rate, rad/s.
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true)]
    turn: f64,
    /// Ends after so many seconds.
    #[arg(long)]
    seconds: Option<f64>,
}

/// Runs until interrupted. Arms once: whatever stops the base stops it for good.
///
/// # Errors
/// When the base refuses its configuration.
pub fn run_base(args: &BaseArgs) -> Result<(), Box<dyn Error>> {
    let config = rig::config(args.protocol.into());
    let mut base = DifferentialBase::new(open_bus(&args.bus), &config)?;
    let mut clock = MonotonicClock;
    let (start_ns, mut counter, mut armed) = (clock.now_ns(), 0, false);
    let mut next_ns = start_ns;
    let mut said = String::new();
    let twist = Twist2 { linear_mps: args.speed, angular_radps: args.turn };
    loop {
        next_ns += TURN_NS;
        clock.sleep_until_ns(next_ns);
        // Late turns are left out, never made up for.
        next_ns = next_ns.max(clock.now_ns());
        let feedback = base.poll_feedback();
        armed = armed || base.arm().is_ok();
        if base.phase() == Phase::Armed {
            counter += 1;
            let _ = base.drive(&DriveCommand { twist, counter, plan_age_ns: 0 });
        }
        let says = base.explain();
        if says != said {
            println!("{:8.3} s  {says}", (clock.now_ns() - start_ns) as f64 * 1e-9);
            said = says;
        }
        if args.seconds.is_some_and(|seconds| (clock.now_ns() - start_ns) as f64 * 1e-9 >= seconds)
        {
            println!("feedback {feedback:?}");
            println!("counts {:?}", base.counts());
            return Ok(());
        }
    }
}
