//! Turns each wheel a quarter turn through the base driver, and concludes order, direction and gear from what a person sees.

use std::f64::consts::{FRAC_PI_2, TAU};

use anyhow::{Context, Result, anyhow, bail};
use drivers::can::{BaseConfig, CanBus, CanError, DifferentialBase, Phase, Side, open_bus};
use hal::{Base, Clock, DriveCommand, Twist2};
use monotonic_clock::MonotonicClock;

use super::dialogue::Dialogue;

/// Period of the commands.
const TICK_NS: u64 = 10_000_000;
/// The motors are set up within this time, or something is wrong with them.
const SETUP_TICKS: u32 = 300;
/// The base is armed within this time: the driver itself gives up after three seconds.
const ARMING_TICKS: u32 = 400;
/// A quarter turn takes this long if the wheel follows its command...
const QUARTER_S: f64 = 2.0;
/// ... and is given up after this.
const QUARTER_TICKS: u32 = 800;
/// Time for braking, and for taking the power from the motors.
const BRAKE_TICKS: u32 = 80;
/// The rim of a large wheel is no faster than this, m/s.
const RIM_MPS: f64 = 0.1;
/// A person sees a quarter turn this exactly, degrees. Less is no reason for another gear.
const BY_EYE_DEG: f64 = 10.0;

/// By this share of its turn one wheel may turn further than the other, to the eye.
const SAME_SHARE: f64 = 0.25;

/// What turning the wheels showed about a configuration.
#[derive(Debug, Default, Clone, Copy, PartialEq)]
pub struct Correction {
    /// The controllers are on opposite sides.
    pub swap: bool,
    /// The left and the right motor turn backwards at a positive velocity.
    pub invert: [bool; 2],
    /// Another gear ratio.
    pub gear_ratio: Option<f64>,
}

/// What a person saw when one wheel was to turn a quarter forward.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Seen {
    wheel: Side,
    is_forward: bool,
    degrees: f64,
}

const SEEN: &str = "Which wheel turned, which way, and how many degrees? [";

/// Turns the wheels until they turn as configured, or until the person has seen enough. Every new correction is written.
///
/// # Errors
/// The base cannot be armed, or stopped; the wheels stand then.
pub fn run(
    dialogue: &mut Dialogue<'_>,
    base: &BaseConfig,
    write: &dyn Fn(&Correction) -> Result<()>,
) -> Result<()> {
    run_on(dialogue, base, write, &mut |config| {
        let base = DifferentialBase::new(open_bus(&config.bus), config)?;
        Ok(OnRobot { base, clock: MonotonicClock })
    })
}

fn run_on<B: Bench>(
    dialogue: &mut Dialogue<'_>,
    configured: &BaseConfig,
    write: &dyn Fn(&Correction) -> Result<()>,
    open: &mut dyn FnMut(&BaseConfig) -> Result<B, CanError>,
) -> Result<()> {
    dialogue.say(
        "\nEach wheel will turn a quarter turn forward, slowly. Lift both wheels off the ground, keep fingers and cables away, \
         and the emergency stop in reach. Ctrl-C stops the wheels.",
    )?;
    let mut correction = Correction::default();
    while dialogue.answer("Type yes to turn them: ")? == "yes" {
        let config = correction.applied_to(configured);
        let mut seen = Vec::new();
        for side in [Side::Left, Side::Right] {
            dialogue.say(&format!("\nThe {side} wheel turns."))?;
            quarter_turn(&mut open(&config)?, side, &config)
                .with_context(|| format!("the {side} wheel was stopped"))?;
            seen.push(ask(dialogue, side)?);
        }
        let after = correction.after([seen[0], seen[1]], config.gear_ratio);
        let after = match after {
            Ok(after) => after,
            Err(why) => {
                dialogue.say(&format!("! {why}"))?;
                continue;
            }
        };
        if after == correction {
            return dialogue.say("The wheels turn as the configuration says.");
        }
        for change in correction.changes(&after) {
            dialogue.say(&format!("Corrected: {change}"))?;
        }
        correction = after;
        write(&correction)?;
        dialogue.say("\nOnce more shows whether that is right.")?;
    }
    dialogue.say("The wheels stand.")
}

fn ask(dialogue: &mut Dialogue<'_>, side: Side) -> Result<Seen> {
    let expected = format!("{side} forward 90");
    loop {
        let text = dialogue.answer(&format!("{SEEN}{expected}]: "))?;
        let text = if text.is_empty() { &expected } else { &text };
        match Seen::parse(text) {
            Ok(seen) => return Ok(seen),
            Err(why) => dialogue.say(&format!("! {why}"))?,
        }
    }
}

