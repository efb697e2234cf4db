//! The log messages of a run, made from the events of its ticks.

use foxglove::messages as fox;

use super::sentences::{Severity, sentence};
use super::views::timestamp;
use crate::event::Event;
use crate::perception::NoDepth;

/// Makes Foxglove's log messages from the events of consecutive ticks.
///
/// Every tick without depth has an event. Its message is made when depth ends and when the reason changes, and another one when
/// depth is back, so that a rotation of a hundred ticks does not fill the viewer's list.
#[derive(Debug, Default)]
pub struct EventLog {
    no_depth: Option<NoDepth>,
}

impl EventLog {
    /// The messages of the next tick, in the order of its events.
    pub fn messages(&mut self, events: &[Event], time_ns: u64) -> Vec<fox::Log> {
        let before = self.no_depth.take();
        let mut messages = Vec::new();
        for event in events {
            if let Event::NoDepth { why } = event {
                self.no_depth = Some(*why);
                if before == Some(*why) {
                    continue;
                }
            }
            let (severity, text) = sentence(event);
            messages.push(message(severity, text, time_ns));
        }
        if before.is_some() && self.no_depth.is_none() {
            messages.push(message(Severity::Info, "depth again".to_owned(), time_ns));
        }
        messages
    }
}

fn message(severity: Severity, message: String, time_ns: u64) -> fox::Log {
    let level = match severity {
        Severity::Info => fox::log::Level::Info,
        Severity::Warning => fox::log::Level::Warning,
        Severity::Error => fox::log::Level::Error,
    };
    fox::Log {
        timestamp: timestamp(time_ns),
        level: level as i32,
        message,
        name: "robot".to_owned(),
        file: String::new(),
        line: 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texts(log: &mut EventLog, events: &[Event]) -> Vec<String> {
        log.messages(events, 0).into_iter().map(|message| message.message).collect()
    }

    #[test]
    fn missing_depth_is_logged_when_it_begins_when_its_reason_changes_and_when_it_ends() {
        let no_parallax = Event::NoDepth { why: NoDepth::TooLittleParallax };
        let no_frame = Event::NoDepth { why: NoDepth::NoFrame };
        let mut log = EventLog::default();
        let begins = texts(&mut log, std::slice::from_ref(&no_parallax));
        assert_eq!(begins, [sentence(&no_parallax).1]);
        assert!(texts(&mut log, std::slice::from_ref(&no_parallax)).is_empty());
        assert_eq!(
            texts(&mut log, &[no_parallax, Event::GoalReached]),
            ["goal reached"],
            "other events of the same tick are logged"
        );
        assert_eq!(texts(&mut log, std::slice::from_ref(&no_frame)), [sentence(&no_frame).1]);
        assert_eq!(texts(&mut log, &[]), ["depth again"]);
        assert!(texts(&mut log, &[]).is_empty());
    }

    #[test]
    fn other_events_are_logged_in_every_tick_that_has_them() {
        let mut log = EventLog::default();
        for _ in 0..2 {
            assert_eq!(texts(&mut log, &[Event::GoalReached, Event::GoalReached]).len(), 2);
        }
    }
}
