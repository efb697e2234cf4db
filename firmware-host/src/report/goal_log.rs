//! The goals of a run and what became of them.

use runtime::event::{DropReason, Event};

use super::map_image::{Goal, GoalFate};

/// Number of goals that are kept: more than the map's image can show, and far more than a run of a day has.
const MOST_REMEMBERED: usize = 100_000;

/// Follows the events of a run.
#[derive(Debug, Clone, Default)]
pub struct GoalLog {
    goals: Vec<Goal>,
}

impl GoalLog {
    /// Takes an event of a decision into account.
    pub fn note(&mut self, event: &Event) {
        match event {
            Event::GoalChosen { x_m, y_m, .. } if self.goals.len() < MOST_REMEMBERED => {
                self.goals.push(Goal { at_m: [*x_m, *y_m], fate: GoalFate::Open });
            }
            Event::GoalReached => self.end(GoalFate::Reached),
            Event::GoalDropped { why: DropReason::Resolved } => self.end(GoalFate::Seen),
            Event::GoalDropped { .. } => self.end(GoalFate::Dropped),
            // Their places are in the frame of another map.
            Event::MapBegun | Event::MapChanged | Event::MapsJoined => self.goals.clear(),
            _ => {}
        }
    }

    fn end(&mut self, fate: GoalFate) {
        if let Some(goal) = self.goals.last_mut() {
            goal.fate = fate;
        }
    }

    /// The goals in the order in which they were chosen, in the map, metres.
    #[must_use]
    pub fn goals(&self) -> &[Goal] {
        &self.goals
    }
}

#[cfg(test)]
mod tests {
    use runtime::event::GoalReason;

    use super::*;

    fn chosen(x_m: f64) -> Event {
        Event::GoalChosen { x_m, y_m: 0.0, why: GoalReason::Frontier }
    }

    #[test]
    fn the_goals_of_another_map_are_left_out() {
        let mut log = GoalLog::default();
        for event in [chosen(1.0), Event::MapBegun, chosen(2.0), chosen(3.0)] {
            log.note(&event);
        }
        assert_eq!(log.goals().len(), 2);
        log.note(&Event::MapsJoined);
        log.note(&Event::GoalReached);
        assert!(log.goals().is_empty());
    }

    #[test]
    fn every_goal_keeps_its_own_end() {
        let mut log = GoalLog::default();
        let ends = [
            Event::GoalReached,
            Event::GoalDropped { why: DropReason::Resolved },
            Event::GoalDropped { why: DropReason::Blocked },
        ];
        for (index, end) in ends.iter().enumerate() {
            log.note(&chosen(index as f64));
            log.note(end);
        }
        log.note(&chosen(3.0));
        let fates: Vec<GoalFate> = log.goals().iter().map(|goal| goal.fate).collect();
        assert_eq!(fates, [GoalFate::Reached, GoalFate::Seen, GoalFate::Dropped, GoalFate::Open]);
        assert_eq!(log.goals()[2].at_m, [2.0, 0.0]);
    }

    #[test]
    fn an_end_without_a_goal_changes_nothing() {
        let mut log = GoalLog::default();
        log.note(&Event::GoalReached);
        assert!(log.goals().is_empty());
    }
}