impl Seen {
    fn parse(text: &str) -> Result<Self, String> {
        let words: Vec<&str> = text.split_whitespace().collect();
        let [wheel, way, degrees] = words[..] else { return Err(not_allowed(text)) };
        let wheel = match wheel {
            "left" | "l" => Side::Left,
            "right" | "r" => Side::Right,
            _ => return Err(not_allowed(text)),
        };
        let is_forward = match way {
            "forward" | "f" => true,
            "back" | "b" => false,
            _ => return Err(not_allowed(text)),
        };
        let degrees = degrees.parse().ok().filter(|degrees| (1.0..=3600.0).contains(degrees));
        Ok(Self { wheel, is_forward, degrees: degrees.ok_or_else(|| not_allowed(text))? })
    }
}

fn not_allowed(text: &str) -> String {
    format!(
        "`{text}` is not left or right, forward or back, and degrees from 1 to 3600, such as `left back 90`"
    )
}

impl Correction {
    /// The configuration with this correction.
    fn applied_to(&self, base: &BaseConfig) -> BaseConfig {
        let [invert_left, invert_right] = self.invert;
        BaseConfig {
            swap_wheels: self.swap,
            invert_left,
            invert_right,
            gear_ratio: self.gear_ratio.unwrap_or(base.gear_ratio),
            ..base.clone()
        }
    }

    /// The correction after the left and the right wheel were to turn with this one in force.
    fn after(&self, seen: [Seen; 2], gear_ratio: f64) -> Result<Self, String> {
        let [first, second] = seen;
        if first.wheel == second.wheel {
            return Err(format!("the {} wheel cannot be both wheels: look again", first.wheel));
        }
        let swaps = first.wheel == Side::Right;
        let mut invert = [false; 2];
        for (seen, was_inverted) in seen.into_iter().zip(self.invert) {
            let place = usize::from(seen.wheel == Side::Right);
            invert[place] = was_inverted == seen.is_forward;
        }
        let degrees = (first.degrees + second.degrees) / 2.0;
        if (first.degrees - second.degrees).abs() > SAME_SHARE * degrees + BY_EYE_DEG {
            return Err(format!(
                "{} and {} degrees: both wheels have the same gear, so look again, or check the gears",
                first.degrees, second.degrees
            ));
        }
        let is_as_expected = (degrees - 90.0).abs() <= BY_EYE_DEG;
        let seen_ratio = three_digits(gear_ratio * 90.0 / degrees);
        if !(0.01..=1000.0).contains(&seen_ratio) {
            return Err(format!("a gear ratio of {seen_ratio} is not possible: look again"));
        }
        Ok(Self {
            swap: self.swap != swaps,
            invert,
            gear_ratio: if is_as_expected { self.gear_ratio } else { Some(seen_ratio) },
        })
    }

    /// What another correction changes, in words.
    fn changes(&self, after: &Self) -> Vec<String> {
        let mut changes = Vec::new();
        if self.swap != after.swap {
            changes.push(
                "left and right are exchanged (devices.base.left_node, right_node)".to_owned(),
            );
        }
        for (place, side) in ["left", "right"].into_iter().enumerate() {
            if self.invert[place] != after.invert[place] {
                changes.push(format!(
                    "the {side} motor turns the other way (devices.base.invert_{side})"
                ));
            }
        }
        if let Some(ratio) = after.gear_ratio.filter(|_| self.gear_ratio != after.gear_ratio) {
            changes.push(format!("the gear ratio is about {ratio}; the gearbox's label is more exact (devices.base.gear_ratio)"));
        }
        changes
    }
}

/// The number with three digits, as much as a person sees.
fn three_digits(number: f64) -> f64 {
    format!("{number:.2e}").parse().unwrap_or(number)
}

/// A base and the passing of time.
trait Bench {
    /// The bus of its motors.
    type Bus: CanBus;
    /// The base's clock.
    type Time: Clock;

    /// The driver of the base whose wheels are turned.
    fn base(&mut self) -> &mut DifferentialBase<Self::Bus, Self::Time>;

    /// Waits for one tick.
    fn wait(&mut self);
}

struct OnRobot {
    base: DifferentialBase<Box<dyn CanBus + Send>>,
    clock: MonotonicClock,
}

impl Bench for OnRobot {
    type Bus = Box<dyn CanBus + Send>;
    type Time = MonotonicClock;

    fn base(&mut self) -> &mut DifferentialBase<Self::Bus> {
        &mut self.base
    }

    fn wait(&mut self) {
        let now_ns = self.clock.now_ns();
        self.clock.sleep_until_ns(now_ns + TICK_NS);
    }
}

