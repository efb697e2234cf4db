//! Compares two decisions field by field.

use std::fmt;

use runtime::tick::Decision;
use serde_json::Value;

/// A field in which two decisions differ. Its values are in JSON, which shows every number exactly.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Difference {
    /// Path of the field, such as `desired.linear_mps` or `events[0].why`.
    pub field: String,
    /// Value of the recorded decision.
    pub recorded: String,
    /// Value of the recomputed decision.
    pub recomputed: String,
}

impl Difference {
    pub(super) fn memory() -> Self {
        Self {
            field: "snapshot".to_owned(),
            recorded: "one memory".to_owned(),
            recomputed: "another memory, although no decision has differed".to_owned(),
        }
    }

    pub(super) fn not_recorded() -> Self {
        Self {
            field: "decision".to_owned(),
            recorded: "nothing".to_owned(),
            recomputed: "a decision".to_owned(),
        }
    }
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: recorded {}, now {}", self.field, self.recorded, self.recomputed)
    }
}

/// All fields that differ in at least one bit: 0.0 differs from -0.0.
///
/// # Errors
/// When a decision cannot be written as JSON.
pub fn differences(
    recorded: &Decision,
    recomputed: &Decision,
) -> serde_json::Result<Vec<Difference>> {
    let mut found = Vec::new();
    collect("", &serde_json::to_value(recorded)?, &serde_json::to_value(recomputed)?, &mut found);
    Ok(found)
}

fn collect(path: &str, recorded: &Value, recomputed: &Value, found: &mut Vec<Difference>) {
    match (recorded, recomputed) {
        (Value::Object(a), Value::Object(b)) => {
            for (key, value) in a {
                let path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
                collect(&path, value, b.get(key).unwrap_or(&Value::Null), found);
            }
            for (key, value) in b.iter().filter(|(key, _)| !a.contains_key(*key)) {
                collect(&format!("{path}.{key}"), &Value::Null, value, found);
            }
        }
        (Value::Array(a), Value::Array(b)) => {
            for at in 0..a.len().max(b.len()) {
                let recorded = a.get(at).unwrap_or(&Value::Null);
                let recomputed = b.get(at).unwrap_or(&Value::Null);
                collect(&format!("{path}[{at}]"), recorded, recomputed, found);
            }
        }
        _ => {
            // Compared as text, because as numbers -0.0 equals 0.0.
            let recorded = text(recorded);
            let recomputed = text(recomputed);
            if recorded != recomputed {
                found.push(Difference { field: path.to_owned(), recorded, recomputed });
            }
        }
    }
}

fn text(value: &Value) -> String {
    if value.is_null() { "nothing".to_owned() } else { value.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::tests::some_tick;
    use runtime::event::Event;

    fn changed(change: impl FnOnce(&mut Decision)) -> Vec<String> {
        let recorded = some_tick(3).decision.unwrap();
        let mut recomputed = recorded.clone();
        change(&mut recomputed);
        differences(&recorded, &recomputed).unwrap().iter().map(ToString::to_string).collect()
    }

    #[test]
    fn equal_decisions_do_not_differ() {
        assert!(changed(|_| {}).is_empty());
    }

    #[test]
    fn a_difference_reads_as_field_recorded_now() {
        assert_eq!(
            changed(|d| d.desired.linear_mps = 0.25),
            ["desired.linear_mps: recorded 0.3, now 0.25"]
        );
        assert_eq!(changed(|d| d.goal_m = None), ["goal_m: recorded [1.0,2.0], now nothing"]);
        assert_eq!(
            changed(|d| d.depth_digest = u64::MAX),
            ["depth_digest: recorded 3, now 18446744073709551615"]
        );
        let event = changed(|d| d.events.push(Event::GoalReached));
        assert_eq!(event, [r#"events[0]: recorded nothing, now {"event":"goal_reached"}"#]);
    }

    #[test]
    fn the_last_bit_the_sign_of_zero_and_nan_count() {
        assert_eq!(changed(|d| d.desired.linear_mps = 0.3_f64.next_up()).len(), 1);
        assert_eq!(
            changed(|d| d.desired.angular_radps = -0.0),
            ["desired.angular_radps: recorded 0.0, now -0.0"]
        );
        assert_eq!(changed(|d| d.desired.angular_radps = f64::NAN).len(), 1);
    }
}
