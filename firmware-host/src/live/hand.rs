//! Who drives the robot by hand at the moment.

use std::time::{Duration, Instant};

use runtime::task::HOLD_NS;

use super::rate::Bucket;

/// Orders to drive a second, and in a burst. The page sends ten.
const DRIVES_PER_S: f64 = 30.0;
const BURST: f64 = 30.0;
/// After this time without an order, another client may drive.
const FREE_AFTER: Duration = Duration::from_secs(1);
/// An order that has waited for longer is not carried out: the person may have let go since.
pub const DRIVE_WITHIN: Duration = Duration::from_nanos(HOLD_NS);

/// The client that drives.
#[derive(Debug)]
pub struct Hand {
    driver: Option<(String, Instant)>,
    rate: Bucket,
}

impl Default for Hand {
    fn default() -> Self {
        Self { driver: None, rate: Bucket::new(DRIVES_PER_S, BURST) }
    }
}

impl Hand {
    /// Lets a client drive at `now`. Returns whether it begins to: only that is noted in the recording, whose ticks hold each
    /// velocity.
    ///
    /// # Errors
    /// Another client drives, or too many orders have come; in words.
    pub fn take(&mut self, who: &str, now: Instant) -> Result<bool, String> {
        let driver = self.driver.as_ref().filter(|(_, then)| now < *then + FREE_AFTER);
        if let Some((other, _)) = driver.filter(|(driver, _)| driver != who) {
            return Err(format!("{other} drives the robot by hand"));
        }
        let begins = driver.is_none();
        if !self.rate.take(now) {
            return Err(format!(
                "more than {DRIVES_PER_S} orders to drive a second: wait a moment"
            ));
        }
        self.driver = Some((who.to_owned(), now));
        Ok(begins)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::after_ms;
    use super::*;

    #[test]
    fn one_client_drives_until_it_has_been_silent_for_a_second() {
        let began = Instant::now();
        let mut hand = Hand::default();
        assert_eq!(hand.take("anna", after_ms(began, 0)), Ok(true));
        assert_eq!(hand.take("anna", after_ms(began, 100)), Ok(false));
        assert!(hand.take("ben", after_ms(began, 200)).unwrap_err().contains("anna drives"));
        assert_eq!(hand.take("anna", after_ms(began, 900)), Ok(false));
        assert!(hand.take("ben", after_ms(began, 1800)).is_err());
        assert_eq!(hand.take("ben", after_ms(began, 1900)), Ok(true));
        assert!(hand.take("anna", after_ms(began, 2000)).unwrap_err().contains("ben drives"));
        assert_eq!(hand.take("ben", after_ms(began, 5000)), Ok(true));
    }

    #[test]
    fn a_flood_of_orders_to_drive_is_refused() {
        let now = Instant::now();
        let mut hand = Hand::default();
        let taken = (0..100).filter(|_| hand.take("anna", now).is_ok()).count();
        assert_eq!(taken, BURST as usize);
    }
}