/// Arms the base, turns one wheel by a quarter, and takes the power from the motors, also after an error.
fn quarter_turn(bench: &mut impl Bench, side: Side, config: &BaseConfig) -> Result<()> {
    let result = arm(bench).and_then(|()| turn(bench, side, config));
    // An error of stopping is that of a bus that is gone; the motors' own watchdogs stop them then.
    _ = bench.base().stop();
    bench.base().disarm();
    for _ in 0..BRAKE_TICKS {
        bench.wait();
        _ = bench.base().poll_feedback();
    }
    bench.base().finish();
    result
}

fn arm(bench: &mut impl Bench) -> Result<()> {
    for _ in 0..SETUP_TICKS {
        bench.wait();
        // While the motors are set up they are silent; `check` tells when they are ready, or why not.
        _ = bench.base().poll_feedback();
        if bench.base().check().is_ok() {
            break;
        }
    }
    bench.base().arm()?;
    for _ in 0..ARMING_TICKS {
        bench.wait();
        _ = bench.base().poll_feedback();
        match bench.base().phase() {
            Phase::Armed => return Ok(()),
            Phase::Arming => {}
            _ => bail!("{}", bench.base().explain()),
        }
    }
    bail!("{}", bench.base().explain())
}

fn turn(bench: &mut impl Bench, side: Side, config: &BaseConfig) -> Result<()> {
    let twist = one_wheel(side, config);
    let begin_rad = shaft_rad(bench, side);
    let quarter_rad = FRAC_PI_2 * config.gear_ratio;
    for counter in 1..=QUARTER_TICKS {
        bench.wait();
        let feedback = bench.base().poll_feedback()?;
        if feedback.is_some_and(|feedback| feedback.contact) {
            bail!(
                "it does not follow its command: is it blocked, does it touch the ground, or does its encoder count backwards?"
            );
        }
        if (shaft_rad(bench, side) - begin_rad).abs() >= quarter_rad {
            return Ok(());
        }
        if let Phase::Tripped(trip) = bench.base().phase() {
            return Err(CanError::Tripped(trip).into());
        }
        bench.base().drive(&DriveCommand { twist, counter, plan_age_ns: 0 })?;
    }
    let turned = (shaft_rad(bench, side) - begin_rad) / config.gear_ratio / TAU * 360.0;
    Err(anyhow!(
        "its controller measured {turned:.0} degrees in {} s instead of 90",
        QUARTER_TICKS / 100
    ))
}

/// The motion in which only this wheel turns.
fn one_wheel(side: Side, config: &BaseConfig) -> Twist2 {
    let rim_mps = (FRAC_PI_2 * config.wheel_radius_m / QUARTER_S).min(RIM_MPS);
    let yaw_radps = rim_mps / config.track_m;
    let angular_radps = if side == Side::Left { -yaw_radps } else { yaw_radps };
    Twist2 { linear_mps: rim_mps / 2.0, angular_radps }
}

