//! Which samples are refused.

use hal::ImuSample;

/// Why a sample was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// A record without a time or with too few bytes.
    #[error("a record is incomplete or has a negative time")]
    Record,
    #[error("a number is not finite")]
    NotFinite,
    #[error("an angular velocity is above 100 rad/s")]
    TooFast,
    #[error("a time is before that of an earlier sample")]
    Backwards,
    #[error("a time is in the future; times must be of the monotonic clock")]
    Future,
    #[error("a time is more than a second ago; times must be of the monotonic clock")]
    Old,
}

/// 5,700 degrees per second: MEMS gyroscopes measure up to 2,000 to 4,000.
const FASTEST_RADPS: f64 = 100.0;
/// Drivers that count time on the chip estimate the offset between the clocks, and a sample may then be slightly ahead.
const AHEAD_NS: u64 = 20_000_000;
/// An older sample is of another clock, such as one that counts from the start of the unit. No driver keeps samples for so long.
const OLDEST_NS: u64 = 1_000_000_000;

/// Refuses samples that cannot be.
#[derive(Debug, Clone, Default)]
pub struct SampleCheck {
    last_ns: u64,
}

impl SampleCheck {
    /// Checks the next sample.
    ///
    /// # Errors
    /// Why the sample must be dropped.
    pub fn check(&mut self, sample: &ImuSample, now_ns: u64) -> Result<(), Refusal> {
        if !sample.is_finite() {
            return Err(Refusal::NotFinite);
        }
        if sample.angular_radps.iter().any(|radps| radps.abs() > FASTEST_RADPS) {
            return Err(Refusal::TooFast);
        }
        if sample.time_ns < self.last_ns {
            return Err(Refusal::Backwards);
        }
        if sample.time_ns > now_ns.saturating_add(AHEAD_NS) {
            return Err(Refusal::Future);
        }
        if sample.time_ns.saturating_add(OLDEST_NS) < now_ns {
            return Err(Refusal::Old);
        }
        self.last_ns = sample.time_ns;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(time_ns: u64, radps: f64) -> ImuSample {
        ImuSample { time_ns, angular_radps: [0.0, 0.0, radps], force_mps2: None }
    }

    #[test]
    fn samples_that_cannot_be_are_refused_and_the_next_good_one_is_accepted() {
        let now_ns = 1_000_000_550;
        let mut check = SampleCheck::default();
        for (time_ns, radps, result) in [
            (549, 1.0, Err(Refusal::Old)),
            (550, 1.0, Ok(())),
            (600, f64::NAN, Err(Refusal::NotFinite)),
            (600, -100.1, Err(Refusal::TooFast)),
            (600, -100.0, Ok(())),
            (599, 1.0, Err(Refusal::Backwards)),
            (u64::MAX, 1.0, Err(Refusal::Future)),
            (600, 1.0, Ok(())),
            (now_ns + AHEAD_NS, 1.0, Ok(())),
        ] {
            assert_eq!(check.check(&sample(time_ns, radps), now_ns), result, "{time_ns} {radps}");
        }
    }
}
