//! Tells in words what the robot does and why, while it explores.

use runtime::event::{Event, GoalReason, SafetyEvent};
use runtime::recording::{goal_reason, sentence};
use runtime::tick::Decision;

/// Pause after a line, seconds: a person reads one line a second.
const PAUSE_S: f64 = 1.0;
/// A line about something rare, such as a stop, waits only this long, seconds.
const SHORT_PAUSE_S: f64 = 0.2;

/// Chooses the events that are printed. A run in virtual time is faster than a reader, so frontiers that come too fast are left out;
/// other events rarely are.
#[derive(Debug, Default)]
pub(super) struct Narrator {
    /// Time of the run's first tick.
    began_ns: Option<u64>,
    /// Wall time of the last line, seconds.
    told_s: Option<f64>,
    /// The goal that the robot heads for.
    goal: Option<GoalReason>,
}

impl Narrator {
    /// What happened in this tick as one line with the run's time, if it is to be printed at this wall time.
    pub fn line(&mut self, decision: &Decision, wall_s: f64) -> Option<String> {
        let began_ns = *self.began_ns.get_or_insert(decision.time_ns);
        let mut parts = Vec::new();
        let mut is_rare = false;
        for event in &decision.events {
            let Some(part) = self.part(event, decision) else { continue };
            is_rare |= !is_about_frontier(event, self.goal);
            parts.push(part);
        }
        let pause_s = if is_rare { SHORT_PAUSE_S } else { PAUSE_S };
        if parts.is_empty() || self.told_s.is_some_and(|told_s| wall_s - told_s < pause_s) {
            return None;
        }
        self.told_s = Some(wall_s);
        let run_s = decision.time_ns.saturating_sub(began_ns) / 1_000_000_000;
        Some(format!("{:3}:{:02}  {}", run_s / 60, run_s % 60, parts.join("; ")))
    }

    /// The text for an event; `None` for one that is not worth a line.
    fn part(&mut self, event: &Event, decision: &Decision) -> Option<String> {
        match event {
            Event::GoalChosen { why, .. } => {
                self.goal = Some(*why);
                let here = decision.t_map_base();
                let away = decision.goal_m.map_or_else(String::new, |[x_m, y_m]| {
                    format!(" {:.1} m away", (x_m - here.x_m).hypot(y_m - here.y_m))
                });
                Some(format!("new goal{away}: {}", goal_reason(*why)))
            }
            Event::Safety { what } => is_stop(what).then(|| sentence(event).1),
            Event::NoDepth { .. } | Event::InputRefused { .. } => None,
            _ => Some(sentence(event).1),
        }
    }
}

fn is_stop(what: &SafetyEvent) -> bool {
    matches!(
        what,
        SafetyEvent::Tripped { .. }
            | SafetyEvent::Escaping
            | SafetyEvent::ViewLost
            | SafetyEvent::Faulted { .. }
    )
}

/// Frontiers are most of all goals.
fn is_about_frontier(event: &Event, goal: Option<GoalReason>) -> bool {
    match event {
        Event::GoalChosen { why, .. } => *why == GoalReason::Frontier,
        Event::GoalReached | Event::GoalDropped { .. } => goal == Some(GoalReason::Frontier),
        Event::NoGoal { .. } => true,
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::Pose2;
    use runtime::event::DropReason;

    fn tick(second: u64, events: Vec<Event>) -> Decision {
        Decision {
            tick: 10 * second,
            time_ns: second * 1_000_000_000,
            desired: runtime::tick::Command::default(),
            sent: None,
            goal_m: Some([3.0, 4.0]),
            t_odom_base: Pose2::IDENTITY,
            t_odom_base_at_frame: Pose2::IDENTITY,
            t_map_odom: Pose2::IDENTITY,
            lost: None,
            events,
            input_digest: 0,
            depth_digest: 0,
            map_digest: 0,
        }
    }

    fn chosen(why: GoalReason) -> Event {
        Event::GoalChosen { x_m: 3.0, y_m: 4.0, why }
    }

    #[test]
    fn a_goal_is_told_with_its_distance_and_reason_and_its_end_in_plain_words() {
        let mut narrator = Narrator::default();
        assert_eq!(narrator.line(&tick(5, vec![]), 0.0), None);
        let line = narrator.line(&tick(17, vec![chosen(GoalReason::Frontier)]), 1.0);
        assert_eq!(
            line.as_deref(),
            Some("  0:12  new goal 5.0 m away: free floor beside unknown space")
        );
        let seen = Event::GoalDropped { why: DropReason::Resolved };
        let next = chosen(GoalReason::Inconsistency);
        let line = narrator.line(&tick(100, vec![seen, next]), 2.5).unwrap();
        assert_eq!(
            line,
            "  1:35  goal seen from afar; new goal 5.0 m away: two observations of that place disagree"
        );
    }

    #[test]
    fn frontiers_are_told_once_a_second_at_most_and_stops_at_once() {
        let mut narrator = Narrator::default();
        let mut told = 0;
        for step in 0..40 {
            let tick = tick(step, vec![Event::GoalReached, chosen(GoalReason::Frontier)]);
            told += usize::from(narrator.line(&tick, step as f64 * 0.1).is_some());
        }
        assert_eq!(told, 4);
        let what = SafetyEvent::ViewLost;
        assert!(narrator.line(&tick(41, vec![Event::Safety { what }]), 3.95).is_some());
    }
}
