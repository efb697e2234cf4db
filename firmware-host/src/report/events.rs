//! Counts the events of a run by their reason.

use std::collections::BTreeMap;

use runtime::event::{Event, SafetyEvent};
use serde::{Deserialize, Serialize};

/// Number of events by reason. The names of the reasons are those in the log.
pub type Reasons = BTreeMap<String, u64>;

/// Counts of exploration goals.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Goals {
    /// Chosen goals, by the reason for the choice.
    #[serde(skip_serializing_if = "Reasons::is_empty")]
    pub chosen: Reasons,
    pub reached: u64,
    /// Goals that were given up, by reason.
    #[serde(skip_serializing_if = "Reasons::is_empty")]
    pub dropped: Reasons,
}

/// All counts of a run. The default is for a run without driving: the counts that only a driving
/// robot has are absent.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct EventCounts {
    #[serde(skip_serializing_if = "Option::is_none")]
    pub goals: Option<Goals>,
    /// Attempts to choose a goal that found none, by reason.
    #[serde(skip_serializing_if = "Reasons::is_empty")]
    pub no_goal: Reasons,
    /// Frames without any depth, by reason.
    #[serde(skip_serializing_if = "Reasons::is_empty")]
    pub no_depth: Reasons,
    /// Number of safety stops for an obstacle (trips).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bumper_trips: Option<u64>,
    /// Safety stops by the sensor that detected the obstacle.
    #[serde(skip_serializing_if = "Reasons::is_empty")]
    pub bumper_trips_by: Reasons,
    /// Number of escapes: rotations out of a place where the robot tripped repeatedly.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bumper_escapes: Option<u64>,
    /// Number of times that the robot stood because the scanner did not see the path ahead; absent if it never did.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub view_lost: Option<u64>,
    /// Times that the robot did not know where it was, by reason.
    #[serde(skip_serializing_if = "Reasons::is_empty")]
    pub lost: Reasons,
    /// Number of maps that the robot began because it did not find itself; absent if it began none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub maps_begun: Option<u64>,
    /// How many of these became one with the map before; absent if none did.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub maps_joined: Option<u64>,
    /// Times that wheels and scans reported different motions, by kind.
    #[serde(skip_serializing_if = "Reasons::is_empty")]
    pub wheels_contradicted: Reasons,
    /// Changes of the calibration, by what changed.
    #[serde(skip_serializing_if = "Reasons::is_empty")]
    pub calibration_changed: Reasons,
    /// Refused sensor inputs, by reason.
    #[serde(skip_serializing_if = "Reasons::is_empty")]
    pub refused_inputs: Reasons,
    /// Number of stops because of a device or the control loop, by reason.
    #[serde(skip_serializing_if = "Reasons::is_empty")]
    pub safety_faults: Reasons,
}

impl EventCounts {
    /// The counts of a robot that drives: zeros instead of absent values.
    #[must_use]
    pub fn driving() -> Self {
        Self {
            goals: Some(Goals::default()),
            bumper_trips: Some(0),
            bumper_escapes: Some(0),
            ..Self::default()
        }
    }

    /// Counts one event. Events without a reason worth counting are ignored.
    pub fn add(&mut self, event: &Event) {
        match event {
            Event::GoalChosen { why, .. } => {
                count(&mut self.goals.get_or_insert_default().chosen, why);
            }
            Event::GoalReached => self.goals.get_or_insert_default().reached += 1,
            Event::GoalDropped { why } => {
                count(&mut self.goals.get_or_insert_default().dropped, why);
            }
            Event::NoGoal { why } => count(&mut self.no_goal, why),
            Event::NoDepth { why } => count(&mut self.no_depth, why),
            Event::Lost { why } => count(&mut self.lost, why),
            Event::MapBegun => *self.maps_begun.get_or_insert(0) += 1,
            Event::MapsJoined => *self.maps_joined.get_or_insert(0) += 1,
            Event::WheelsContradicted { how } => count(&mut self.wheels_contradicted, how),
            Event::CalibrationChanged { change } => {
                count(&mut self.calibration_changed, &change.what);
            }
            Event::InputRefused { why } => count(&mut self.refused_inputs, why),
            Event::Safety { what: SafetyEvent::Tripped { by, .. } } => {
                *self.bumper_trips.get_or_insert(0) += 1;
                count(&mut self.bumper_trips_by, by);
            }
            Event::Safety { what: SafetyEvent::ViewLost } => {
                *self.view_lost.get_or_insert(0) += 1;
            }
            Event::Safety { what: SafetyEvent::Faulted { why } } => {
                count(&mut self.safety_faults, why);
            }
            Event::Safety { what: SafetyEvent::Escaping } => {
                *self.bumper_escapes.get_or_insert(0) += 1;
            }
            _ => {}
        }
    }
}

fn count(reasons: &mut Reasons, why: &impl Serialize) {
    *reasons.entry(name(why)).or_default() += 1;
}

/// The name of a reason in the log and in the summary.
#[must_use]
pub fn name(why: &impl Serialize) -> String {
    match serde_json::to_value(why) {
        Ok(serde_json::Value::String(name)) => name,
        Ok(other) => other.to_string(),
        Err(_) => "unknown".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use runtime::{
        event::{BackOffEnd, DropReason, GoalReason, TripCause},
        perception::NoDepth,
    };

    fn trip(by: TripCause) -> Event {
        Event::Safety { what: SafetyEvent::Tripped { by, x_m: 0.3, y_m: 0.0 } }
    }

    #[test]
    fn every_event_is_counted_under_its_own_reason() {
        let mut counts = EventCounts::default();
        let events = [
            Event::GoalChosen { x_m: 1.0, y_m: 2.0, why: GoalReason::Frontier },
            Event::GoalChosen { x_m: 1.0, y_m: 3.0, why: GoalReason::Inconsistency },
            Event::GoalDropped { why: DropReason::NoProgress },
            Event::GoalReached,
            Event::NoDepth { why: NoDepth::TooLittleParallax },
            Event::NoDepth { why: NoDepth::TooLittleParallax },
            trip(TripCause::LidarHit),
            trip(TripCause::Contact),
            Event::Safety {
                what: SafetyEvent::BackedOff { distance_m: 0.2, end: BackOffEnd::Distance },
            },
            Event::Safety { what: SafetyEvent::Escaping },
            Event::Safety { what: SafetyEvent::ViewLost },
        ];
        events.iter().for_each(|event| counts.add(event));
        let goals = counts.goals.unwrap();
        assert_eq!(
            goals.chosen,
            Reasons::from([("frontier".into(), 1), ("inconsistency".into(), 1)])
        );
        assert_eq!((goals.reached, goals.dropped["no_progress"]), (1, 1));
        assert_eq!(counts.no_depth, Reasons::from([("too_little_parallax".into(), 2)]));
        assert_eq!((counts.bumper_trips, counts.bumper_escapes), (Some(2), Some(1)));
        assert_eq!(counts.view_lost, Some(1));
        assert_eq!(
            counts.bumper_trips_by,
            Reasons::from([("contact".into(), 1), ("lidar_hit".into(), 1)])
        );
    }
}