fn shaft_rad(bench: &mut impl Bench, side: Side) -> f64 {
    let [left, right] = bench.base().motors();
    if side == Side::Left { left.position_rad } else { right.position_rad }
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivers::can::Protocol;
    use hal::VirtualClock;
    use hil::motor::MemoryBus;
    use hil::motor::rig::{Rig, config};
    use std::cell::RefCell;

    impl Bench for Rig {
        type Bus = MemoryBus;
        type Time = VirtualClock;

        fn base(&mut self) -> &mut DifferentialBase<MemoryBus, VirtualClock> {
            &mut self.base
        }

        fn wait(&mut self) {
            self.advance(TICK_NS);
        }
    }

    fn degrees(rig: &Rig) -> [f64; 2] {
        rig.nodes.each_ref().map(|node| node.wheel().position_rad().to_degrees())
    }

    #[test]
    fn one_wheel_turns_a_quarter_forward_and_the_other_stands() {
        for protocol in [Protocol::Odrive, Protocol::Vesc, Protocol::Cia402] {
            for (side, turns, stands) in [(Side::Left, 0, 1), (Side::Right, 1, 0)] {
                let config = config(protocol);
                let mut rig = Rig::new(&config).unwrap();
                quarter_turn(&mut rig, side, &config).unwrap();
                let degrees = degrees(&rig);
                assert!((89.0..97.0).contains(&degrees[turns]), "{protocol:?} {side}: {degrees:?}");
                assert!(degrees[stands].abs() < 1.0, "{protocol:?} {side}: {degrees:?}");
                assert!(rig.nodes.iter().all(|node| !node.is_powered()), "{protocol:?}");
            }
        }
    }

    #[test]
    fn a_blocked_wheel_is_stopped_with_the_reason_and_without_power() {
        let config = config(Protocol::Odrive);
        let mut rig = Rig::new(&config).unwrap();
        rig.nodes[0].wheel_mut().blocked = true;
        let error = quarter_turn(&mut rig, Side::Left, &config).unwrap_err().to_string();
        assert!(error.contains("does not follow its command"), "{error}");
        assert!(rig.nodes.iter().all(|node| !node.is_powered()));
    }

    #[test]
    fn an_encoder_that_counts_backwards_stops_the_wheel_at_once() {
        let config = config(Protocol::Odrive);
        let mut rig = Rig::new(&config).unwrap();
        rig.nodes[1].wheel_mut().encoder_reversed = true;
        let error = quarter_turn(&mut rig, Side::Right, &config).unwrap_err().to_string();
        assert!(error.contains("does its encoder count backwards?"), "{error}");
        assert!(degrees(&rig)[1].abs() < 60.0, "{:?}", degrees(&rig));
    }

    #[test]
    fn a_motor_without_a_watchdog_is_never_turned() {
        let config = config(Protocol::Odrive);
        let mut rig = Rig::new(&config).unwrap();
        rig.nodes[1].faults().forgets_watchdog = true;
        let error = quarter_turn(&mut rig, Side::Left, &config).unwrap_err().to_string();
        assert!(error.contains("watchdog"), "{error}");
        assert_eq!(degrees(&rig), [0.0, 0.0]);
    }

    fn seen(text: &str) -> Seen {
        Seen::parse(text).unwrap()
    }

    #[test]
    fn order_direction_and_gear_follow_from_what_is_seen() {
        let none = Correction::default();
        let as_configured = none.after([seen("left forward 90"), seen("right forward 85")], 1.0);
        assert_eq!(as_configured, Ok(none));
        let exchanged = none.after([seen("r back 90"), seen("l forward 90")], 1.0).unwrap();
        assert_eq!(exchanged, Correction { swap: true, invert: [false, true], gear_ratio: None });
        let geared = none.after([seen("left forward 9"), seen("right forward 9")], 1.0).unwrap();
        assert_eq!(geared.gear_ratio, Some(10.0));
        assert!(none.after([seen("left forward 90"), seen("left back 90")], 1.0).is_err());
        let unequal = none.after([seen("left forward 90"), seen("right forward 45")], 1.0);
        assert!(unequal.unwrap_err().contains("90 and 45 degrees"));
    }

    #[test]
    fn a_second_look_corrects_the_first_correction() {
        let first = Correction { swap: true, invert: [false, true], gear_ratio: None };
        let second = first.after([seen("l f 90"), seen("r b 90")], 1.0).unwrap();
        assert_eq!(second, Correction { swap: true, invert: [false; 2], gear_ratio: None });
        assert_eq!(second.after([seen("l f 90"), seen("r f 90")], 1.0), Ok(second));
    }

    #[test]
    fn words_that_describe_no_turn_are_refused_with_an_example() {
        for text in ["", "left", "left forward", "up forward 90", "left forward NaN", "left f 0"] {
            assert!(Seen::parse(text).unwrap_err().contains("left back 90"), "{text}");
        }
    }

    #[test]
    fn nothing_turns_without_the_word_yes() {
        let opened = RefCell::new(0);
        for word in ["\n", "y\n", "YES\n", "no\n"] {
            let mut output = Vec::new();
            let mut input = word.as_bytes();
            let mut dialogue = Dialogue::new(&mut input, &mut output, Some(80));
            let config = config(Protocol::Odrive);
            run_on(&mut dialogue, &config, &|_| Ok(()), &mut |config| {
                *opened.borrow_mut() += 1;
                Rig::new(config)
            })
            .unwrap();
        }
        assert_eq!(*opened.borrow(), 0);
    }

    #[test]
    fn a_dialogue_about_exchanged_wheels_ends_when_they_turn_as_configured() {
        let lines = "yes\nright back 90\nleft forward 90\nyes\n\n\n";
        let mut output = Vec::new();
        let mut input = lines.as_bytes();
        let mut dialogue = Dialogue::new(&mut input, &mut output, Some(80));
        let written = RefCell::new(Vec::new());
        let config = config(Protocol::Odrive);
        let configs = RefCell::new(Vec::new());
        run_on(
            &mut dialogue,
            &config,
            &|correction: &Correction| {
                written.borrow_mut().push(*correction);
                Ok(())
            },
            &mut |config| {
                configs.borrow_mut().push(config.clone());
                Rig::new(config)
            },
        )
        .unwrap();
        let text = String::from_utf8(output).unwrap();
        assert!(text.contains("left and right are exchanged"), "{text}");
        assert!(text.contains("turn as the configuration says"), "{text}");
        let expected = Correction { swap: true, invert: [false, true], gear_ratio: None };
        assert_eq!(*written.borrow(), [expected]);
        assert!(configs.borrow()[2].swap_wheels && configs.borrow()[2].invert_right);
    }
}
