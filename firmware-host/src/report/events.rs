//! Counts what happened, by reason.

use std::collections::BTreeMap;

use runtime::event::{Event, SafetyEvent};
use serde::{Deserialize, Serialize};

/// How often each reason was given. Reasons are named as in the log.
pub type Reasons = BTreeMap<String, u64>;

/// What became of goals.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Goals {
    /// Chosen, by what made them worth going to.
    #[serde(skip_serializing_if = "Reasons::is_empty")]
    pub chosen: Reasons,
    /// Reached.
    pub reached: u64,
    /// Given up, by reason.
    #[serde(skip_serializing_if = "Reasons::is_empty")]
    pub dropped: Reasons,
}

/// Everything that has a reason, counted. By default nobody drove, and what only driving has is absent.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct EventCounts {
    /// What became of goals.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub goals: Option<Goals>,
    /// Times when no goal could be chosen, by reason.
    #[serde(skip_serializing_if = "Reasons::is_empty")]
    pub no_goal: Reasons,
    /// Pictures without any depth, by reason.
    #[serde(skip_serializing_if = "Reasons::is_empty")]
    pub no_depth: Reasons,
    /// Times when the bumper stopped the robot.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bumper_trips: Option<u64>,
    /// The same by what noticed the obstacle.
    #[serde(skip_serializing_if = "Reasons::is_empty")]
    pub bumper_trips_by: Reasons,
    /// Times when the robot turned to get out of a place where the bumper tripped repeatedly.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bumper_escapes: Option<u64>,
    /// Inputs that were refused, by reason.
    #[serde(skip_serializing_if = "Reasons::is_empty")]
    pub refused_inputs: Reasons,
    /// Times when a device or the loop made the robot stand, by reason.
    #[serde(skip_serializing_if = "Reasons::is_empty")]
    pub safety_faults: Reasons,
}

impl EventCounts {
    /// Of a robot that drives: that it never tripped is worth saying.
    #[must_use]
    pub fn driving() -> Self {
        let (goals, none) = (Some(Goals::default()), Some(0));
        Self { goals, bumper_trips: none, bumper_escapes: none, ..Self::default() }
    }

    /// Counts one event.
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
            Event::InputRefused { why } => count(&mut self.refused_inputs, why),
            Event::Safety { what: SafetyEvent::Tripped { by, .. } } => {
                *self.bumper_trips.get_or_insert(0) += 1;
                count(&mut self.bumper_trips_by, by);
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

/// The name of a reason as it stands in the log and in the summary.
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

    #[test]
    fn every_event_is_counted_under_its_own_reason() {
        let mut counts = EventCounts::default();
        let trip = |by| Event::Safety { what: SafetyEvent::Tripped { by, x_m: 0.3, y_m: 0.0 } };
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
        assert_eq!(
            counts.bumper_trips_by,
            Reasons::from([("contact".into(), 1), ("lidar_hit".into(), 1)])
        );
    }
}
